"""Problems: derivatives by differences, parts that make the whole, and an estimator of one's own."""

from __future__ import annotations

import numpy as np
import pytest

import abbe


@pytest.mark.parametrize("recipe", ["tango-hu40t-exact", "samba-exact", "mfb-ucp710-exact"])
@pytest.mark.filterwarnings("ignore::abbe.AbbeWarning")
def test_derivatives_are_those_of_the_residuals(recipe: str) -> None:
    rng = np.random.default_rng(1)
    for problem in abbe.problems(f"pipelines/{recipe}.yaml").values():
        # Every unknown by what moves no residual by more than a micrometre.
        scale = 1e-3 / np.abs(problem.linearise(problem.start)[1]).max(axis=0)
        x = problem.start + scale * rng.standard_normal(len(problem.names))
        residuals, jacobian = problem.linearise(x)
        assert jacobian.shape == (problem.equations, len(problem.names))
        assert np.array_equal(residuals, problem.residuals(x))
        direction = scale * rng.standard_normal(len(problem.names))
        change = problem.residuals(x + direction) - problem.residuals(x - direction)
        expected = 2 * jacobian @ direction
        assert np.abs(change - expected).max() < 1e-5 * np.abs(expected).max()


@pytest.mark.parametrize("count", [1, 2, 7])
def test_parts_make_the_whole(count: int) -> None:
    problem = abbe.problems("pipelines/tango-hu40t.yaml")["fit-S3"]
    x = problem.start
    whole, parts = problem.factor(x), problem.parts(count)
    assert sum(part.rows for part in parts) == problem.rows
    assert sum(part.equations for part in parts) == problem.equations
    combined = abbe.combine(part.factor(x) for part in parts)
    assert combined.rows == whole.rows
    assert combined.cost == pytest.approx(whole.cost, rel=1e-10)
    assert combined.remaining_cost == pytest.approx(whole.remaining_cost, rel=1e-9)
    # The factor is one up to signs of its rows; the information is not.
    one, other = (factor.triangle.T @ factor.triangle for factor in (whole, combined))
    scale = np.sqrt(np.outer(np.diag(one), np.diag(one)))
    assert np.abs((one - other) / scale).max() < 1e-12
    uncertainties = np.sqrt(np.diag(np.linalg.inv(one)))
    assert np.all(np.abs(whole.step() - combined.step()) < 1e-6 * uncertainties)


def test_the_triangle_is_that_of_the_rows() -> None:
    problem = abbe.problems("pipelines/tango-hu40t.yaml")["fit-S2"]
    residuals, jacobian = problem.linearise(problem.start)
    weighted = jacobian / problem.standard_uncertainties[:, None]
    factor = problem.factor(problem.start)
    assert np.allclose(factor.triangle.T @ factor.triangle, weighted.T @ weighted, rtol=1e-9, atol=1e-3)
    right = weighted.T @ (residuals / problem.standard_uncertainties)
    assert np.allclose(factor.triangle.T @ factor.right, right, rtol=1e-8, atol=1e-3)
    assert np.array_equal(np.triu(factor.triangle), factor.triangle)


def test_an_own_estimator_finds_what_ours_finds() -> None:
    """Gauss and Newton's iteration on factors of parts, in ten lines."""
    run = abbe.run("pipelines/tango-hu40t-exact.yaml")
    problem, fit = abbe.problems("pipelines/tango-hu40t-exact.yaml")["fit-S3"], run.fits["fit-S3"]
    x, parts = problem.start, problem.parts(4)
    for _ in range(20):
        step = abbe.combine(part.factor(x) for part in parts).step()
        x = x + step
        if np.abs(step).max() < 1e-13:
            break
    known = {name: fit[name] for name in problem.names}
    apart = [abs(value - known[name].value) for name, value in zip(problem.names, x)]
    assert max(apart) < 1e-9


def test_the_problem_of_a_fit_is_its_problem() -> None:
    run = abbe.run("pipelines/first-steps.yaml")
    problem = run.fits["fit"].problem
    x = [run.fits["fit"][name].value for name in problem.names]
    residuals = run.fits["fit"].residuals["residual_um"]
    assert np.allclose(problem.residuals(x) * 1e3, residuals, rtol=0, atol=1e-9)


def test_wrong_use_is_refused() -> None:
    problem = abbe.problems("pipelines/first-steps.yaml")["fit"]
    with pytest.raises(abbe.RecipeError, match="one for each unknown"):
        problem.residuals([0.0])
    with pytest.raises(abbe.RecipeError, match="0 parts"):
        problem.parts(0)
    with pytest.raises(ValueError, match="at least one"):
        abbe.combine([])
    other = abbe.problems("pipelines/tango-hu40t.yaml")["fit-S1"]
    with pytest.raises(ValueError, match="of the same unknowns"):
        abbe.combine([problem.factor(problem.start), other.factor(other.start)])
