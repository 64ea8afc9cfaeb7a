"""8.4: the published H-infinity and PID designs as printed, on steps and multi-sine, without and with noise."""

from __future__ import annotations

from dataclasses import astuple, replace

import numpy as np
from numpy.typing import NDArray
from vo2_control.controller import LinearController
from vo2_control.discretise import discrete_law
from vo2_control.hinf import PUBLISHED_CONTROLLER
from vo2_control.pid import PUBLISHED_PELTIER_PID, pid_law
from vo2_models.device import truth

from vo2_studies.reproduce.claims import Claim, Context, Section, at_most
from vo2_studies.reproduce.figures import draw
from vo2_studies.reproduce.peltier import (
    EXPERIMENTS,
    LIMITS,
    PERIOD_S,
    Merit,
    calibrate,
    experiment,
    merit,
)

NUMBER, TITLE = "8.4", "Published H-infinity and PID designs, as printed"

_SECTION = {"steps": "8.4.1", "multi": "8.4.2", "noise": "8.4.3"}
_PUBLISHED = {
    # Tables 8.2 to 8.4: RMSE, largest error, steady-state error [um], control effort [mA]; NaN: not given
    ("steps", "PID"): (6.28, np.nan, 1.11, np.nan),
    ("steps", "H-infinity"): (6.05, np.nan, 0.62, np.nan),
    ("multi", "PID"): (1.24, 3.00, np.nan, 49.1),
    ("multi", "H-infinity"): (1.02, 3.07, np.nan, 48.2),
    ("noise", "PID"): (1.47, 4.28, np.nan, 33.6),
    ("noise", "H-infinity"): (0.96, 3.07, np.nan, 31.6),
}
_WORDS = (("rmse", "RMSE", "um"), ("largest", "Largest error", "um"), ("steady", "Mean steady-state error", "um"),
          ("effort", "Control effort, s.d. of the current", "mA"))  # fmt: skip
_DEVICES = 50


def published(kind: str) -> dict[str, tuple[float, ...]]:
    """Law -> RMSE, largest error, steady-state error [um], control effort [mA] of an experiment; NaN: not given."""
    return {name: _PUBLISHED[kind, name] for name in ("H-infinity", "PID")}


def run(context: Context) -> Section:
    """Return the section's claims; about 10 s."""
    laws = {
        "PID": pid_law(PUBLISHED_PELTIER_PID, PERIOD_S),
        "H-infinity": discrete_law(PUBLISHED_CONTROLLER, PERIOD_S),
    }
    count = min(_DEVICES, context.draws)
    merits: dict[tuple[str, str], list[Merit]] = {key: [] for key in _PUBLISHED}
    shown = {}
    for k in range(count):
        device, seed = truth("peltier", seed=context.seed + k), context.seed + k
        calibration = calibrate(device, seed)
        for kind in EXPERIMENTS:
            for name, law in laws.items():
                controller = LinearController(replace(law, operating_a=calibration.operating_a), LIMITS)
                result = experiment(kind, device, calibration.sensing, controller, seed)
                merits[kind, name].append(merit(kind, result))
                if k == 0:
                    shown[kind, name] = result
        context.progress(f"device {k + 1} of {count}", (k + 1) / count)
    conditions = f"mean over {count} device draws; polynomial self-sensing of degree 9; operating current added to both designs"
    claims = []
    mean: dict[tuple[str, str], NDArray[np.float64]] = {}
    for key, found in merits.items():
        mean[key] = np.mean([astuple(m) for m in found], axis=0)
        kind, name = key
        for (short, words, unit), theirs, ours in zip(_WORDS, _PUBLISHED[key], mean[key], strict=False):
            if np.isfinite(theirs):
                claims.append(
                    Claim(
                        f"{_SECTION[kind]}.{name.lower()}.{short}", _SECTION[kind], f"{words}, {name}", theirs,
                        float(ours), unit, at_most(theirs), conditions,
                    )
                )  # fmt: skip
    for kind in EXPERIMENTS:
        theirs = _PUBLISHED[kind, "H-infinity"][0] / _PUBLISHED[kind, "PID"][0]
        ratios = [
            h.rmse_um / p.rmse_um
            for h, p in zip(merits[kind, "H-infinity"], merits[kind, "PID"], strict=True)
        ]
        half = 1.96 * np.std(ratios, ddof=1) / np.sqrt(len(ratios)) if len(ratios) > 1 else np.nan
        claims.append(
            Claim(
                f"{_SECTION[kind]}.ratio", _SECTION[kind], "RMSE of H-infinity over that of PID: does it win", theirs,
                float(np.mean(ratios)), "1", at_most(1.0), f"95 % confidence +-{half:.3f}; {conditions}",
            )
        )  # fmt: skip

    def tracking(kind):
        def plot(top, bottom):
            for name, style in (("PID", "-"), ("H-infinity", "--")):
                result = shown[kind, name]
                time = result.time_s - result.time_s[0]
                top.plot(time, 1e6 * result.deflection_m, style, label=name)
                bottom.plot(time, 1e6 * result.error_m, style, label=name)
            top.plot(time, 1e6 * result.reference_m, "k:", label="reference")
            top.set_ylabel("true deflection [um]")
            bottom.set_ylabel("error [um]")
            bottom.set_xlabel("time [s]")

        return plot

    def spectrum(axis):
        for kind, name, style in (
            ("multi", "PID", "-"), ("multi", "H-infinity", "--"), ("noise", "PID", "-."), ("noise", "H-infinity", ":"),
        ):  # fmt: skip
            error = 1e6 * shown[kind, name].error_m
            size = 2 * np.abs(np.fft.rfft(error * np.hanning(error.size))) / error.size
            label = f"{name}, {'with' if kind == 'noise' else 'without'} noise"
            axis.loglog(np.fft.rfftfreq(error.size, PERIOD_S)[1:400], size[1:400], style, label=label)
        axis.set_xlabel("frequency [Hz]")
        axis.set_ylabel("amplitude of the error [um]")

    figures = (
        draw("Fig. 8.5 and 8.6: step references, first device.", tracking("steps"), rows=2, height=2.4),
        draw("Fig. 8.7 and 8.8: multi-sine reference, first device.", tracking("multi"), rows=2, height=2.4),
        draw("Fig. 8.9: the same with current noise, first device.", tracking("noise"), rows=2, height=2.4),
        draw("Fig. 8.11: spectrum of the tracking errors, first device.", spectrum),
    )
    lasting = abs(calibration.operating_a / float(np.real(PUBLISHED_CONTROLLER(0))))
    remarks = (
        "Both designs are linear and for small deviations: the current that holds 35 um (mean of both branches) is added "
        "to both. Counted from zero current instead, the H-infinity design, which has no integral action, would need a "
        f"lasting error of {lasting:.0f} um to hold the device in its transition. Every loop first regulates for 100 s to "
        "5 um (steps) or to the reference's first value; errors are of the true deflection, after the first 5 %. "
        "Absolute values compare two different devices; the ratio is what says which design wins.",
    )
    return Section(NUMBER, TITLE, tuple(claims), figures, remarks)
