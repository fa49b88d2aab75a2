"""Tables in the place of files: from NumPy, pandas, polars and pyarrow, with the rules of columns in files."""

from __future__ import annotations

import csv
import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import abbe

TOUCHES = "pipelines/data/tango-hu40t/realistic/touches.csv"
RECIPE = "pipelines/first-steps.yaml"


def columns() -> dict[str, list[Any]]:
    with open(TOUCHES, newline="") as file:
        rows = list(csv.DictReader(line for line in file if not line.startswith("#")))

    def cell(name: str, text: str) -> Any:
        return float(text) if "_mm" in name or "_deg" in name or name.startswith("dir_") or name == "time_s" else text

    return {name: [cell(name, row[name]) for row in rows] for name in rows[0]}


def arrays() -> dict[str, Any]:
    return {name: np.array(cells) for name, cells in columns().items()}


def structured() -> Any:
    found = arrays()
    table = np.empty(len(next(iter(found.values()))), dtype=[(name, cells.dtype) for name, cells in found.items()])
    for name, cells in found.items():
        table[name] = cells
    return table


def with_pandas() -> Any:
    return pytest.importorskip("pandas").DataFrame(columns())


def with_polars() -> Any:
    polars = pytest.importorskip("polars")
    table = polars.DataFrame(columns())
    # In two chunks, and names as numbers and as categories.
    table = polars.concat([table[:100], table[100:]], rechunk=False)
    return table.with_columns(polars.col("feature").cast(polars.Int32), polars.col("group").cast(polars.Categorical))


def with_pyarrow() -> Any:
    pyarrow = pytest.importorskip("pyarrow")
    table = pyarrow.table(columns())
    return pyarrow.concat_tables([table.slice(0, 57), table.slice(57)])


def comparable(calibration: str) -> dict[str, Any]:
    """All but the digest of the data, which is that of the table."""
    found: dict[str, Any] = json.loads(calibration)
    for record in found["data"]:
        record.pop("sha256")
    return found


@pytest.mark.parametrize("table", [columns, arrays, structured, with_pandas, with_polars, with_pyarrow])
def test_a_table_gives_what_its_file_gives(table: Any, tmp_path: Path) -> None:
    """The same values to the last bit, and the same files; the recipe's file of touches is not read."""
    from_file = abbe.run(RECIPE)
    text = Path(RECIPE).read_text().replace("touches.csv", "nowhere.csv")
    recipe = tmp_path / "first-steps.yaml"
    recipe.write_text(text.replace("data/", f"{Path('pipelines').resolve()}/data/"))
    from_table = abbe.run(recipe, data={"touches": table()})
    ours, theirs = comparable(from_table.fits["fit"].to_json()), comparable(from_file.fits["fit"].to_json())
    ours["data"] = theirs["data"] = None
    for outlier in [*ours["outliers"], *theirs["outliers"]]:
        del outlier["file"], outlier["line"]
    # Large texts are not compared by pytest, which would look for their differences for minutes.
    assert set(ours) == set(theirs)
    assert [key for key in theirs if ours[key] != theirs[key]] == []
    for name, column in from_file.fits["fit"].residuals.items():
        # A table has rows and no lines.
        if name not in ("file", "line"):
            same = from_table.fits["fit"].residuals[name]
            assert np.array_equal(same, column) or np.array_equal(same, column, equal_nan=True), name


def test_the_record_names_the_table() -> None:
    table = arrays()
    one, same = (abbe.run(RECIPE, data={"touches": table}).record["inputs"] for _ in range(2))
    [first] = [record for record in one if record["file"].endswith("touches.csv")]
    assert first in same
    table["X_mm"] = table["X_mm"].copy()
    table["X_mm"][0] += 1e-9
    other = abbe.run(RECIPE, data={"touches": table}).record["inputs"]
    assert first not in other and len(other) == len(one)


def unaligned() -> Any:
    """Fields of a structured array that begin at odd bytes, backwards."""
    found = arrays()
    fields = [("odd", "u1"), *((name, cells.dtype) for name, cells in found.items())]
    table = np.zeros(len(next(iter(found.values()))), dtype=fields)[::-1]
    for name, cells in found.items():
        table[name] = cells
    return table


def foreign() -> Any:
    """Numbers of another processor, of other sizes, that cannot be written, and with a mask that hides none."""
    found = arrays()
    found["X_mm"] = found["X_mm"].astype(">f8")
    found["Y_mm"].flags.writeable = False
    found["Z_mm"] = np.ma.array(found["Z_mm"])
    found["feature"], found["group"] = found["feature"].astype(np.int16), found["group"].astype(np.uint8)
    found["dir_X"] = found["dir_X"].astype(np.float32)
    return found


def series(library: str) -> Any:
    frame = {"pandas": with_pandas, "polars": with_polars}[library]()
    return {name: frame[name] for name in frame.columns}


