"""Errors as exceptions, progress, Ctrl-C, and the lock of the interpreter."""

from __future__ import annotations

import signal
import subprocess
import sys
import textwrap
import threading
import time
import warnings
from typing import Any

import pytest

import abbe

RECIPE = "pipelines/first-steps.yaml"


def recipe(**changed: Any) -> dict[str, Any]:
    fit = {"estimate": "gauss-newton", "machine": "machine", "observations": ["table"], "parameters": ["E?0?"], **changed}
    return {"abbe": 1, "stages": {"fit": fit}}


def test_errors_have_their_place() -> None:
    with pytest.raises(abbe.RecipeError) as caught:
        abbe.run("pipelines/nowhere.yaml")
    assert "does not exist" in caught.value.message and isinstance(caught.value, abbe.AbbeError)
    with pytest.raises(abbe.RecipeError) as caught:
        abbe.check(recipe(machin="machine"))
    error = caught.value
    assert error.file == "recipe.json" and error.line is not None and error.stage == "fit"
    assert str(error).startswith(f"recipe.json:{error.line}:{error.column}: stage `fit`: {error.message}")
    with pytest.raises(TypeError, match="a recipe holds"):
        abbe.run({"abbe": 1, "stages": {"a": object()}})
    with pytest.raises(TypeError, match="`base` is for recipes without a file"):
        abbe.run(RECIPE, base="pipelines")


def test_a_setting_has_its_way() -> None:
    text = {"abbe": 1, "stages": {"touches": {"ingest": "csv", "path": "a.csv", "skip_lines": -1}}}
    with pytest.raises(abbe.RecipeError) as caught:
        abbe.check(text)
    assert (caught.value.stage, caught.value.setting) == ("touches", ("skip_lines",))


def test_progress_is_told_here() -> None:
    events: list[dict[str, Any]] = []
    threads = set[int]()

    def hear(event: dict[str, Any]) -> None:
        events.append(event)
        threads.add(threading.get_ident())

    abbe.run(RECIPE, progress=hear)
    assert threads == {threading.get_ident()}
    kinds = {event["event"] for event in events}
    assert kinds == {"started", "iteration"}
    assert {event["stage"] for event in events} == {"touches", "fit", "judge"}


def test_what_progress_raises_ends_the_run() -> None:
    def hear(event: dict[str, Any]) -> None:
        raise ZeroDivisionError(event["stage"])

    with pytest.raises(ZeroDivisionError, match="touches"):
        abbe.run(RECIPE, progress=hear)


def test_time_is_limited() -> None:
    with pytest.raises(abbe.DataError, match="time limit") as caught:
        abbe.run("pipelines/tango-uncertainty.yaml", time_limit_s=0.0)
    assert caught.value.help == "allow more time, or make the recipe smaller"
    with pytest.raises(ValueError, match="time_limit_s"):
        abbe.run(RECIPE, time_limit_s=-1)


def test_others_work_meanwhile() -> None:
    """The lock of the interpreter is free: another thread goes on while a recipe runs."""
    counted, done = [0], threading.Event()

    def count() -> None:
        while not done.is_set():
            counted[0] += 1
            time.sleep(0)

    thread = threading.Thread(target=count)
    thread.start()
    try:
        before = counted[0]
        abbe.run(RECIPE)
        meanwhile = counted[0] - before
    finally:
        done.set()
        thread.join()
    assert meanwhile > 100


def test_runs_at_the_same_time_are_the_same() -> None:
    found: list[str] = []
    threads = [threading.Thread(target=lambda: found.append(abbe.run(RECIPE).fits["fit"].to_json())) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert len(found) == 3 and len(set(found)) == 1


@pytest.mark.skipif(sys.platform == "win32", reason="signals of Unix")
def test_ctrl_c_ends_a_run() -> None:
    program = textwrap.dedent(
        """
        import abbe
        def hear(event):
            print(event["event"], flush=True)
        try:
            abbe.run("pipelines/tango-uncertainty.yaml", progress=hear)
        except KeyboardInterrupt:
            print("interrupted", flush=True)
        """
    )
    child = subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True)
    try:
        assert child.stdout is not None
        lines = iter(child.stdout.readline, "")
        assert any(line.strip() == "iteration" for line in lines)
        child.send_signal(signal.SIGINT)
        assert list(lines)[-1].strip() == "interrupted"
        assert child.wait(timeout=60) == 0
    finally:
        child.kill()
        child.wait()


def test_remarks_are_warnings() -> None:
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        with open("pipelines/data/tango-hu40t/realistic/touches.csv") as file:
            head, *rows = [line.split(",") for line in file.read().splitlines() if not line.startswith("#")]
        table = {name: [row[place] for row in rows] for place, name in enumerate(head)}
        table["X_mm"][7] = None  # type: ignore[call-overload]
        text = {
            "abbe": 1,
            "stages": {"touches": {"ingest": "csv", "path": "touches.csv", "no_data": ["nan"]}},
        }
        abbe.check(text, data={"touches": table})
    assert ["1 row holds a mark of `no_data`" in str(warning.message) for warning in caught] == [True]
    assert issubclass(caught[0].category, abbe.AbbeWarning)


def test_a_run_shows_itself() -> None:
    run = abbe.run(RECIPE)
    assert "Location errors" in run._repr_html_() and "EC0B" in run._repr_html_()
    assert run.title == "Location errors from the machine's own table"
    with pytest.raises(KeyError, match="there are fit"):
        run.fits["fits"]
    with pytest.raises(KeyError, match="no value"):
        run.fits["fit"]["EXX[9]"]
    assert run.fits["fit"].fit_report["rank"] == run.fits["fit"].fit_report["unknowns"]


def test_a_failed_stage_is_an_exception_that_waits() -> None:
    text = {
        "abbe": 1,
        "stages": {
            "touches": {"ingest": "csv", "path": "data/tango-hu40t/realistic/touches.csv", "ignore": {"feature": [1, 2]}},
            "table": {
                "artefact": "facets",
                "from": "touches",
                "nominal": "data/tango-hu40t/realistic/facets.csv",
                "standard_uncertainty_um": 1.6,
            },
            "machine": {
                "model": "serial-chain",
                "chain": "w C' B' X' b Z Y (S) t",
                "tool_length_mm": 326.674,
                "stylus_radius_mm": 3,
                "errors": [{"location": ["EA0B", "EC0B"]}, {"polynomial": ["EXX", "EYY", "EZZ"], "degrees": [1]}],
            },
            "good": {
                "estimate": "gauss-newton",
                "machine": "machine",
                "observations": ["table"],
                "parameters": ["dxt", "dyt", "dzt", "EA0B", "table.*"],
            },
            "scales": {
                "estimate": "gauss-newton",
                "machine": "machine",
                "observations": ["table"],
                "parameters": ["dxt", "dyt", "dzt", "E*", "table.*"],
            },
        },
    }
    run = abbe.run(text, base="pipelines")
    assert list(run.fits) == ["good"] and not run.passes
    assert isinstance(run.failures["scales"], abbe.DataError)
    assert run.failures["scales"].stage == "scales" and run.record["failures"][0]["stage"] == "scales"
