"""Calibration of machine tools and coordinate measuring machines, with uncertainties.

A recipe says what was measured, on which machine, and what is to be estimated. `abbe.run` runs one, from a file or a
dict, on files or on tables in memory; `abbe.check` says before what it could determine. Results are those of the
command line, to the last bit.

>>> import abbe
>>> run = abbe.run("pipelines/first-steps.yaml")
>>> fit = run.fits["fit"]
>>> fit["EC0B"].unit, fit["EC0B"].status
('rad', 'estimated')
"""

from ._abbe import __version__
from ._artefact import Artefact, artefact
from ._errors import AbbeError, AbbeWarning, DataError, RecipeError
from ._problem import Factor, Problem, combine
from ._run import Calibration, Fit, Fits, Planned, Run, Value, Verdict, check, problems, read_calibration, run
from ._table import Covariance, Table

__all__ = [
    "AbbeError",
    "AbbeWarning",
    "Artefact",
    "Calibration",
    "Covariance",
    "DataError",
    "Factor",
    "Fit",
    "Fits",
    "Planned",
    "Problem",
    "RecipeError",
    "Run",
    "Table",
    "Value",
    "Verdict",
    "__version__",
    "artefact",
    "check",
    "combine",
    "problems",
    "read_calibration",
    "run",
]
