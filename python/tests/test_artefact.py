"""Artefacts in Python: the same estimates as those of a plugin in Rust."""

from __future__ import annotations

import csv
from typing import Any, Mapping

import numpy as np
import pytest

import abbe

FOLDER = "pipelines/data/tango-hu40t/realistic"


def facets() -> dict[str, tuple[Any, Any]]:
    with open(f"{FOLDER}/facets.csv", newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))
    numbers = lambda row, names: np.array([float(row[name]) for name in names])  # noqa: E731
    return {row["feature"]: (numbers(row, ["x_mm", "y_mm", "z_mm"]), numbers(row, ["nx", "ny", "nz"])) for row in rows}


def recipe(artefact: Mapping[str, Any], parameters: list[str]) -> dict[str, Any]:
    return {
        "abbe": 1,
        "stages": {
            "touches": {"ingest": "csv", "path": f"{FOLDER}/touches.csv", "ignore": {"feature": [1, 2]}},
            "table": {"from": "touches", "standard_uncertainty_um": 1.6, **artefact},
            "machine": {
                "model": "serial-chain",
                "chain": "w C' B' X' b Z Y (S) t",
                "tool_length_mm": 326.674,
                "stylus_radius_mm": 3,
                "errors": [
                    {"location": ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C"]},
                    {"polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1]},
                ],
            },
            "fit": {
                "estimate": "gauss-newton",
                "machine": "machine",
                "observations": ["table"],
                "parameters": ["dxt", "dyt", "dzt", "E*0?", "EXX*", *parameters],
            },
        },
    }


def test_it_finds_what_the_plugin_finds() -> None:
    """Facets without unknowns of their own: their equation, n (p - P) - r, in Python and in Rust."""
    known = facets()

    @abbe.artefact("planes", columns=["feature"])
    def planes(tips: Any, columns: Any, unknowns: Any, settings: Any) -> Any:
        """Facets at their nominal places."""
        places = np.array([known[feature][0] for feature in columns["feature"]])
        normals = np.array([known[feature][1] for feature in columns["feature"]])
        return ((tips - places) * normals).sum(axis=1) - settings["radius_mm"]

    ours = abbe.run(recipe({"artefact": "planes", "radius_mm": 3}, []), artefacts=[planes])
    theirs = abbe.run(recipe({"artefact": "facets", "nominal": f"{FOLDER}/facets.csv"}, []))
    one, other = ours.fits["fit"], theirs.fits["fit"]
    for name in ["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "dzt", "EXX[1]"]:
        apart = abs(one[name].value - other[name].value)
        assert apart < 1e-4 * other[name].standard_uncertainty, name
    assert np.allclose(one.residuals["residual_um"], other.residuals["residual_um"], atol=1e-3)


def test_unknowns_of_its_own_are_estimated() -> None:
    """A common offset of all facets along their normals."""
    known = facets()

    @abbe.artefact("planes", columns=["feature"], unknowns={"offset": "mm"})
    def planes(tips: Any, columns: Any, unknowns: Any, settings: Any) -> Any:
        places = np.array([known[feature][0] for feature in columns["feature"]])
        normals = np.array([known[feature][1] for feature in columns["feature"]])
        return ((tips - places) * normals).sum(axis=1) - 3.0 - unknowns["offset"] + 0.25

    fit = abbe.run(recipe({"artefact": "planes"}, ["table.offset"]), artefacts=[planes]).fits["fit"]
    assert fit["table.offset"].unit == "mm"
    assert fit["table.offset"].value == pytest.approx(0.25, abs=0.1)
    problem = fit.problem
    x = np.array([fit[name].value for name in problem.names])
    column = problem.linearise(x)[1][:, problem.names.index("table.offset")]
    assert np.allclose(column, -1.0, atol=1e-9)


@pytest.mark.parametrize(
    ("function", "message"),
    [
        (lambda tips, columns, unknowns, settings: tips, "was expected: rows x equations"),
        (lambda tips, columns, unknowns, settings: columns["nowhere"], "KeyError"),
        (lambda tips, columns, unknowns, settings: tips[:, 0] * np.nan, ""),
    ],
)
def test_what_it_raises_is_told(function: Any, message: str) -> None:
    planes = abbe.artefact("planes")(function)
    with pytest.raises(abbe.AbbeError) as caught:
        run = abbe.run(recipe({"artefact": "planes"}, []), artefacts=[planes])
        raise run.failures["fit"]
    assert message in str(caught.value)


def test_its_columns_have_to_be_there() -> None:
    planes = abbe.artefact("planes", columns=["plane"])(lambda tips, *_: tips[:, 0])
    with pytest.raises(abbe.RecipeError, match="there is no column `plane`"):
        abbe.check(recipe({"artefact": "planes"}, []), artefacts=[planes])
    with pytest.raises(abbe.RecipeError, match="there is no artefact plugin `planes`"):
        abbe.check(recipe({"artefact": "planes"}, []))
    twin = abbe.artefact("facets")(lambda tips, *_: tips[:, 0])
    with pytest.raises(abbe.RecipeError, match="two artefact plugins named `facets`"):
        abbe.check(recipe({"artefact": "facets"}, []), artefacts=[twin])
