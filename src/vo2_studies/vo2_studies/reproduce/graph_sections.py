"""The experiments of sections 7.4 and 8.4 on the ROS graph: what each section module of a scenario runs."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray
from vo2_control.closed_loop import LoopResult
from vo2_control.pid import PUBLISHED_PELTIER_PID
from vo2_models.device import truth
from vo2_models.device.description import preset
from vo2_models.parameters import Value

from vo2_studies.demo.errors import PhaseData, tracking_error
from vo2_studies.published_models import PRINTED_ROBUST
from vo2_studies.reproduce import chapter8
from vo2_studies.reproduce.claims import Claim, Context, Figure, Section, baseline, within, within_or_below
from vo2_studies.reproduce.figures import STYLES, draw
from vo2_studies.reproduce.identified import identify
from vo2_studies.reproduce.peltier import LIMITS, MERIT_WORDS, Merit, calibrate, merit, reference
from vo2_studies.reproduce.scenarios import GraphLoop, run_loops

__all__ = ["integrated_section", "peltier_section", "tracks", "tried"]

Floats = NDArray[np.float64]


def integrated_section(
    number: str, title: str, wanted_m: Floats, published_um: dict[str, float], context: Context
) -> Section:
    """PI on the composite and on the polynomial estimate, side by side, on two devices of the same seed.

    Parameters
    ----------
    wanted_m : (n,) reference at 1 kHz [m]
    published_um : scheme -> mean tracking error
    """
    context.progress("identifying the device", 0.0)
    _, parameters = identify(truth("integrated", seed=context.seed), context.seed)
    loops = {
        scheme: GraphLoop(f"/{scheme}", {"kind": scheme, **parameters}, {"kind": "pi", **parameters})
        for scheme in ("composite", "polynomial")
    }
    context.progress(f"{wanted_m.size} samples on the graph", 0.3)

    def run() -> dict[str, PhaseData]:
        found = run_loops(
            list(loops.values()),
            "integrated",
            context.seed,
            wanted_m,
            0,
            context.folder / "scenarios" / number,
        )
        return dict(zip(loops, found, strict=True))

    conditions = (
        f"one device (seed {context.seed}) on the ROS graph in lockstep, PI tuned by the rule from its identified model; "
        f"from the bag scenarios/{number}/bag"
    )
    claims = []
    found, failure = tried(run)
    errors = {scheme: 1e6 * tracking_error(found[scheme]) if found else np.nan for scheme in loops}
    for scheme, error in errors.items():
        published = published_um[scheme]
        claims.append(
            Claim(f"{number}.graph_{scheme}", number, f"Mean tracking error on the ROS graph, {scheme}", published,
                  error, "um", within_or_below(published, 0.1) if scheme == "composite" else baseline(published), conditions)
        )  # fmt: skip
    claims.append(
        Claim(f"{number}.graph_order", number, "Mean tracking error on the ROS graph: composite over polynomial",
              published_um["composite"] / published_um["polynomial"], errors["composite"] / errors["polynomial"], "1",
              within_or_below(published_um["composite"] / published_um["polynomial"], 0.1), conditions)
    )  # fmt: skip
    figures = (
        (draw(f"{title}: device of seed {context.seed}.", tracks(found), rows=2, height=2.4),)
        if found
        else ()
    )
    return Section(number, title, tuple(claims), figures, (failure,) if failure else ())


def peltier_section(
    number: str, title: str, kind: str, published: dict[str, tuple[float, ...]], context: Context
) -> Section:
    """The published robust controller (8.10) and the published PID on the polynomial estimate, side by side.

    Parameters
    ----------
    kind : experiment, see `peltier.EXPERIMENTS`
    published : law -> RMSE, largest error, steady-state error, effort; NaN where not given
    """
    seed = context.seed
    context.progress("calibrating the device", 0.0)
    device = chapter8.device(seed)
    _, parameters = identify(device, seed)
    calibration = calibrate(device, seed)
    operating = calibration.operating_a
    # the polynomial of 8.2 goes through the major loop, not through the recording that the model is fitted to
    parameters |= calibration.sensing.to_parameters()
    wanted, lead = reference(kind)
    limits: dict[str, Value] = {"limits.lower_a": LIMITS.lower_a, "limits.upper_a": LIMITS.upper_a}
    gains = {
        f"pid.{name}": getattr(PUBLISHED_PELTIER_PID, name)
        for name in ("kp", "ki", "kd", "derivative_filter_s", "reference_derivative_weight")
    }
    laws: dict[str, dict[str, Value]] = {
        "PID": {"kind": "pid", "operating_a": operating, **gains, **limits},
        "H-infinity": {"kind": "zpk", "operating_a": operating, **PRINTED_ROBUST, **limits},
    }
    noise = seed if kind == "noise" else None
    loops = {
        name: GraphLoop(
            f"/{name[0].lower()}{name[-1].lower()}", {"kind": "polynomial", **parameters}, law, noise
        )
        for name, law in laws.items()
    }
    context.progress(f"{wanted.size} samples on the graph", 0.3)

    def run() -> dict[str, PhaseData]:
        found = run_loops(
            list(loops.values()),
            chapter8.DEVICE,
            seed,
            wanted,
            lead,
            context.folder / "scenarios" / number,
            plant={"effects": f"{{{chapter8.EFFECT}: {{difference: {chapter8.DIFFERENCE_K}}}}}"},
        )
        return dict(zip(loops, found, strict=True))

    conditions = (
        f"one device of chapter 8 (seed {seed}) on the ROS graph in lockstep, polynomial self-sensing, operating "
        "current added to both laws; H-infinity is (8.10); current as measured; "
        f"from the bag scenarios/{number}/bag"
    )
    found, failure = tried(run)
    merits = {name: merit(kind, _result(found[name], wanted)) if found else None for name in laws}
    claims = []
    for name, figures_of_merit in published.items():
        for (field, short, words, unit, distance), value in zip(MERIT_WORDS, figures_of_merit, strict=True):
            if np.isfinite(value):
                ours = _value(merits[name], field)
                claims.append(
                    Claim(f"{number}.graph_{name.lower()}.{short}", number, f"{words} on the ROS graph, {name}", value, ours,
                          unit, within(value, distance), conditions,
                          given=(kind, name, short) in chapter8.FITTED_MERITS)
                )  # fmt: skip
    ratio = _value(merits["H-infinity"], "rmse_um") / _value(merits["PID"], "rmse_um")
    claims.append(
        Claim(f"{number}.graph_ratio", number, "RMSE on the ROS graph: H-infinity over PID",
              published["H-infinity"][0] / published["PID"][0], ratio, "1",
              within(published["H-infinity"][0] / published["PID"][0], 0.1), conditions)
    )  # fmt: skip
    drawn: list[Figure] = []
    if found:
        drawn.append(draw(f"{title}: device of seed {seed}.", tracks(found), rows=2, height=2.4))
        if kind != "steps":
            drawn.append(draw("Spectrum of the tracking errors.", _spectra(found)))
    return Section(number, title, tuple(claims), tuple(drawn), (failure,) if failure else ())


def tried(run: Callable[[], dict[str, PhaseData]]) -> tuple[dict[str, PhaseData], str]:
    """What the scenario found, or nothing and the reason: one scenario that fails does not end the others."""
    try:
        from vo2_studies.demo.graph import GraphError
    except ImportError as error:
        return {}, f"Not run: no ROS 2 here ({error})."
    try:
        return run(), ""
    except (GraphError, ValueError) as error:
        return {}, f"Not run to its end: {error}"


def _result(data: PhaseData, wanted: Floats) -> LoopResult:
    """The samples as `merit` takes them; the reference of the bag is the one asked for."""
    if not np.allclose(data.reference_m, wanted[-data.time_s.size :], atol=1e-9):
        raise ValueError("reference: found other values in the bag than the experiment's")
    return LoopResult(
        data.time_s,
        data.reference_m,
        data.estimate_m,
        data.true_m,
        data.current_a,
        np.full(data.time_s.size, np.nan),
    )


def _value(found: Merit | None, field: str) -> float:
    return float(getattr(found, field)) if found is not None else float("nan")


def tracks(found: dict[str, PhaseData]) -> Callable[..., None]:
    """Return a plot of true deflections and errors (two axes) of the laws in `found`."""

    def plot(top, bottom):
        for (name, data), style in zip(found.items(), STYLES, strict=False):
            k = slice(0, None, max(1, data.time_s.size // 3000))
            top.plot(data.time_s[k], 1e6 * data.true_m[k], style, lw=1, label=name)
            bottom.plot(data.time_s[k], 1e6 * (data.reference_m - data.true_m)[k], style, lw=1, label=name)
        data = next(iter(found.values()))
        k = slice(0, None, max(1, data.time_s.size // 3000))
        top.plot(data.time_s[k], 1e6 * data.reference_m[k], "k:", label="reference")
        top.set_ylabel("true deflection [um]")
        bottom.set_ylabel("error [um]")
        bottom.set_xlabel("time [s]")

    return plot


def _spectra(found: dict[str, PhaseData]) -> Callable[..., None]:
    period = preset("peltier").sample_period

    def plot(axis):
        for (name, data), style in zip(found.items(), STYLES, strict=False):
            error = 1e6 * (data.reference_m - data.true_m)
            size = 2 * np.abs(np.fft.rfft(error * np.hanning(error.size))) / error.size
            axis.loglog(np.fft.rfftfreq(error.size, period)[1:400], size[1:400], style, label=name)
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("amplitude of the error [um]")

    return plot
