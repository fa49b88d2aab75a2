"""Types: the package keeps them, and its stubs say what is there."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import abbe

PACKAGE = Path(abbe.__file__).parent


def by(*command: str) -> None:
    done = subprocess.run([sys.executable, "-m", *command], capture_output=True, text=True, cwd=PACKAGE.parent)
    assert done.returncode == 0, done.stdout + done.stderr


def test_the_package_keeps_its_types() -> None:
    pytest.importorskip("mypy")
    assert (PACKAGE / "py.typed").is_file()
    by("mypy", "--strict", "--no-incremental", "--ignore-missing-imports", "-p", "abbe")


def test_stubs_say_what_is_there() -> None:
    pytest.importorskip("mypy")
    by("mypy.stubtest", "abbe._abbe")


def test_everything_public_says_what_it_is() -> None:
    for name in abbe.__all__:
        member = getattr(abbe, name)
        assert name == "__version__" or (member.__doc__ or "").strip(), name
