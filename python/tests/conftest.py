"""What tests share: the folder of the project, and results of the command line to compare with."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path
from typing import Callable

import pytest

ROOT = Path(__file__).resolve().parents[2]
PIPELINES = ROOT / "pipelines"


@pytest.fixture(scope="session")
def program() -> Path:
    """The program for the command line."""
    program = Path(os.environ.get("ABBE_PROGRAM", ROOT / "target/debug/abbe-under-test"))
    if not program.is_file():
        pytest.skip(f"{program} is not built")
    return program


@pytest.fixture(scope="session")
def by_command_line(program: Path, tmp_path_factory: pytest.TempPathFactory) -> Callable[[str], Path]:
    """The folder with the results of `abbe run` of a recipe in `pipelines`."""
    out, done = tmp_path_factory.mktemp("out"), set[str]()

    def folder(recipe: str) -> Path:
        if recipe not in done:
            command = [str(program), "run", f"pipelines/{recipe}.yaml", "--out", str(out)]
            subprocess.run(command, cwd=ROOT, check=False, capture_output=True, timeout=600)
            done.add(recipe)
        return out / recipe

    return folder
