"""Artefacts that are written in Python."""

from __future__ import annotations

from typing import Any, Callable, Mapping, Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

Columns = Mapping[str, NDArray[Any]]
Residuals = Callable[..., ArrayLike]


class Artefact:
    """An artefact in Python, which recipes name: see `abbe.artefact`."""

    def __init__(
        self,
        name: str,
        residuals: Residuals,
        *,
        equations: int,
        unknowns: Mapping[str, str],
        columns: Sequence[str],
        nominal_tips: Callable[[Columns, Mapping[str, Any]], ArrayLike] | None,
        about: str,
    ) -> None:
        self.name, self.residuals, self.equations, self.unknowns = name, residuals, equations, dict(unknowns)
        self.columns, self.nominal_tips, self.about = list(columns), nominal_tips, about

    def __call__(self, *arguments: Any) -> ArrayLike:
        return self.residuals(*arguments)

    def _unknowns(self) -> list[tuple[str, str]]:
        return list(self.unknowns.items())

    def _bind(self, columns: Mapping[str, bytearray | list[str]], settings: Mapping[str, Any]) -> _Bound:
        def column(cells: bytearray | list[str]) -> NDArray[Any]:
            return np.frombuffer(cells) if isinstance(cells, bytearray) else np.array(cells, dtype=object)

        return _Bound(self, {name: column(cells) for name, cells in columns.items()}, settings)


class _Bound:
    """An artefact with the columns of its data."""

    def __init__(self, artefact: Artefact, columns: Columns, settings: Mapping[str, Any]) -> None:
        self.artefact, self.columns, self.settings = artefact, columns, settings

    def residuals(self, rows: list[int], tips: bytearray, own: list[float]) -> NDArray[np.float64]:
        of_rows = {name: cells[rows] for name, cells in self.columns.items()}
        unknowns = dict(zip(self.artefact.unknowns, own))
        found = self.artefact.residuals(np.frombuffer(tips).reshape(-1, 3), of_rows, unknowns, self.settings)
        expected = (len(rows), self.artefact.equations)
        array = np.asarray(found, dtype=np.float64)
        if array.size != expected[0] * expected[1]:
            raise ValueError(f"residuals of the shape {array.shape}; {expected} was expected: rows x equations")
        return np.ascontiguousarray(array).ravel()

    def nominal_tips(self) -> NDArray[np.float64]:
        assert self.artefact.nominal_tips is not None
        tips = np.asarray(self.artefact.nominal_tips(self.columns, self.settings), dtype=np.float64)
        return np.ascontiguousarray(tips).ravel()


def artefact(
    name: str,
    *,
    equations: int = 1,
    unknowns: Mapping[str, str] | None = None,
    columns: Sequence[str] = (),
    nominal_tips: Callable[[Columns, Mapping[str, Any]], ArrayLike] | None = None,
) -> Callable[[Residuals], Artefact]:
    """Makes a function the artefact plugin `name`, which recipes name: `{"artefact": name, "from": ..., ...}`.

    The function gets `tips` (rows x 3, table frame, mm), the `columns` of these rows by their names, in the units
    that these say, the values of the artefact's own `unknowns` by name, and the `settings` of the stage. It gives the
    residuals, rows x `equations`, in mm: the left side of an equation that is 0 for a perfect model. A row may depend
    on itself alone. The setting `standard_uncertainty_um` of the stage is the standard uncertainty of every equation.

    `unknowns` says their units (`mm`, `rad`), `columns` which columns there have to be. `nominal_tips` gives where
    the tips would be without errors, for all rows of the columns: rank is judged there, else at the recorded poses.

    It is slow: Python computes the residuals, one thread at a time, and derivatives are differences: seven calls for
    each evaluation, two more for each unknown. It serves to try an artefact; one that stays is a plugin in Rust, a
    hundred times as fast.

    >>> import abbe, numpy as np
    >>> corner = lambda n: np.array([50.0 + 400 * (n & 1), 50.0 + 200 * (n & 2), 50.0 + 100 * (n & 4)])
    >>> places = {str(n): corner(n) for n in range(8)}
    >>> @abbe.artefact("points", equations=3, columns=["feature"])
    ... def points(tips, columns, unknowns, settings):
    ...     return tips - np.array([places[feature] for feature in columns["feature"]])
    >>> known = np.array(list(places.values()))
    >>> touches = {"feature": list(places), "X_mm": known[:, 0] / (1 + 12e-6), "Y_mm": known[:, 1], "Z_mm": known[:, 2]}
    >>> recipe = {
    ...     "abbe": 1,
    ...     "stages": {
    ...         "touches": {"ingest": "csv", "path": "touches.csv"},
    ...         "points": {"artefact": "points", "from": "touches", "standard_uncertainty_um": 1},
    ...         "machine": {"model": "serial-chain", "chain": "w b X Y Z t", "tool_length_mm": 0, "stylus_radius_mm": 0,
    ...                     "errors": [{"polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1]}]},
    ...         "fit": {"estimate": "gauss-newton", "machine": "machine", "observations": ["points"],
    ...                 "parameters": ["E*"], "trust_uncertainties": True},
    ...     },
    ... }
    >>> run = abbe.run(recipe, data={"touches": touches}, artefacts=[points])
    >>> print(f"{run.fits['fit']['EXX[1]'].value * 1e6:.3f} µm/m")
    12.000 µm/m
    """

    def made(residuals: Residuals) -> Artefact:
        about = (residuals.__doc__ or "an artefact in Python").strip().splitlines()[0].rstrip(".")
        return Artefact(
            name,
            residuals,
            equations=equations,
            unknowns=unknowns or {},
            columns=columns,
            nominal_tips=nominal_tips,
            about=about,
        )

    return made
