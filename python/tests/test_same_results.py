"""What Python gives is what `abbe run` writes: the same files to the byte, the same tables to the last bit."""

from __future__ import annotations

import csv
import json
from pathlib import Path
from typing import Any, Callable

import numpy as np
import pytest

import abbe

RECIPES = ["first-steps", "samba", "mfb-ucp710", "standards-positioning", "tango-hu40t", "positioner"]

Results = Callable[[str], Path]


def without_time(record: dict[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in record.items() if key not in ("started_unix_s", "duration_s", "outputs")}


@pytest.mark.parametrize("recipe", RECIPES)
@pytest.mark.filterwarnings("ignore::abbe.AbbeWarning")
def test_files_are_the_same_to_the_byte(recipe: str, by_command_line: Results, tmp_path: Path) -> None:
    expected, run = by_command_line(recipe), abbe.run(f"pipelines/{recipe}.yaml")
    written = run.write(tmp_path)
    files = {str(path.relative_to(expected)) for path in expected.rglob("*") if path.is_file()}
    assert files == {str(path.relative_to(written)) for path in written.rglob("*") if path.is_file()}
    assert "run.json" in files and len(files) > 2
    for name in files - {"run.json", "report.html"}:
        is_same = (written / name).read_bytes() == (expected / name).read_bytes()
        assert is_same, name
    theirs, ours = (json.loads((folder / "run.json").read_text()) for folder in (expected, written))
    assert without_time(theirs) == without_time(ours)
    is_same = {name: fit.to_json() == (expected / f"{name}.calibration.json").read_text() for name, fit in run.fits.items()}
    assert all(is_same.values()), is_same


@pytest.mark.parametrize("recipe", ["first-steps", "mfb-ucp710", "tango-hu40t"])
@pytest.mark.filterwarnings("ignore::abbe.AbbeWarning")
def test_tables_say_what_the_files_say(recipe: str, by_command_line: Results) -> None:
    expected, run = by_command_line(recipe), abbe.run(f"pipelines/{recipe}.yaml")
    assert run.fits
    for name, fit in run.fits.items():
        calibration = json.loads((expected / f"{name}.calibration.json").read_text())
        for table, key in [(fit.parameters, "parameters"), (fit.artefacts, "artefacts")]:
            for column in ["name", "value", "unit", "standard_uncertainty", "status"]:
                assert list(table[column]) == [value[column] for value in calibration[key]]
        assert fit.covariance.names == tuple(calibration["covariance"]["order"])
        assert np.array_equal(np.asarray(fit.covariance), np.array(calibration["covariance"]["rows"]))
        with open(expected / f"{name}.residuals.csv", newline="") as file:
            rows = list(csv.DictReader(file))
        residuals = fit.residuals
        assert list(residuals) == list(rows[0])
        assert residuals.rows == len(rows)
        for column in residuals:
            cells = residuals[column]
            for cell, row in zip(cells, rows):
                written = row[column]
                if cells.dtype == object:
                    assert cell == written
                elif written:
                    # The file rounds what people read: to its last digit.
                    digits = len(written.partition(".")[2])
                    assert abs(float(written) - cell) <= 0.500001 * 10.0**-digits, (column, written, cell)
                else:
                    assert np.isnan(cell)
    verdicts = json.loads((expected / "verdicts.json").read_text())
    assert list(run.verdicts) == [verdict["stage"] for verdict in verdicts]
    for verdict in verdicts:
        found = run.verdicts[verdict["stage"]]
        assert (found.plugin, found.decision) == (verdict["plugin"], verdict["decision"])
        assert list(found.figures["name"]) == [figure["name"] for figure in verdict["figures"]]
        values = [np.nan if figure["value"] is None else figure["value"] for figure in verdict["figures"]]
        assert np.array_equal(found.figures["value"], np.array(values), equal_nan=True)


def test_a_recipe_as_a_dict_is_the_recipe() -> None:
    """The text of a recipe in Python: paths start at `base`."""
    recipe = dict(
        abbe=1,
        stages=dict(
            touches=dict(ingest="csv", path=Path("data/tango-hu40t/realistic/touches.csv"), ignore=dict(feature=[1, 2])),
            table=dict(
                artefact="facets",
                nominal="data/tango-hu40t/realistic/facets.csv",
                standard_uncertainty_um=np.float64(1.6),
                **{"from": "touches"},
            ),
            machine=dict(
                model="serial-chain",
                chain="w C' B' X' b Z Y (S) t",
                tool_length_mm=326.674,
                stylus_radius_mm=3,
                errors=[
                    dict(location=["EA0B", "EC0B", "EX0C", "EA0C", "EB0C", "EB0Z", "EA0Y", "EC0Y", "EX0S", "EY0S"]),
                    dict(polynomial=["EXX", "EYY", "EZZ"], degrees=np.array([1])),
                    dict(backlash=["EXX", "EYY", "EBB", "ECC"]),
                ],
            ),
            fit=dict(
                estimate="gauss-newton",
                machine="machine",
                observations=["table"],
                parameters=["dxt", "dyt", "dzt", "E?0?", "EYY[1]", "EZZ[1]", "E??[b]", "table.*"],
                robust="tukey",
            ),
        ),
    )
    given = abbe.run(recipe, base="pipelines")
    read = abbe.run("pipelines/first-steps.yaml")
    is_same = given.fits["fit"].to_json() == read.fits["fit"].to_json()
    assert is_same
    assert given.record["inputs"][0]["file"] == "pipelines/recipe.json"
    assert given.report().startswith("<!DOCTYPE html>")


def test_a_saved_calibration_says_the_same(tmp_path: Path) -> None:
    run = abbe.run("pipelines/first-steps.yaml")
    fit = run.fits["fit"]
    poses = {"X_mm": [0.0, 150.0], "Y_mm": [10.0, -20.0], "Z_mm": [0.0, 30.0], "B_deg": [0.0, 90.0], "C_deg": [0.0, 45.0]}
    saved = abbe.read_calibration(run.write(tmp_path) / "fit.calibration.json")
    is_same = saved.to_json() == fit.to_json()
    assert is_same
    for name, column in fit.predict(poses).items():
        assert np.array_equal(column, saved.predict(poses)[name])
