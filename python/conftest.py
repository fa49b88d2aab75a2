"""Doctests of the package run in the folder of the project, as the examples say."""

from pathlib import Path

import pytest


@pytest.fixture(autouse=True)
def in_the_folder_of_the_project(monkeypatch: pytest.MonkeyPatch) -> None:
    """Paths in examples start there."""
    monkeypatch.chdir(Path(__file__).resolve().parents[1])
