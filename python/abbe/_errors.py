"""What can go wrong, as exceptions with a place and with what to do."""

from __future__ import annotations

from typing import Sequence


class AbbeError(Exception):
    """An error of a recipe or of data: what is wrong, where, and what to do.

    >>> import abbe
    >>> try:
    ...     abbe.check({"abbe": 1, "stages": {"touches": {"ingest": "cvs", "path": "touches.csv"}}})
    ... except abbe.AbbeError as error:
    ...     print(error.message)
    ...     print(error.line, error.stage, error.help)
    there is no ingest plugin `cvs`
    5 touches did you mean `csv`?
    """

    message: str
    """What is wrong and what was expected: a sentence."""
    help: str | None
    """What to do."""
    file: str | None
    """The file that is concerned: the recipe, or data."""
    line: int | None
    """The line in it, from 1. Tables have no lines: the message names the row, from 1."""
    column: int | None
    """The character in the line, from 1."""
    stage: str | None
    """The stage of the recipe."""
    setting: tuple[str | int, ...]
    """The way to the setting of that stage."""

    def __init__(
        self,
        message: str,
        *,
        help: str | None = None,
        file: str | None = None,
        line: int | None = None,
        column: int | None = None,
        stage: str | None = None,
        setting: Sequence[str | int] = (),
    ) -> None:
        super().__init__(message)
        self.message, self.help, self.file, self.line = message, help, file, line
        self.column, self.stage, self.setting = column, stage, tuple(setting)

    def __str__(self) -> str:
        place = ":".join(str(part) for part in (self.file, self.line, self.column) if part is not None)
        stage = f"stage `{self.stage}`: " if self.stage else ""
        text = f"{place}: {stage}{self.message}" if place else f"{stage}{self.message}"
        return f"{text}\n  help: {self.help}" if self.help else text


class RecipeError(AbbeError):
    """Wrong use: all that can be found without looking at rows of data (exit status 2 of the command line)."""


class DataError(AbbeError):
    """Wrong or insufficient data, and what only the work itself shows (exit status 1 of the command line)."""


class AbbeWarning(UserWarning):
    """What users should know, although there are results."""
