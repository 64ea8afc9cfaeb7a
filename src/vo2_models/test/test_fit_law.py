"""Fits of every law, and the choice between them on excursions that the fits have not seen."""

import numpy as np
import pytest
from scipy.optimize import nnls
from vo2_models.hysteresis import GPI, BoucWen, DomainEnsemble, LimitingLoop, PreisachOperator, TanhEnvelopes
from vo2_models.hysteresis.law_fit import FITTED, HELD_OUT, excursions, fit_law, rank_laws
from vo2_models.hysteresis.laws import ADDED, FITS
from vo2_models.hysteresis.laws.bounded_plays import BoundedPlays
from vo2_models.hysteresis.preisach import fit_smooth, signed_area_matrix


def _path(seed, turns=16, samples=25):
    """A full loop and excursions between random turns, 20 to 100."""
    rng = np.random.default_rng(seed)
    corners = np.r_[20.0, 100.0, 20.0, rng.uniform(30.0, 95.0, turns)]
    return np.interp(np.arange((corners.size - 1) * samples + 1) / samples, np.arange(corners.size), corners)


def _truths():
    rng = np.random.default_rng(2)
    edges = np.linspace(20.0, 100.0, 31)
    at = 0.5 * (edges[1:] + edges[:-1])
    density = np.tril(np.exp(-(((at[:, None] - 68.0) / 9.0) ** 2) - ((at[None, :] - 52.0) / 9.0) ** 2))
    middle, half = 60.0 + 6.0 * rng.normal(size=300), 4.0 * np.exp(0.2 * rng.normal(size=300))
    return {
        "preisach": PreisachOperator(edges, 0.01 * density, 1.0),
        "cs": PreisachOperator(edges, np.tril(0.01 * (density > 0.5)), 1.0),
        "gpi": GPI([0.0, 0.3, 0.6], [1.0, 0.8, 0.5], TanhEnvelopes(0.08, -5.4, 0.08, -4.6), 1.0),
        "bounded_plays": BoundedPlays([0.6, 1.2, 0.7], [0.0, 0.07, 0.2], 20.0, 100.0, 2.0, [1.0, 0.01]),
        "bouc_wen": BoucWen(0.08, 0.8, 1.5, 2.0, [1.0, 0.02]),
        "limiting_loop": LimitingLoop(0.14, 68.0, 0.18, 54.0, 0.9, 0.0, 3.0, [0.0, 0.01]),
        "domains": DomainEnsemble(middle + half, middle - half, None, 6.0, 0.0, 3.0),
    }


# a law that is a file of its own is found from its example, without an entry here
TRUTHS = {**{name: ADDED[name] for name in FITS}, **_truths()}


@pytest.mark.parametrize(
    "name", [pytest.param(name, marks=pytest.mark.slow) if name == "cs" else name for name in sorted(TRUTHS)]
)
def test_a_law_is_found_from_its_own_output(name):
    u = _path(1, turns=10 if name == "preisach" else 16)
    clean = TRUTHS[name].run(u, TRUTHS[name].settle(20.0))
    y = clean + 2e-3 * np.ptp(clean) * np.random.default_rng(3).normal(size=u.size)
    fit = fit_law(name, u, y)
    # the staircase of a finite ensemble is not that of another draw
    limit = 0.02 if name == "domains" else 0.006
    assert fit.held_out_rmse < limit * np.ptp(clean)
    fresh = _path(9)
    found = fit.law.run(fresh, fit.law.settle(20.0)) - TRUTHS[name].run(fresh, TRUTHS[name].settle(20.0))
    assert np.sqrt(np.mean(found**2)) < limit * np.ptp(clean)
    assert fit.predict(u) == pytest.approx(y, abs=0.15 * np.ptp(clean))
    assert np.sqrt(np.mean((fit.predict(u) - y) ** 2)) == pytest.approx(fit.rmse)


def test_the_right_law_comes_first_and_the_rest_follow_by_their_errors():
    u = _path(4)
    y = TRUTHS["limiting_loop"].run(u)
    y = y + 2e-3 * np.ptp(y) * np.random.default_rng(5).normal(size=u.size)
    found = rank_laws(u, y, laws=("gpi", "bouc_wen", "limiting_loop"))
    assert found[0].name == "limiting_loop"
    errors = [fit.held_out_rmse for fit in found]
    assert errors == sorted(errors) and errors[1] > 3 * errors[0]