@pytest.mark.parametrize("table", [unaligned, foreign, lambda: series("pandas"), lambda: series("polars")])
def test_arrays_of_any_kind_are_read(table: Any) -> None:
    expected, found = (abbe.run(RECIPE, data={"touches": touches}).fits["fit"] for touches in (columns(), table()))
    assert list(found.parameters["value"]) == list(expected.parameters["value"])


@pytest.mark.parametrize("dtype", ["f8", "f4", "i1", "u1", "i2", "u2", "i4", "u4", "i8", "u8", ">f8", ">i4", "f2", "?"])
def test_numbers_of_all_types_are_the_numbers(dtype: str) -> None:
    """The digest of a table is that of its cells: that of an array is that of the list of its numbers."""
    recipe = {"abbe": 1, "stages": {"one": {"ingest": "csv", "path": "one.csv"}}}

    def digest(cells: Any) -> Any:
        [record] = [it for it in abbe.run(recipe, data={"one": {"n": cells}}).record["inputs"] if it["file"] == "one.csv"]
        return record["sha256"]

    numbers = np.array([0, 1, 100, 3], dtype=dtype)
    assert digest(numbers) == digest(numbers.tolist()) == digest(np.repeat(numbers, 3)[::3])
    assert digest(numbers) != digest(numbers[:3]) and digest(numbers) != digest(numbers[::-1])


def test_a_mask_hides_numbers() -> None:
    table = arrays()
    table["Z_mm"] = np.ma.array(table["Z_mm"], mask=np.arange(len(table["Z_mm"])) == 4)
    with pytest.raises(abbe.DataError, match="row 5: `Z_mm` is empty"):
        abbe.run(RECIPE, data={"touches": table})


@pytest.mark.skipif(sys.platform != "linux", reason="the most memory so far, as Linux tells it")
@pytest.mark.parametrize("library", ["numpy", "polars", "pyarrow"])
def test_there_is_one_copy(library: str) -> None:
    """The most memory that a check takes is less than two copies of the table would."""
    program = """
import re, sys
from pathlib import Path
import numpy as np
import abbe

def most():
    return int(re.search(r"VmHWM:\\s+(\\d+)", Path("/proc/self/status").read_text())[1]) * 1024

def touches(rows):
    table = {f"a{column}_mm": np.linspace(column, 1, rows) for column in range(10)}
    match sys.argv[1]:
        case "polars":
            import polars
            return polars.DataFrame(table)
        case "pyarrow":
            import pyarrow
            return pyarrow.table(table)
    return table

recipe = {"abbe": 1, "stages": {"one": {"ingest": "csv", "path": "one.csv"}}}
abbe.check(recipe, data={"one": touches(10)})
table = touches(1_000_000)
before = most()
abbe.check(recipe, data={"one": table})
print((most() - before) / 1e6)
"""
    pytest.importorskip(library)
    done = subprocess.run([sys.executable, "-c", program, library], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    # 80 MB of numbers, 24 MB of places of rows, and what a check looks at; a second copy would be 80 MB more.
    assert 80 < float(done.stdout) < 200


def test_units_stand_in_names() -> None:
    table = arrays()
    table["X_um"] = table.pop("X_mm") * 1e3
    table["B_rad"] = np.radians(table.pop("B_deg"))
    found = abbe.run(RECIPE, data={"touches": table}).fits["fit"]
    expected = abbe.run(RECIPE).fits["fit"]
    apart = np.abs(found.parameters["value"] - expected.parameters["value"])
    assert np.all(apart <= 1e-6 * expected.parameters["standard_uncertainty"] + 1e-15)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda table: table.pop("Z_mm"), "there is no column `Z_mm`"),
        (lambda table: table.update(Z=table.pop("Z_mm")), "does not say its unit"),
        (lambda table: table.update(Z_deg=table.pop("Z_mm")), "the column `Z_deg` has the wrong unit"),
        (lambda table: table["Z_mm"].__setitem__(4, np.nan), "row 5: `Z_mm` is `NaN`, which is not a finite number"),
        (lambda table: table.update(Z_mm=table["Z_mm"][:-1]), "rows;"),
        (lambda table: table.update(Z_mm=[object()] * 3), "the column `Z_mm` holds object"),
        (lambda table: table.update(Z_mm="no column"), "the column `Z_mm` holds one text"),
        (lambda table: table.update({"Z_um": table["Z_mm"]}), "both named `Z`"),
    ],
)
def test_wrong_tables_are_refused(change: Any, message: str) -> None:
    table = arrays()
    change(table)
    with pytest.raises(abbe.AbbeError) as caught:
        abbe.run(RECIPE, data={"touches": table})
    assert message in caught.value.message, caught.value


def test_a_cell_has_its_place() -> None:
    table = arrays()
    table["Z_mm"][4] = np.inf
    with pytest.raises(abbe.DataError) as caught:
        abbe.check(RECIPE, data={"touches": table})
    assert (caught.value.line, caught.value.stage) == (None, "touches")
    assert caught.value.message == "row 5: `Z_mm` is `inf`, which is not a finite number"
    assert caught.value.file is not None and caught.value.file.endswith("touches.csv")


