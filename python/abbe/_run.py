"""Recipes: checked, run, and what a run found."""

from __future__ import annotations

import html
import json
import os
import warnings
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Callable, Iterator, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike

from . import _abbe
from ._artefact import Artefact
from ._errors import AbbeError, AbbeWarning
from ._problem import Problem
from ._table import Covariance, Table


def _plain(value: Any) -> Any:
    """What JSON does not know: numbers and arrays of NumPy, paths."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if hasattr(value, "tolist"):
        return value.tolist()
    raise TypeError(f"a recipe holds texts, numbers, lists and dicts, not {type(value).__name__}")


def _source(recipe: Any, base: str | os.PathLike[str] | None) -> tuple[Path, str | None]:
    """Where a recipe stands, and its text if it stands in no file."""
    if isinstance(recipe, (str, os.PathLike)):
        if base is not None:
            raise TypeError("`base` is for recipes without a file: paths in a file start at its own folder")
        return Path(recipe), None
    text = json.dumps(recipe, indent=2, ensure_ascii=False, default=_plain, allow_nan=True)
    return Path("" if base is None else base) / "recipe.json", text


@contextmanager
def _warned() -> Iterator[None]:
    """Warns of what is told meanwhile, also where it ends with an exception."""
    try:
        yield
    finally:
        for text in _abbe.take_warnings():
            warnings.warn(text, AbbeWarning, stacklevel=4)


@dataclass(frozen=True)
class Planned:
    """What an estimate of a recipe could determine, without solving it."""

    estimate: str
    """Name of the estimate."""
    accepted: bool
    """Whether its estimator would solve it."""
    machine: list[str]
    """The machine parameters that it estimates."""
    identifiability: dict[str, Any]
    """Rank, number of unknowns, condition, and what the data cannot determine."""


@dataclass(frozen=True)
class Value:
    """A value of a calibration."""

    name: str
    value: float
    """In `unit`."""
    unit: str
    standard_uncertainty: float
    """In `unit`."""
    status: str
    """"estimated", "fixed", "considered" or "confounded"."""

    def __float__(self) -> float:
        return self.value


@dataclass(frozen=True)
class Verdict:
    """What a validator found."""

    stage: str
    """Name of the stage."""
    plugin: str
    """Name of the validator."""
    decision: str
    """"pass", "inconclusive" or "fail"."""
    figures: Table
    """Figures: of, name, value, standard_uncertainty, unit, limit, decision, why_undecided."""
    remarks: list[str]
    """Further remarks: sentences."""


class Calibration:
    """Errors of a machine with their uncertainties, and what follows from them.

    >>> import abbe
    >>> calibration = abbe.run("pipelines/first-steps.yaml").fits["fit"]
    >>> poses = {"X_mm": [0, 100], "Y_mm": [0, 0], "Z_mm": [0, 0], "B_deg": [0, 90], "C_deg": [0, 180]}
    >>> there = calibration.predict(poses)
    >>> list(there)[:3], list(there)[-3:]
    (['x_mm', 'y_mm', 'z_mm'], ['uncertainty_x_um', 'uncertainty_y_um', 'uncertainty_z_um'])
    >>> there.rows
    2
    """

    def __init__(self, calibration: _abbe.Calibration) -> None:
        self._calibration = calibration

    @property
    def name(self) -> str:
        """Name of the estimate."""
        return self._calibration.estimate

    @property
    def parameters(self) -> Table:
        """The parameters of the machine: name, value, unit, standard_uncertainty, status."""
        return Table(self._calibration.values(False))

    @property
    def artefacts(self) -> Table:
        """The unknowns of artefacts and known inputs, in the same columns."""
        return Table(self._calibration.values(True))

    def __getitem__(self, name: str) -> Value:
        """One value, of the machine or of an artefact."""
        for table in (self.parameters, self.artefacts):
            for row in np.flatnonzero(table["name"] == name):
                name, value, unit, uncertainty, status = (table[column][row] for column in table)
                return Value(name, float(value), unit, float(uncertainty), status)
        raise KeyError(f"`{name}` is no value of this calibration")

    @property
    def covariance(self) -> Covariance:
        """The covariance of all that was estimated or considered, with names."""
        names, rows = self._calibration.covariance()
        return Covariance(names, np.frombuffer(rows).reshape(len(names), len(names)))

    def predict(self, poses: Any) -> Table:
        """Where the tip is at poses, and its error there.

        `poses` has a column for the command of each axis (`X_mm`, `B_deg`) and for what else errors depend on
        (`dir_X`, `time_s`). Without a direction of approach the errors are the mean of both directions, and without
        a time there is no drift. In the table frame: the tip (`x_mm`, `y_mm`, `z_mm`), the orientation of the tool
        (quaternion `qw`, `qx`, `qy`, `qz`), actual minus nominal tip (`error_x_um`, ...) and its standard
        uncertainties (`uncertainty_x_um`, ...).
        """
        return Table(self._calibration.predict(poses))

    def compensate(
        self,
        set_points: Any,
        *,
        correct: str | Sequence[str] = "position",
        method: str = "exact",
        travel: str = "refuse",
        sensitive_direction: ArrayLike | None = None,
        weights: ArrayLike | None = None,
        largest_tip_correction_mm: float = 1.0,
        largest_axis_correction_mrad: float = 1.0,
        largest_rotary_correction_mrad: float = 50.0,
    ) -> Table:
        """Set-points with corrected commands, as `abbe compensate` gives them, and the errors before and after.

        `correct` is "position", "five-axes" or a list of linear axes; `method` "exact" or "first-order"; `travel`,
        what happens where a command would leave the travel of its axis, "refuse", "hold" or "allow". Directions of
        approach that the set-points do not have are those of the path. A calibration with confounded parameters that
        would move the tool is refused (`DataError`).
        """
        settings = {
            "correct": correct if isinstance(correct, str) else list(correct),
            "method": method,
            "travel": travel,
            "sensitive_direction": None if sensitive_direction is None else np.asarray(sensitive_direction).tolist(),
            "weights": None if weights is None else np.asarray(weights).tolist(),
            "largest_tip_correction_mm": largest_tip_correction_mm,
            "largest_axis_correction_mrad": largest_axis_correction_mrad,
            "largest_rotary_correction_mrad": largest_rotary_correction_mrad,
        }
        with _warned():
            return Table(self._calibration.compensate(set_points, json.dumps(settings)))

    def to_json(self) -> str:
        """The text of the calibration file, to the byte as `abbe run` writes it."""
        return self._calibration.json()

    @property
    def fit_report(self) -> dict[str, Any]:
        """The report of the fit: rank, condition, sigma, iterations, residuals."""
        fit: dict[str, Any] = json.loads(self.to_json())["fit"]
        return fit

    def __repr__(self) -> str:
        return f"<{type(self).__name__} {self.name!r}: {self.parameters.rows} parameters>"

    def _repr_html_(self) -> str:
        return f"<p><b>{html.escape(self.name)}</b></p>{self.parameters._repr_html_()}"


class Fit(Calibration):
    """An estimate of a run: its calibration, its residuals and the problem that it solved."""

    def __init__(self, outcome: _abbe.Outcome, name: str) -> None:
        super().__init__(outcome.calibration(name))
        self._outcome, self._name = outcome, name

    @property
    def name(self) -> str:
        return self._name

    @property
    def residuals(self) -> Table:
        """The residual of every equation with its place, as in `<estimate>.residuals.csv`."""
        return Table(self._outcome.residuals(self._name))

    @property
    def problem(self) -> Problem:
        """The problem that was solved."""
        return Problem(self._outcome.problem(self._name))


class Fits(Mapping[str, Fit]):
    """The estimates of a run, by name."""

    def __init__(self, outcome: _abbe.Outcome) -> None:
        self._outcome = outcome
        self._names: list[str] = outcome.estimates

    def __getitem__(self, name: str) -> Fit:
        if name not in self._names:
            raise KeyError(f"there is no estimate `{name}`; there are {', '.join(self._names)}")
        return Fit(self._outcome, name)

    def __iter__(self) -> Iterator[str]:
        return iter(self._names)

    def __len__(self) -> int:
        return len(self._names)

    def __repr__(self) -> str:
        return f"<Fits: {', '.join(self._names)}>"


class Run:
    """What a run found. Nothing of it is on disk until `write`.

    >>> import abbe
    >>> run = abbe.run("pipelines/first-steps.yaml")
    >>> run
    <Run of first-steps: 1 estimates, 1 verdicts, pass>
    >>> run.verdicts["judge"].figures["name"][:2]
    array(['max', 'mean'], dtype=object)
    """

    def __init__(self, outcome: _abbe.Outcome) -> None:
        self._outcome = outcome

    @property
    def recipe(self) -> str:
        """Name of the recipe."""
        return self._outcome.recipe

    @property
    def title(self) -> str:
        """What the recipe says that it is."""
        return self._outcome.title

    @property
    def fits(self) -> Fits:
        """The estimates by name."""
        return Fits(self._outcome)

    @property
    def verdicts(self) -> dict[str, Verdict]:
        """The verdicts by their stages."""
        found = ((stage, plugin, decision, Table(figures), remarks)
                 for stage, plugin, decision, figures, remarks in self._outcome.verdicts())
        return {verdict[0]: Verdict(*verdict) for verdict in found}

    @property
    def decision(self) -> str:
        """"fail" if one verdict fails, else "inconclusive" if one is, else "pass"."""
        return self._outcome.decision

    @property
    def passes(self) -> bool:
        """Whether no stage failed and no verdict fails."""
        return self._outcome.passes

    @property
    def failures(self) -> dict[str, AbbeError]:
        """Stages without a result, and why. Those that need one of them are left out."""
        return dict(self._outcome.failures())

    @property
    def remarks(self) -> list[str]:
        """What users should know before they trust the results."""
        return [f"{remark['estimate']}: {remark['text']}" for remark in self.record["remarks"]]

    @property
    def record(self) -> dict[str, Any]:
        """The record of the run, as in `run.json`: files with their digests, plugins, time."""
        record: dict[str, Any] = json.loads(self._outcome.record())
        return {"failures": [], "remarks": [], **record}

    @property
    def exports(self) -> dict[str, dict[str, bytes]]:
        """Exported files and tables of validators: by stage, then by name."""
        found: dict[str, dict[str, bytes]] = {}
        for stage, name, content in self._outcome.exports():
            found.setdefault(stage, {})[name] = content
        return found

    def report(self) -> str:
        """The page about the run, `report.html`: one file without anything from elsewhere."""
        page = self._outcome.report()
        if page is None:
            raise AbbeError("the page about this run could not be made", help="warnings say why")
        return page

    def write(self, out: str | os.PathLike[str] = "out") -> Path:
        """Writes the results into a folder named after the recipe in `out`, whole or not at all, as `abbe run` does."""
        return Path(self._outcome.write(Path(out)))

    def __repr__(self) -> str:
        verdicts = self._outcome.verdicts()
        return f"<Run of {self.recipe}: {len(self.fits)} estimates, {len(verdicts)} verdicts, {self.decision}>"

    def _repr_html_(self) -> str:
        parts = [f"<h3>{html.escape(self.title)}</h3>"]
        for stage, failure in self.failures.items():
            parts.append(f"<p><b>{html.escape(stage)}</b> failed: {html.escape(str(failure))}</p>")
        for verdict in self.verdicts.values():
            of = f"{html.escape(verdict.stage)} ({html.escape(verdict.plugin)})"
            parts.append(f"<p>{of}: <b>{verdict.decision}</b></p>")
        parts.extend(f"<p>{html.escape(remark)}</p>" for remark in self.remarks)
        parts.extend(
            f"<details><summary>{html.escape(name)}</summary>{fit.parameters._repr_html_()}</details>"
            for name, fit in self.fits.items()
        )
        return "".join(parts)


def check(
    recipe: str | os.PathLike[str] | Mapping[str, Any],
    data: Mapping[str, Any] | None = None,
    *,
    base: str | os.PathLike[str] | None = None,
    artefacts: Sequence[Artefact] = (),
) -> list[Planned]:
    """What the planned estimates of a recipe could determine, without solving them. Arguments as in `run`.

    >>> import abbe
    >>> [planned] = abbe.check("pipelines/first-steps.yaml")
    >>> planned.estimate, planned.accepted
    ('fit', True)
    """
    path, text = _source(recipe, base)
    with _warned():
        found = json.loads(_abbe.check(path, text, dict(data or {}), list(artefacts)))
    return [Planned(**planned) for planned in found]


def run(
    recipe: str | os.PathLike[str] | Mapping[str, Any],
    data: Mapping[str, Any] | None = None,
    *,
    base: str | os.PathLike[str] | None = None,
    artefacts: Sequence[Artefact] = (),
    progress: Callable[[dict[str, Any]], object] | None = None,
    time_limit_s: float | None = None,
) -> Run:
    """Runs a recipe and keeps the results in memory.

    `recipe` is the path of a recipe, or what would stand in one as a dict; relative paths then start at the folder
    `base`. `data` has tables for stages that read tables (`ingest: csv`, `parquet`, `arrow-ipc`), by name, in the
    place of their files: tables of pandas, polars or pyarrow, structured arrays of NumPy or dicts of arrays. Their
    columns have the names that they would have in a file, with units (`X_mm`, `B_deg`), and all that the recipe says
    of rows and columns holds for them. `artefacts` are those in Python that the recipe names (`abbe.artefact`).
    `progress` is called with events, in this thread: dicts with the key `event`. Ctrl-C ends the run, and
    `time_limit_s` does.

    Raises `RecipeError` for all that can be found without rows, `DataError` for what they show; stages that fail on
    the way are `Run.failures`. What should be known is warned of (`AbbeWarning`).
    """
    path, text = _source(recipe, base)
    with _warned():
        return Run(_abbe.run(path, text, dict(data or {}), list(artefacts), progress, time_limit_s))


def problems(
    recipe: str | os.PathLike[str] | Mapping[str, Any],
    data: Mapping[str, Any] | None = None,
    *,
    base: str | os.PathLike[str] | None = None,
    artefacts: Sequence[Artefact] = (),
) -> dict[str, Problem]:
    """The problems of the estimates of a recipe, by name, for estimators of one's own. Arguments as in `run`."""
    path, text = _source(recipe, base)
    with _warned():
        found = _abbe.problems(path, text, dict(data or {}), list(artefacts))
    return {name: Problem(problem) for name, problem in found}


def read_calibration(path: str | os.PathLike[str]) -> Calibration:
    """Reads `<estimate>.calibration.json`, which a run has written. It contains its machine."""
    return Calibration(_abbe.read_calibration(Path(path)))
