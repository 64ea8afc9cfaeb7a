"""8.3: generalised plant, H-infinity synthesis, structured singular values, order reduction."""

from __future__ import annotations

import numpy as np
from control import StateSpace
from vo2_control.discretise import discrete_law, robust_law
from vo2_control.generalised_plant import RobustDesign, generalised_plant
from vo2_control.hinf import PUBLISHED_CONTROLLER, dk_iterate
from vo2_control.mu import mu_sweep
from vo2_control.sampled_loop import loop_margins

from vo2_studies.reproduce.claims import Claim, Context, Section, at_least, at_most, within
from vo2_studies.reproduce.figures import draw

NUMBER, TITLE = "8.3", "Robust controller design"
PERIOD_S = 0.125
CANCELLED = 0.01
"""Share of a root within which another one takes it away."""


def _of_the_printed(controller: StateSpace) -> list[Claim]:
    """What the synthesis from (8.5) to (8.9) gives against (8.10), by what is free in it: the rest repeats plant and weights."""

    def pair(law: StateSpace) -> float:
        return float(np.abs([p for p in law.poles() if abs(p.imag) > 0.0]).mean())

    def nearest(roots: np.ndarray, others: np.ndarray, printed: float) -> float:
        sizes = np.array([abs(r) for r in roots if np.min(np.abs(others - r)) > CANCELLED * abs(r)])
        return float(sizes[np.argmin(np.abs(np.log(sizes / printed)))])

    poles, zeros = controller.poles(), controller.zeros()
    basis = "optimal controller of (8.5)-(8.9)"
    figures = (
        ("gain", "Gain at zero frequency", abs(PUBLISHED_CONTROLLER(0)), abs(controller(0)), "A/um"),
        (
            "pair",
            "Modulus of its pair of complex poles",
            pair(PUBLISHED_CONTROLLER),
            pair(controller),
            "rad/s",
        ),
        ("pole_89", "Its pole next to 89", 89.0, nearest(poles, zeros, 89.0), "rad/s"),
        ("zero_1", "Its zero next to 1.1", 1.1, nearest(zeros, poles, 1.1), "rad/s"),
        ("zero_8", "Its zero next to 8.2", 8.2, nearest(zeros, poles, 8.2), "rad/s"),
    )
    return [
        Claim(f"8.3.controller_{name}", "8.3.2", f"{words}, synthesis against (8.10)", float(published), float(ours), unit,
              within(float(published), 0.1), basis)
        for name, words, published, ours, unit in figures
    ]  # fmt: skip


def run(context: Context) -> Section:
    """Return the section's claims; about 10 s."""
    design = RobustDesign()
    context.progress("synthesis and order reduction", 0.0)
    robust = robust_law(design, PERIOD_S, expected_sign=-1)
    synthesis, taken = robust.synthesis, robust.taken
    context.progress("structured singular values", 0.4)
    printed = mu_sweep(generalised_plant(design), PUBLISHED_CONTROLLER)
    context.progress("D-K iteration", 0.6)
    best = min(dk_iterate(design), key=lambda s: s.robust_performance)
    margins = loop_margins(discrete_law(PUBLISHED_CONTROLLER, PERIOD_S), design.plant.sampled(PERIOD_S))
    loop_gain = abs(float(np.real(PUBLISHED_CONTROLLER(0)))) * abs(design.plant.gain) * 1e6
    optimal, as_printed = "optimal controller of (8.5)-(8.9)", "controller (8.10) as printed"
    claims = (
        *_of_the_printed(synthesis.controller),
        Claim("8.3.gamma", "8.3.2", "Optimal H-infinity norm", 0.118, synthesis.gamma, "1", within(0.118, 0.05),
              "plant from the block diagram of Fig. 8.3b; the weights' optimum is about 0.115 (errata)"),
        Claim("8.3.robust_stability", "8.3.2", "Structured singular value, robust stability", 0.26,
              synthesis.robust_stability, "1", within(0.26, 0.1), optimal),
        Claim("8.3.robust_stability_printed", "8.3.2", "Structured singular value, robust stability", 0.26,
              float(printed.robust_stability.max()), "1", within(0.26, 0.1), as_printed),
        Claim("8.3.robust_performance", "8.3.2", "Structured singular value, robust performance", 0.32,
              synthesis.robust_performance, "1", within(0.32, 0.1), optimal),
        Claim("8.3.robust_performance_printed", "8.3.2", "Structured singular value, robust performance", 0.32,
              float(printed.upper.max()), "1", within(0.32, 0.1), as_printed),
        Claim("8.3.mu_bounds", "8.3.2", "Lower over upper bound of the structured singular value at its peak", None,
              synthesis.mu.lower.max() / synthesis.robust_performance, "1", at_least(0.99), "two independent computations"),
        Claim("8.3.dk", "8.3.2", "Robust performance after D-K iteration", None, best.robust_performance, "1",
              at_most(synthesis.robust_performance), "4 iterations, D of order 1"),
        Claim("8.3.order", "8.3.2", "Order of the discretised controller", 5.0, float(taken.order), "1", at_most(5.0),
              f"of {synthesis.controller.nstates} states; gamma {taken.gamma:.4f}, robust performance "
              f"{taken.robust_performance:.4f} after reduction"),
        Claim("8.3.sampled", "8.3.2", "Spectral radius of the loop sampled at 125 ms, worst time constant", None,
              robust.worst.spectral_radius, "1", at_most(0.9999),
              f"exact delay; largest sensitivity {robust.worst.sensitivity_peak:.2f}, phase margin "
              f"{robust.worst.phase_margin_deg:.0f} deg, gain margin {robust.worst.gain_margin:.1f}"),
        Claim("8.3.printed_sampled", "8.3.2", "The same for (8.10) as printed", None, margins.spectral_radius, "1",
              at_most(0.9999), "nominal time constant"),
        Claim("8.3.no_integral", "8.3.2", "Loop gain at zero frequency of (8.10)", None, loop_gain, "1", at_most(22.0),
              "no integral action: an offset of its reciprocal remains"),
    )  # fmt: skip

    def singular_values(axis):
        for sweep, name, style in (
            (synthesis.mu, "optimal", "-"),
            (printed, "(8.10)", "--"),
            (best.mu, "D-K", ":"),
        ):
            axis.semilogx(sweep.frequency_rad_s, sweep.upper, style, label=f"{name}: robust performance")
            axis.semilogx(
                sweep.frequency_rad_s,
                sweep.robust_stability,
                style,
                alpha=0.6,
                label=f"{name}: robust stability",
            )
        axis.set_xlabel("frequency [rad/s]")
        axis.set_ylabel("structured singular value [1]")

    def reduction(axis):
        orders = [r.order for r in robust.reductions]
        axis.plot(orders, [r.gamma for r in robust.reductions], "o-", label="H-infinity norm")
        axis.plot(
            orders, [r.robust_performance for r in robust.reductions], "s--", label="robust performance"
        )
        axis.set_xlabel("order of the controller [states]")
        axis.set_ylabel("norm [1]")

    figures = (
        draw("Structured singular values over frequency.", singular_values),
        draw("What order reduction costs.", reduction),
    )
    return Section(NUMBER, TITLE, claims, figures)