def test_only_tables_are_taken() -> None:
    with pytest.raises(abbe.AbbeError, match="a table was expected, not int"):
        abbe.run(RECIPE, data={"touches": 3})
    with pytest.raises(abbe.RecipeError, match="`table`, which is no ingest stage") as caught:
        abbe.run(RECIPE, data={"table": columns()})
    assert caught.value.help == "its ingest stages are: touches"
    with pytest.raises(abbe.RecipeError, match="did you mean `touches`"):
        abbe.run(RECIPE, data={"touche": columns()})


def test_a_stage_that_reads_other_files_takes_none() -> None:
    recipe = {"abbe": 1, "stages": {"log": {"ingest": "log", "control": "linuxcnc", "path": "a.log", "plan": "plan.json"}}}
    with pytest.raises(abbe.RecipeError) as caught:
        abbe.check(recipe, data={"log": columns()})
    assert caught.value.stage == "log"


def test_rows_of_pandas_keep_their_values_alone() -> None:
    """Row numbers of a part of a table are no column; an index with a name is one."""
    pandas = pytest.importorskip("pandas")
    pytest.importorskip("pyarrow")
    all_of_it = pandas.DataFrame(columns())
    kept = all_of_it[all_of_it["group"].isin([str(group) for group in range(10, 29)])]
    part = abbe.run(RECIPE, data={"touches": kept})
    labels = set(part.fits["fit"].residuals)
    assert not [name for name in labels if "index" in name]
    by_index = abbe.run(RECIPE, data={"touches": kept.set_index("feature")})
    assert by_index.fits["fit"]["EA0B"].value == pytest.approx(part.fits["fit"]["EA0B"].value, rel=1e-9)


def test_a_unit_may_stand_beside_a_name() -> None:
    """In the metadata of a column of Arrow, as in Parquet."""
    pyarrow = pytest.importorskip("pyarrow")
    pytest.importorskip("pyarrow.compute")
    table = with_pyarrow()
    place = table.schema.get_field_index("X_mm")
    x_um = pyarrow.compute.multiply(table.column("X_mm"), 1000.0)
    field = pyarrow.field("X", pyarrow.float64(), metadata={"unit": "um"})
    found = abbe.run(RECIPE, data={"touches": table.set_column(place, field, x_um)}).fits["fit"]
    expected = abbe.run(RECIPE).fits["fit"]
    assert found["EXX[b]"].value == pytest.approx(expected["EXX[b]"].value, rel=1e-6)
    wrong = pyarrow.field("X_mm", pyarrow.float64(), metadata={"unit": "deg"})
    with pytest.raises(abbe.RecipeError, match="no unit of `X_mm`"):
        abbe.check(RECIPE, data={"touches": table.set_column(place, wrong, x_um)})


def test_a_table_stands_for_a_file_of_parquet(tmp_path: Path) -> None:
    """Files of Parquet are read, and a table may stand in their place."""
    parquet = pytest.importorskip("pyarrow.parquet")
    text = Path(RECIPE).read_text().replace("ingest: csv", "ingest: parquet")
    text = text.replace("data/tango-hu40t/realistic/touches.csv", "touches.parquet")
    recipe = tmp_path / "first-steps.yaml"
    recipe.write_text(text.replace("data/", f"{Path('pipelines').resolve()}/data/"))
    given = abbe.run(recipe, data={"touches": with_pyarrow()})
    parquet.write_table(with_pyarrow(), tmp_path / "touches.parquet")
    read = abbe.run(recipe)
    assert list(given.fits["fit"].parameters["value"]) == list(read.fits["fit"].parameters["value"])
    assert given.record["inputs"] != read.record["inputs"]


def test_results_are_taken_by_other_libraries() -> None:
    pandas, polars, pyarrow = (pytest.importorskip(name) for name in ("pandas", "polars", "pyarrow"))
    table = abbe.run(RECIPE).fits["fit"].parameters
    values, names = list(table["value"]), list(table["name"])
    for frame in (pandas.DataFrame(dict(table)), pandas.DataFrame.from_arrow(table), polars.DataFrame(table)):
        assert list(frame["name"]) == names and list(frame["value"]) == values
    assert pyarrow.table(table).column("value").to_pylist() == values
    assert [dict(table)["value"][0], np.asarray(table)[0]["value"]] == [values[0]] * 2
    assert "<table>" in table._repr_html_() and "EC0B" in repr(table)


def test_missing_numbers_stay_missing() -> None:
    polars = pytest.importorskip("polars")
    figures = next(iter(abbe.run(RECIPE).verdicts.values())).figures
    limits = polars.DataFrame(figures)["limit"]
    assert limits.null_count() == int(np.isnan(figures["limit"]).sum()) > 0
