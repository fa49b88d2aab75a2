"""Predictions and corrections at poses: a law, and what the command line writes."""

from __future__ import annotations

import csv
import io
import subprocess
from pathlib import Path
from typing import Callable

import numpy as np
import pytest

import abbe

Results = Callable[[str], Path]


def table_of(text: str) -> dict[str, list[float]]:
    rows = list(csv.DictReader(line for line in io.StringIO(text) if not line.startswith("#")))
    return {name: [float(row[name]) for row in rows] for name in rows[0] if all(row[name] for row in rows)}


def test_a_prediction_is_the_exported_table(tmp_path: Path) -> None:
    """The table `volumetric.csv`, whose errors and covariances have a code of their own."""
    text = Path("pipelines/first-steps.yaml").read_text().replace("data/", f"{Path('pipelines').resolve()}/data/")
    grid = "{ points: { X: 2, Y: 3, Z: 2, B: 3, C: 2 }, axes: { X: { from_mm: -90, to_mm: 70 }, Y: { from_mm: -50, to_mm: 20 },"
    grid += " Z: { from_mm: 5, to_mm: 60 }, B: { from_deg: -100, to_deg: 30 }, C: { from_deg: -20, to_deg: 170 } } }"
    (tmp_path / "recipe.yaml").write_text(f"{text}  errors: {{ export: volumetric, of: fit, grid: {grid} }}\n")
    run = abbe.run(tmp_path / "recipe.yaml")
    expected = table_of(run.exports["errors"]["volumetric.csv"].decode())
    poses = {name: expected[name] for name in ["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg"]}
    # The table is that of moves in the positive direction.
    poses |= {f"dir_{axis}": [1.0] * len(expected["X_mm"]) for axis in "XYZBC"}
    found = run.fits["fit"].predict(poses)
    assert found.rows == len(expected["X_mm"]) == 72
    for letter in "xyz":
        assert np.allclose(found[f"error_{letter}_um"], expected[f"{letter}_um"], rtol=1e-6, atol=1e-6)
        variances = expected[f"{letter}{letter}_um2"]
        assert np.allclose(found[f"uncertainty_{letter}_um"], np.sqrt(variances), rtol=1e-5, atol=1e-6)
    assert max(expected["size_um"]) > 5
    # Without directions it is the mean of both.
    there, back = (
        run.fits["fit"].predict({**poses, **{name: [sign] * 72 for name in poses if name.startswith("dir")}})
        for sign in (1, -1)
    )
    mean = run.fits["fit"].predict({name: column for name, column in poses.items() if not name.startswith("dir")})
    for name in ["error_x_um", "error_y_um", "error_z_um"]:
        assert np.allclose(mean[name], (there[name] + back[name]) / 2, atol=5e-3)
    assert np.abs(there["error_x_um"] - back["error_x_um"]).max() > 5


@pytest.mark.parametrize("options", [{}, {"correct": "five-axes"}, {"method": "first-order", "correct": "X,Z"}])
def test_a_correction_is_that_of_the_command_line(
    options: dict[str, str], program: Path, by_command_line: Results, tmp_path: Path
) -> None:
    rng = np.random.default_rng(3)
    names = ["X_mm", "Y_mm", "Z_mm", "B_deg", "C_deg"]
    poses = {name: rng.uniform(-50, 50, 30).round(3) for name in names} | {"S_deg": np.zeros(30)}
    poses["Z_mm"] += 300
    lines = [",".join(poses), *(",".join(map(repr, map(float, row))) for row in zip(*poses.values()))]
    (tmp_path / "points.csv").write_text("\n".join(lines) + "\n")
    calibration = by_command_line("tango-hu40t-exact") / "fit-S3.calibration.json"
    command: list[object] = [program, "compensate", calibration, tmp_path / "points.csv"]
    command += [f"--{name}={value}" for name, value in options.items()]
    command += ["--out", tmp_path / "corrected.csv", "--report", tmp_path / "errors.csv"]
    subprocess.run([str(part) for part in command], check=True, capture_output=True, timeout=120)
    axes = {"correct": options["correct"].split(",")} if "," in options.get("correct", "") else {}
    found = abbe.read_calibration(calibration).compensate(poses, **{**options, **axes})  # type: ignore[arg-type]
    corrected = table_of((tmp_path / "corrected.csv").read_text())
    errors = table_of((tmp_path / "errors.csv").read_text())
    for name in names:
        assert np.allclose(found[name], corrected[name], rtol=0, atol=1e-9), name
    told = [name for name in found if name.startswith(("before", "after", "standard"))]
    assert len(told) == 9
    for name in told:
        assert np.allclose(found[name], errors[name], rtol=0, atol=1e-6), name
    assert np.abs(np.array(corrected["X_mm"]) - poses["X_mm"]).max() > 1e-3


def test_corrected_commands_take_the_error_away() -> None:
    """Compensated commands bring the tip of the calibrated machine to where the nominal one would be."""
    fit = abbe.run("pipelines/tango-hu40t-exact.yaml").fits["fit-S3"]
    rng = np.random.default_rng(5)
    poses = {"X_mm": rng.uniform(-50, 50, 40), "Y_mm": rng.uniform(-50, 50, 40), "Z_mm": rng.uniform(200, 400, 40)}
    poses |= {"B_deg": rng.uniform(-60, 60, 40), "C_deg": rng.uniform(-90, 90, 40)}
    poses |= {"dir_X": np.ones(40), "dir_Y": np.ones(40), "dir_B": np.ones(40), "dir_C": np.ones(40)}
    poses["S_deg"] = np.zeros(40)
    before = fit.predict(poses)
    corrected = fit.compensate(poses)
    after = fit.predict({**poses, **{name: corrected[name] for name in corrected if name in poses}})
    nominal = before.numbers("x_mm", "y_mm", "z_mm") - before.numbers("error_x_um", "error_y_um", "error_z_um") / 1e3
    left = np.abs(after.numbers("x_mm", "y_mm", "z_mm") - nominal).max()
    error = np.abs(before.numbers("error_x_um", "error_y_um", "error_z_um")).max()
    assert error > 5 and left < 1e-8
    told = corrected.numbers("before_x_um", "before_y_um", "before_z_um")
    assert np.allclose(told, before.numbers("error_x_um", "error_y_um", "error_z_um"), atol=1e-6)
    poses["Z_mm"][7] = 900
    with pytest.raises(abbe.DataError, match="row 8: Z stands at 900"):
        fit.compensate(poses)
    with pytest.raises(abbe.RecipeError, match="five-axes"):
        fit.compensate(poses, correct="everything")