@pytest.mark.slow
def test_reversal_curves_of_an_sma_like_loop_are_predicted_better_than_by_plain_preisach():
    rng = np.random.default_rng(0)
    corners = np.r_[
        20.0, 100.0, 20.0, np.ravel([[t, 20.0] for t in rng.permutation(np.linspace(45, 95, 14))])
    ]
    u = np.interp(np.arange((corners.size - 1) * 25 + 1) / 25, np.arange(corners.size), corners)
    y = LimitingLoop(0.12, 70.0, 0.16, 50.0, 0.9, 0.0, 4.0, [0, 0.004]).run(u) + 0.02 * rng.normal(
        size=u.size
    )
    train = excursions(u) % HELD_OUT != HELD_OUT - 1
    plain = []
    for level in (5, 10, 20, 30):
        matrix = signed_area_matrix(u, np.linspace(20.0, 100.0, level + 1))
        matrix = np.c_[matrix, -matrix[:, -1:]]
        w = nnls(matrix[train], y[train], maxiter=100 * matrix.shape[1])[0]
        plain.append(np.sqrt(np.mean((matrix @ w - y)[~train] ** 2)))
    assert fit_law("preisach", u, y).held_out_rmse < 0.9 * min(plain)
    assert fit_law("limiting_loop", u, y).held_out_rmse < 0.6 * min(plain)


def test_a_single_loop_holds_nothing_out():
    u = np.r_[np.linspace(20.0, 100.0, 40), np.linspace(100.0, 20.0, 40)]
    fit = fit_law("limiting_loop", u, TRUTHS["limiting_loop"].run(u))
    assert np.isnan(fit.held_out_rmse) and fit.rmse < 1e-3
    few = rank_laws(u[::4], TRUTHS["limiting_loop"].run(u[::4]), laws=("gpi", "limiting_loop"))
    assert [fit.name for fit in few] == ["limiting_loop"]  # twelve plays need more samples


@pytest.mark.parametrize(("level", "noise"), [(10, 0.0), (20, 1e-3), (40, 0.0)])
def test_few_samples_on_a_fine_grid_never_fail(level, noise):
    """61 samples of two and a half legs leave most of the plane open."""
    v = np.r_[np.linspace(0, 1, 20), np.linspace(1, 0.3, 20), np.linspace(0.3, 0.8, 21)]
    truth = PreisachOperator(np.linspace(0, 1, 31), np.ones(465))
    u = truth(v) + noise * np.random.default_rng(1).normal(size=61)
    fit = fit_smooth(v, u, np.linspace(0, 1, level + 1), strengths=(1e-1, 1e-5, 1e-9))
    assert fit.rmse < 0.01 * np.ptp(u)
    assert np.all(fit.operator.density >= 0)
    constant = fit_smooth(v, np.full(61, 3.0), np.linspace(0, 1, level + 1), strengths=(1e-1,))
    assert np.max(np.abs(constant.residual)) < 1e-9


@pytest.mark.parametrize(
    ("call", "message"),
    [
        (
            lambda: fit_law("magic", [0, 1, 0], [0, 1, 0]),
            r"law: found 'magic', need one of preisach, cs, gpi",
        ),
        (lambda: fit_law("gpi", [0, np.nan, 0], [0, 1, 0]), r"u: found nan at index \(1,\)"),
        (lambda: fit_law("gpi", [0, 1, 0], [1, 1, 1]), r"y: found 3 samples that do not vary"),
        (lambda: fit_law("gpi", [0, 1, 0], [0, 1]), r"y: found 2 value\(s\), need 3"),
        (
            lambda: fit_law("gpi", [0, 1, 0], [0, 1, 0], groups=[0]),
            r"groups: found shape \(1,\), need \(3,\)",
        ),
        (lambda: rank_laws([0, 1, 0], [0, 1, 0], laws=("gpi",)), r"gpi: v: found 3 samples, need at least"),
    ],
)
def test_bad_input_is_named(call, message):
    with pytest.raises(ValueError, match=message):
        call()


def test_every_fitted_law_is_tested():
    assert set(FITTED) - set(TRUTHS) == {"egpi"}
