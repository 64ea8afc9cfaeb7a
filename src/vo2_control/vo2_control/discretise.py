"""From a continuous controller to the law that runs: order reduction with its price, Tustin, conditioning."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, replace

import control
import numpy as np
from numpy.typing import NDArray
from scipy.linalg import solve_discrete_are
from vo2_models.validation import positive_number

from vo2_control.controller import CurrentLimits, LinearController, LinearLaw
from vo2_control.generalised_plant import METRE_PER_DESIGN_UNIT, RobustDesign, generalised_plant
from vo2_control.hinf import DesignRefused, Synthesis, synthesise
from vo2_control.mu import mu_sweep
from vo2_control.sampled_loop import Margins, loop_margins

__all__ = ["Reduction", "RobustLaw", "conditioning_gain", "discrete_law", "reduce_order", "robust_law"]

Array = NDArray[np.float64]

_ALLOWED_COST = 0.05
"""The lowest order is taken whose gamma and robust performance grow by no more than this fraction."""


@dataclass(frozen=True)
class Reduction:
    """A controller of lower order and what the reduction costs.

    Attributes
    ----------
    order : states kept
    controller : the reduced K(s) [A/um]
    gamma, robust_stability, robust_performance : as in `Synthesis`, of the reduced controller; infinite where
        the loop is unstable
    """

    order: int
    controller: control.StateSpace
    gamma: float
    robust_stability: float
    robust_performance: float


@dataclass(frozen=True)
class RobustLaw:
    """A checked discrete controller with its history: synthesis, every reduction tried, the one taken, margins.

    Attributes
    ----------
    law : ready for `LinearController`, from metres to ampere
    synthesis : the continuous design of full order
    reductions : every order tried, highest first
    taken : the one that was discretised
    worst : margins of the sampled loop at the worst corner of uncertainty
    """

    law: LinearLaw
    synthesis: Synthesis
    reductions: tuple[Reduction, ...]
    taken: Reduction
    worst: Margins

    def controller(self, limits: CurrentLimits) -> LinearController:
        """A controller of its own memory with this law."""
        return LinearController(self.law, limits)


def reduce_order(
    design: RobustDesign, controller: control.StateSpace, *, fastest_rad_s: float = np.inf
) -> list[Reduction]:
    """Return the controller at every order, highest first, by balanced residualisation (exact at zero frequency).

    Parameters
    ----------
    design : for the price of each order
    controller : stable K(s) [A/um]
    fastest_rad_s : modes faster than this are replaced by their static gain beforehand: the optimal controller
        of (8.5) to (8.9) has a pole near -1e7 that no sampled loop can realise
    """
    plant = generalised_plant(design)
    slow = _residualise_fast(controller, fastest_rad_s)
    found = [_priced(plant, slow)]
    for order in range(slow.nstates - 1, 0, -1):
        with warnings.catch_warnings():
            # slycot tells that it went below the wanted order where states carry nothing; seen in `nstates`
            warnings.simplefilter("ignore")
            reduced = control.balred(slow, order, method="matchdc")
        if reduced.nstates < found[-1].order:
            found.append(_priced(plant, reduced))
    return found


def _residualise_fast(system: control.StateSpace, fastest_rad_s: float) -> control.StateSpace:
    """Split off the modes faster than the given rate and keep their gain at zero frequency."""
    poles, vectors = np.linalg.eig(system.A)
    fast = np.abs(poles) > fastest_rad_s
    if not np.any(fast):
        return system
    to_modal = np.linalg.inv(vectors)
    b, c = to_modal @ system.B, system.C @ vectors
    static = np.real(c[:, fast] @ np.diag(-1 / poles[fast]) @ b[fast])
    return control.ss(*_real_modal(poles[~fast], b[~fast], c[:, ~fast]), system.D + static)


def _real_modal(poles: NDArray, b: NDArray, c: NDArray) -> tuple[Array, Array, Array]:
    """Real block-diagonal realisation of a set of modes closed under conjugation."""
    keep = [k for k in range(poles.size) if poles[k].imag >= 0]
    size = sum(1 if poles[k].imag == 0 else 2 for k in keep)
    a_r, b_r, c_r, at = np.zeros((size, size)), np.zeros((size, b.shape[1])), np.zeros((c.shape[0], size)), 0
    for k in keep:
        if poles[k].imag == 0:
            a_r[at, at], b_r[at], c_r[:, at] = poles[k].real, b[k].real, c[:, k].real
            at += 1
            continue
        # y = 2 Re(c x) for the pair, with the real and imaginary part of one mode as states
        re, im = poles[k].real, poles[k].imag
        a_r[at : at + 2, at : at + 2] = [[re, -im], [im, re]]
        b_r[at], b_r[at + 1] = b[k].real, b[k].imag
        c_r[:, at], c_r[:, at + 1] = 2 * c[:, k].real, -2 * c[:, k].imag
        at += 2
    return a_r, b_r, c_r


def _priced(plant: control.StateSpace, controller: control.StateSpace) -> Reduction:
    if not np.real(plant.lft(controller).poles()).max() < 0:
        return Reduction(controller.nstates, controller, np.inf, np.inf, np.inf)
    # a coarse sweep: this only ranks orders, the peaks are broad
    sweep = mu_sweep(plant, controller, np.logspace(-4, 3, 100), lower_bound=False)
    return Reduction(
        controller.nstates,
        controller,
        float(sweep.nominal.max()),
        float(sweep.robust_stability.max()),
        float(sweep.upper.max()),
    )


def conditioning_gain(a: Array, b: Array, c: Array, d: float) -> Array:
    """Return (n,) the gain that feeds the cut part of a limited output back into the law's state.

    It is the steady Kalman gain of the law driven by white noise at its input: Hanus' conditioning b/d where
    the law is minimum phase, so that a limited controller follows the error it realises; else the same with the
    zeros outside the unit circle reflected, which keeps the conditioned law a - gain c stable.

    Parameters
    ----------
    a : (n, n); b, c : (n,); d : discrete law

    Raises
    ------
    ValueError : the law has a mode on or outside the unit circle that its output does not show.
    """
    if abs(d) > 1e-12 * (np.abs(c) @ np.abs(b) + 1e-300):
        gain = b / d
        if np.abs(np.linalg.eigvals(a - np.outer(gain, c))).max(initial=0.0) < 1 - 1e-9:
            return gain
    scale = d * d + b @ b * (c @ c) * 1e-12
    try:
        p = solve_discrete_are(a.T, c[:, None], np.outer(b, b), np.array([[scale]]), s=(b * d)[:, None])
    except np.linalg.LinAlgError as error:
        raise ValueError(f"a, c: no stable conditioning of this law exists ({error})") from error
    return np.asarray((a @ p @ c + b * d) / (c @ p @ c + scale))


def discrete_law(controller: control.StateSpace, sample_period_s: float) -> LinearLaw:
    """Return the law of a continuous controller K(s) [A/um] by Tustin's rule, from metres to ampere.

    Modes faster than ten times the Nyquist frequency are replaced by their static gain first: Tustin's rule would
    turn the pole at -40830 of (8.10) into one at -0.999, an alternation that hardly decays.

    Parameters
    ----------
    controller : K(s) [A/um]
    sample_period_s : [s]
    """
    period = positive_number(sample_period_s, "sample_period_s")
    slow = _residualise_fast(control.ss(controller), 10 * np.pi / period)
    sampled = control.sample_system(slow, period, method="tustin")
    a, b, c = sampled.A, sampled.B[:, 0], sampled.C[0]
    # states of comparable size, for the bumpless start's sense of least movement
    size = np.sqrt((np.linalg.norm(b) + 1e-300) / (np.linalg.norm(c) + 1e-300))
    b, c = b / size / METRE_PER_DESIGN_UNIT, c * size
    d = float(sampled.D[0, 0]) / METRE_PER_DESIGN_UNIT
    return LinearLaw(
        a=a,
        b=np.stack([b, -b], axis=1),
        c=c,
        d=np.array([d, -d]),
        conditioning=conditioning_gain(a, b, c, d),
        sample_period_s=period,
    )


def robust_law(
    design: RobustDesign,
    sample_period_s: float,
    *,
    largest_gamma: float = 1.0,
    expected_sign: int = 0,
) -> RobustLaw:
    """Design, reduce, discretise and check: one call from weights to a controller that may run.

    Parameters
    ----------
    design : plant, uncertainty and weights
    sample_period_s : [s]
    largest_gamma, expected_sign : as `synthesise`

    Raises
    ------
    DesignRefused : with the reason; nothing that fails a check is returned.
    """
    period = positive_number(sample_period_s, "sample_period_s")
    synthesis = synthesise(design, largest_gamma=largest_gamma, expected_sign=expected_sign)
    if np.real(synthesis.controller.poles()).max() >= 0:
        raise DesignRefused("controller: found it unstable, need a stable one: a held loop would run away")
    reductions = reduce_order(design, synthesis.controller, fastest_rad_s=10 * np.pi / period)
    corners = [
        replace(design.plant, time_constant_s=design.time_constant_s * (1 + spread)).sampled(period)
        for spread in (-design.time_constant_spread, 0.0, design.time_constant_spread)
    ]
    taken, law, worst = None, None, None
    for candidate in reductions:
        if candidate.gamma > synthesis.gamma * (1 + _ALLOWED_COST):
            continue
        if candidate.robust_performance > synthesis.robust_performance * (1 + _ALLOWED_COST):
            continue
        trial = discrete_law(candidate.controller, period)
        margins = max((loop_margins(trial, c) for c in corners), key=lambda m: m.sensitivity_peak)
        if margins.stable:
            taken, law, worst = candidate, trial, margins
    if taken is None or law is None or worst is None:
        raise DesignRefused(
            f"sampled loop: found no order of the controller stable at {period:g} s over the uncertainty within "
            f"{100 * _ALLOWED_COST:.0f} % of the continuous design, need one; sample faster or lower the bandwidth"
        )
    return RobustLaw(law, synthesis, tuple(reductions), taken, worst)
