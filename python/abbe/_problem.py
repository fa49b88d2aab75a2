"""Problems for estimators of one's own."""

from __future__ import annotations

from typing import Iterable

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import _abbe


def _values(x: ArrayLike) -> list[float]:
    return [float(value) for value in np.asarray(x, dtype=np.float64).ravel()]


class Problem:
    """Model, observations and unknowns of an estimate: residuals and their derivatives, for an estimator of one's own.

    A step of Gauss and Newton's iteration, by parts of the rows:

    >>> import abbe, numpy as np
    >>> problem = abbe.problems("pipelines/tango-hu40t-exact.yaml")["fit-S2"]
    >>> x = problem.start
    >>> factors = [part.factor(x) for part in problem.parts(3)]
    >>> step = abbe.combine(factors).step()
    >>> residuals, jacobian = problem.linearise(x)
    >>> weighted = jacobian / problem.standard_uncertainties[:, None]
    >>> expected = np.linalg.lstsq(weighted, -residuals / problem.standard_uncertainties, rcond=None)[0]
    >>> np.allclose(step, expected, rtol=1e-6, atol=1e-12)
    True
    """

    def __init__(self, problem: _abbe.Problem) -> None:
        self._problem = problem

    @property
    def names(self) -> list[str]:
        """Names of the unknowns."""
        return self._problem.names

    @property
    def units(self) -> list[str]:
        """Units of the unknowns."""
        return self._problem.units

    @property
    def rows(self) -> int:
        """Number of rows."""
        return self._problem.rows

    @property
    def equations(self) -> int:
        """Number of equations."""
        return self._problem.equations

    @property
    def start(self) -> NDArray[np.float64]:
        """Start values of the unknowns."""
        return np.frombuffer(self._problem.start())

    @property
    def standard_uncertainties(self) -> NDArray[np.float64]:
        """Standard uncertainties of the equations, mm or rad."""
        return np.frombuffer(self._problem.uncertainties())

    def residuals(self, x: ArrayLike) -> NDArray[np.float64]:
        """Residuals at `x`, mm or rad."""
        return np.frombuffer(self._problem.residuals(_values(x)))

    def linearise(self, x: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Residuals at `x`, mm or rad, and their derivatives: equations x unknowns, in the units of the unknowns."""
        residuals, jacobian = self._problem.linearise(_values(x))
        return np.frombuffer(residuals), np.frombuffer(jacobian).reshape(-1, len(self.names))

    def factor(self, x: ArrayLike) -> Factor:
        """The triangular factor of residuals and derivatives at `x`, in rows of unit variance."""
        return Factor(self._problem.factor(_values(x)))

    def parts(self, count: int) -> list[Problem]:
        """The problem in parts, each with its share of the rows.

        Rows that are correlated cannot be parted (`RecipeError`).
        """
        return [Problem(part) for part in self._problem.parts(count)]

    def __repr__(self) -> str:
        return f"<Problem: {self.equations} equations, {len(self.names)} unknowns>"


class Factor:
    """What rows tell of the unknowns: the triangular factor of `[J | r]`, in rows of unit variance."""

    def __init__(self, factor: _abbe.Factor) -> None:
        self._factor = factor

    @property
    def rows(self) -> int:
        """Number of rows that went in."""
        return self._factor.rows

    @property
    def cost(self) -> float:
        """Sum of squares of the residuals in standard uncertainties."""
        return self._factor.cost

    @property
    def remaining_cost(self) -> float:
        """The same after the full step."""
        return self._factor.remaining_cost

    @property
    def triangle(self) -> NDArray[np.float64]:
        """The upper triangle R; `R.T @ R` is the information matrix."""
        return np.frombuffer(self._factor.triangle()[0]).reshape(self._factor.unknowns, -1)

    @property
    def right(self) -> NDArray[np.float64]:
        """`Q.T @ r`: the residuals in the directions of the factor."""
        return np.frombuffer(self._factor.triangle()[1])

    def step(self) -> NDArray[np.float64]:
        """The step of Gauss and Newton's iteration, in the units of the unknowns.

        Raises `ArithmeticError` if an unknown has no effect of its own.
        """
        step = self._factor.step()
        if step is None:
            raise ArithmeticError("an unknown has no effect of its own on these rows: there is no step")
        return np.frombuffer(step)

    def __repr__(self) -> str:
        return f"<Factor of {self.rows} rows, {self._factor.unknowns} unknowns>"


def combine(factors: Iterable[Factor]) -> Factor:
    """The factor of all rows of several factors: map and reduce of a problem whose parts lie at different places."""
    return Factor(_abbe.combine([factor._factor for factor in factors]))


