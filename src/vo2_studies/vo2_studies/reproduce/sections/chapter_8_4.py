"""8.4: why the published robust controller wins on the rig: the story, on devices that nothing was tuned on."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from vo2_control.closed_loop import LoopResult
from vo2_control.hinf import PUBLISHED_CONTROLLER
from vo2_models.diagnosis import Diagnosis, diagnose
from vo2_models.hysteresis import PlayBank
from vo2_models.identification.model_fit import fit_model
from vo2_models.recording import Recording

from vo2_studies.challenge.devices import PRESETS
from vo2_studies.challenge.excitation import calibration_current, informative_current
from vo2_studies.reproduce.candidates import turned, unexplained
from vo2_studies.reproduce.chapter8 import (
    DEVICE,
    DIFFERENCE_K,
    EFFECT,
    FITTED_MERITS,
    LAWS,
    PROOF_SEED,
    Merits,
    device,
    laws,
    mean_merit,
    ratio,
    run_law,
)
from vo2_studies.reproduce.claims import (
    Claim,
    Context,
    Figure,
    Section,
    Table,
    above,
    at_least,
    between,
    within,
)
from vo2_studies.reproduce.figures import draw
from vo2_studies.reproduce.peltier import (
    EXPERIMENTS,
    MERIT_WORDS,
    PERIOD_S,
    Merit,
    calibrate,
    setpoint_errors,
)

NUMBER, TITLE = "8.4", "Published H-infinity and PID designs: why the comparison turns round in simulation"

DRAWS = 10
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
_RATIO = {"steps": within(0.963, 0.1), "multi": between(0.75, 0.90), "noise": within(0.653, 0.1)}
_TONES_HZ = (0.001, 0.005, 0.01)


def published(kind: str) -> dict[str, tuple[float, ...]]:
    """Law -> RMSE, largest error, steady-state error [um], control effort [mA] of an experiment; NaN: not given."""
    return {name: _PUBLISHED[kind, name] for name in ("H-infinity", "PID")}


@dataclass(frozen=True)
class Compared:
    """All draws of one plant.

    Attributes
    ----------
    merits : mean figures of merit
    ratios : experiment -> RMSE of H-infinity over that of the PID, per draw
    in_order : draws on which H-infinity has the smaller steady-state error
    closer : (draws,) setpoints of three at which it has
    runs : of the first draw
    """

    merits: Merits
    ratios: Mapping[str, np.ndarray]
    in_order: int
    closer: np.ndarray
    runs: Mapping[tuple[str, str], LoopResult]


def compare(seeds: Sequence[int], difference: float) -> Compared:
    """Run every experiment under both laws on every draw."""
    both = laws()
    found: dict[tuple[str, str], list[Merit]] = {(kind, name): [] for kind in EXPERIMENTS for name in both}
    runs: dict[tuple[str, str], LoopResult] = {}
    closer = []
    for seed in seeds:
        one = device(seed, difference)
        calibration = calibrate(one, seed)
        steady = {}
        for kind, name in found:
            merit, result = run_law(kind, one, calibration, both[name], seed)
            found[kind, name].append(merit)
            runs.setdefault((kind, name), result)
            if kind == "steps":
                steady[name] = setpoint_errors(1e6 * result.error_m)
        closer.append(int(np.sum(steady["H-infinity"] < steady["PID"])))
    ratios = {
        kind: np.array([
            h.rmse_um / p.rmse_um for h, p in zip(found[kind, "H-infinity"], found[kind, "PID"], strict=True)
        ])
        for kind in EXPERIMENTS
    }  # fmt: skip
    pairs = zip(found["steps", "H-infinity"], found["steps", "PID"], strict=True)
    in_order = sum(h.steady_um < p.steady_um for h, p in pairs)
    merits = {key: mean_merit(merits) for key, merits in found.items()}
    return Compared(merits, ratios, in_order, np.array(closer), runs)


def diagnosed(seed: int, context: Context) -> tuple[dict[str, Diagnosis], float]:
    """What `diagnose` and `fit` say of the device whose structural loop is narrower.

    Returns
    -------
    diagnoses : "change": the model was fitted to the device without the difference; "all along": to the device as it is, and
        the calibration is given to the diagnosis
    difference : mean width of the loop of the deflection minus that of the resistance, in the model of "all along" [K]
    """
    rng = np.random.default_rng([seed, 84])
    first, second = (
        np.asarray(play(rng, PRESETS["peltier"])) for play in (calibration_current, informative_current)
    )
    with_it, without = device(seed), device(seed, 0.0)

    def record(one: Any, current: np.ndarray, run: int) -> Recording:
        return one.simulate(current, seed=[seed, run])

    test = record(with_it, second, 2)
    found, difference = {}, float("nan")
    for k, (name, calibrated) in enumerate({"change": without, "all along": with_it}.items()):
        context.progress(f"diagnosis: {name}", 0.3 + 0.3 * k)
        calibration = record(calibrated, first, 1)
        result, parameters = fit_model([calibration], DEVICE, self_sensing=False)
        found[name] = diagnose([test], parameters, calibration=[calibration] if name == "all along" else [])
        widths = [
            law.loop_width
            for law in (result.model.deflection, result.model.resistance)
            if isinstance(law, PlayBank)
        ]
        difference = widths[0] - widths[1]
    return found, difference


def run(context: Context) -> Section:
    """Return the section: about two minutes, most of them for the two diagnoses."""
    seeds = [PROOF_SEED + context.seed + k for k in range(DRAWS)]
    context.progress(f"{DRAWS} devices with and without the difference", 0.05)
    without, with_it = compare(seeds, 0.0), compare(seeds, DIFFERENCE_K)
    diagnoses, narrower = diagnosed(seeds[0], context)
    context.progress("candidates for what does not fit", 0.9)
    claims = _claims(without, with_it, diagnoses, narrower)
    story: tuple[str | Table | Figure, ...] = (
        "Section 8.4 reports that H-infinity beats the PID on the rig. With the published controllers on a simulated device "
        "that has everything the chapter's model has, it is the other way round:",
        _table("Without the difference of the loop widths", without, with_difference=False),
        *_said(diagnoses, narrower),
        "With it, the same devices, the same controllers and the same noise:",
        _table(
            f"With the structural loop {-DIFFERENCE_K:g} K narrower than the metallic one: all but what is marked is predicted",
            with_it,
            with_difference=True,
        ),
        _why(with_it),
        _on_steps(without, with_it),
        *turned(),
        "What still does not fit:",
        *unexplained(),
        _of_the_noise(with_it),
        "The effort falls by a third between Tables 8.3 and 8.4 under both controllers, with the same reference and noise "
        "added: the rig or the reference was not the same, so that the noise run cannot be compared with the run before it. "
        "Noise of +-10 mA through a lag of 25 s moves the deflection by about 0.1 um. Step levels, step starts and the three "
        "amplitudes are not printed; ours are the contract's.",
    )
    lasting = abs(calibrate(device(seeds[0]), seeds[0]).operating_a / float(np.real(PUBLISHED_CONTROLLER(0))))
    remarks = (
        "Both designs are linear and for small deviations: the current that holds 35 um (mean of both branches) is added "
        "to both. Counted from zero current instead, the H-infinity design, which has no integral action, would need a "
        f"lasting error of {lasting:.0f} um to hold the device in its transition. Every loop is first given 5 um (steps) or "
        "the reference's first value for 100 s, and begins where it comes to rest then; errors are of the true deflection, "
        "after the first 5 %, which are the first 2.25 s of the first step. Counted from the first sample, which the text may "
        f"mean, the RMSE on the steps is {_of_both(with_it, 'steps', 'whole_rmse_um')} um for PID and H-infinity (published "
        "6.28 and 6.05).",
        "H-infinity is the controller (8.10) as printed, on the ROS graph (8.4.1 to 8.4.3) too. What the printed weights give "
        "is another controller: see 8.3.",
    )
    return Section(NUMBER, TITLE, tuple(claims), _figures(with_it.runs), remarks, story)


def _of_both(compared: Compared, kind: str, field: str) -> str:
    """A figure of merit of PID and H-infinity, in that order."""
    return " and ".join(f"{getattr(compared.merits[kind, name], field):.2f}" for name in LAWS)


def _why(with_it: Compared) -> str:
    """What turns the comparison round on the multi-sine, by the errors of the self-sensed and of the true deflection."""
    felt, true = (_of_both(with_it, "multi", field) for field in ("felt_rmse_um", "rmse_um"))
    return (
        "Why, on the multi-sine: the H-infinity design has no integral action and lags behind the estimate. Where deflection "
        "leads resistance on both branches, that lag cancels a part of the bias of the self-sensed signal, while the PID "
        f"follows the biased estimate. RMSE of PID and H-infinity: {felt} um of the self-sensed deflection, {true} um of the "
        "true one. Physically: resistance is taken from the test piece and deflection from the cantilever (8.1.2), and the "
        "energies of the two transitions differ (8.2)."
    )


def _on_steps(without: Compared, with_it: Compared) -> str:
    """That the same reason does not hold on the steps."""
    felt, true = (_of_both(with_it, "steps", field) for field in ("felt_steady_um", "steady_um"))
    before = _of_both(without, "steps", "steady_um")
    return (
        "On the steps that is not what happens. 8.4.1 reports the PID better on the self-sensed deflection and H-infinity "
        "closer at every setpoint. Here the steady-state errors of PID and H-infinity are "
        f"{felt} um of the self-sensed deflection and {true} um of the true one, and H-infinity is closer at "
        f"{np.mean(with_it.closer):.1f} of the three setpoints. What is left of the PID's error has not settled in the 15 s of "
        f"a step. Without the difference the true ones are {before} um: the difference makes the PID better on steps and "
        "H-infinity worse. The two figures of Table 8.2 are reached (that of the PID was fitted), their explanation is not."
    )


def _of_the_noise(with_it: Compared) -> str:
    """That the noise does next to nothing here, so that figures of its run are those of the run without it."""
    plain, noisy = (_of_both(with_it, kind, "rmse_um") for kind in ("multi", "noise"))
    return (
        f"The noise changes next to nothing here: the RMSE of PID and H-infinity is {plain} um without it, {noisy} um with it. "
        "What is met of Table 8.4 is met by the run without noise too; what the noise did on the rig, +18.6 % and +43 % for the "
        "PID, is missed."
    )


def _table(caption: str, compared: Compared, *, with_difference: bool) -> Table:
    """Published against simulated, figure by figure and ratio by ratio; with the difference three figures are fitted."""
    rows = []
    for kind in EXPERIMENTS:
        for field, short, words, unit, _ in MERIT_WORDS:
            theirs = [_PUBLISHED[kind, name][[w[0] for w in MERIT_WORDS].index(field)] for name in LAWS]
            if np.isfinite(theirs).all():
                ours = [getattr(compared.merits[kind, name], field) for name in LAWS]
                fitted = (
                    " (fitted)" if with_difference and (kind, name, short) in FITTED_MERITS else ""
                    for name in LAWS
                )
                rows.append((
                    _SECTION[kind], f"{words} [{unit}]", *(f"{x:.3g}" for x in theirs),
                    *(f"{x:.3g}{mark}" for x, mark in zip(ours, fitted, strict=True)),
                    f"{theirs[1] / theirs[0]:.2f}", f"{ours[1] / ours[0]:.2f}",
                ))  # fmt: skip
    head = (
        "section", "figure", "published PID", "published H-inf", "ours PID", "ours H-inf", "published ratio", "our ratio",
    )  # fmt: skip
    return Table(caption, head, tuple(rows))


def _said(diagnoses: Mapping[str, Diagnosis], narrower: float) -> list[str]:
    """What each diagnosis located and named, in a paragraph."""
    asked = {
        "change": "a model fitted before the loop became narrower",
        "all along": "a model fitted to the device as it is, calibration given",
    }
    texts = []
    for name, found in diagnoses.items():
        places = "; ".join(
            f"{100 * one.share:.0f} % in {one.signal}, {one.branch} branch(es)"
            + (
                f", {one.temperature_degC[0]:.1f} to {one.temperature_degC[1]:.1f} degC"
                if one.temperature_degC
                else ""
            )
            for one in found.location
            if one.share >= 0.005
        )
        named = "; ".join(
            f"{one.id} with probability {one.probability:.2f}"
            + "".join(
                f", {key} {v.value:.3g} +- {v.std:.2g} {v.unit} (true {DIFFERENCE_K:g})"
                if one.id == EFFECT
                else f", {key} {v.value:.3g} +- {v.std:.2g} {v.unit}"
                for key, v in one.parameters.items()
            )
            for one in found.effects
        )
        texts.append(
            f"Diagnosis ({asked[name]}): {found.verdict}. Located: {places or 'nothing'}. Named: {named or 'nothing'}."
        )
    texts.append(
        "A model that is fitted to the device as it is leaves nothing to be named, for it has a loop of its own for each of "
        f"the two: the loop of the deflection comes out {-narrower:.2f} K narrower than that of the resistance "
        f"(true {-DIFFERENCE_K:g} K)."
    )
    return texts


def _claims(
    without: Compared, with_it: Compared, diagnoses: Mapping[str, Diagnosis], narrower: float
) -> list[Claim]:
    basis = (
        f"mean over {DRAWS} device draws that nothing was tuned on; published controllers unchanged; polynomial self-sensing "
        "of degree 9; operating current added to both designs"
    )
    claims = []
    for (kind, law), values in _PUBLISHED.items():
        for (field, short, words, unit, distance), theirs in zip(MERIT_WORDS, values, strict=True):
            if np.isfinite(theirs):
                fitted = (kind, law, short) in FITTED_MERITS
                claims.append(
                    Claim(f"{_SECTION[kind]}.{law.lower()}.{short}", _SECTION[kind],
                          f"{words}, {law}{' (FITTED, on other draws)' if fitted else ''}", theirs,
                          float(getattr(with_it.merits[kind, law], field)), unit, within(theirs, distance), basis, given=fitted)
                )  # fmt: skip
    for kind in EXPERIMENTS:
        theirs = _PUBLISHED[kind, "H-infinity"][0] / _PUBLISHED[kind, "PID"][0]
        ours = with_it.ratios[kind]
        half = 1.96 * np.std(ours, ddof=1) / np.sqrt(ours.size)
        claims.append(
            Claim(f"{_SECTION[kind]}.ratio", _SECTION[kind], "RMSE of H-infinity over that of PID", theirs,
                  float(np.mean(ours)), "1", _RATIO[kind],
                  f"mean of the ratio per draw, 95 % confidence +-{half:.3f}, {ours.min():.2f} to {ours.max():.2f}; {basis}")
        )  # fmt: skip
    merits = with_it.merits
    pairs = (
        # name, section, words, published per cent, ours as a ratio minus 1 or 1 minus a ratio, distance, contradiction
        ("steps_rmse_less", "8.4.1", "RMSE of H-infinity below that of PID, steps", 3.66, 1 - ratio(merits, "steps"), ""),
        ("steps_steady_less", "8.4.1", "Steady-state error of H-infinity below that of PID", 36.0,
         1 - merits["steps", "H-infinity"].steady_um / merits["steps", "PID"].steady_um,
         "Table 8.2 itself, 1.11 and 0.62 um, gives 44 %"),
        ("multi_rmse_less", "8.4.2", "RMSE of H-infinity below that of PID, multi-sine", 18.0, 1 - ratio(merits), ""),
        ("multi_effort_less", "8.4.2", "Effort of H-infinity below that of PID, multi-sine", 1.8,
         1 - merits["multi", "H-infinity"].effort_ma / merits["multi", "PID"].effort_ma, ""),
        ("noise_largest_less", "8.4.3", "Largest error of H-infinity below that of PID, with noise", 28.0,
         1 - merits["noise", "H-infinity"].largest_um / merits["noise", "PID"].largest_um, ""),
        ("noise_largest_more", "8.4.3", "Largest error of the PID with noise above that without", 43.0,
         merits["noise", "PID"].largest_um / merits["multi", "PID"].largest_um - 1, ""),
        ("noise_rmse_less", "8.4.3", "RMSE of H-infinity below that of PID, with noise", 34.7, 1 - ratio(merits, "noise"), ""),
        ("noise_effort_less", "8.4.3", "Effort of H-infinity below that of PID, with noise", 6.0,
         1 - merits["noise", "H-infinity"].effort_ma / merits["noise", "PID"].effort_ma, ""),
        ("noise_rmse_more", "8.4.3", "RMSE of the PID with noise above that without", 18.6,
         merits["noise", "PID"].rmse_um / merits["multi", "PID"].rmse_um - 1, ""),
        ("noise_share", "8.4.3", "Noise amplitude over the total change of the current", 25.0,
         10.0 / (1e3 * np.ptp(with_it.runs["multi", "PID"].current_a)),
         "10 mA being 25 % makes the total change 40 mA, below the s.d. of 49.1 mA in Table 8.3"),
    )  # fmt: skip
    claims += [
        Claim(f"{section}.{name}", section, words, theirs, 100 * float(ours), "%", between(theirs - 5, theirs + 5), basis, why)
        for name, section, words, theirs, ours, why in pairs
    ]  # fmt: skip
    lower = _lower_components(with_it.runs)
    claims += [
        Claim("8.4.3.spectrum", "8.4.3", "Tones of the reference at which the error of H-infinity is the smaller (Fig. 8.11)",
              6.0, float(lower), "1", at_least(6.0), "three tones, without and with noise; first draw; published: all"),
        Claim("8.4.1.order", "8.4.1", "Steady-state error: H-infinity below the PID", 1.0,
              float(merits["steps", "H-infinity"].steady_um < merits["steps", "PID"].steady_um), "1", at_least(1.0),
              f"on {with_it.in_order} of {DRAWS} draws; {basis}"),
        Claim("8.4.1.every_setpoint", "8.4.1", "Setpoints at which H-infinity has the smaller steady-state error", 3.0,
              float(np.mean(with_it.closer)), "1", at_least(3.0),
              f"all three on {np.sum(with_it.closer == 3)} of {DRAWS} draws; {basis}"),
        Claim("8.4.1.felt_order", "8.4.1", "Steady-state error of the self-sensed deflection: PID below H-infinity (Fig. 8.5b)",
              1.0, float(merits["steps", "PID"].felt_steady_um < merits["steps", "H-infinity"].felt_steady_um), "1",
              at_least(1.0), basis),
        Claim("8.4.3.effort_pid", "8.4.3", "Effort of the PID with noise over that without", 33.6 / 49.1,
              merits["noise", "PID"].effort_ma / merits["multi", "PID"].effort_ma, "1", within(33.6 / 49.1, 0.1), basis),
        Claim("8.4.3.effort_hinf", "8.4.3", "Effort of H-infinity with noise over that without", 31.6 / 48.2,
              merits["noise", "H-infinity"].effort_ma / merits["multi", "H-infinity"].effort_ma, "1",
              within(31.6 / 48.2, 0.1), basis),
        Claim("8.4.2.ratio_without", "8.4.2", "The same devices with the width difference removed: ratio of the RMSE", None,
              float(np.mean(without.ratios["multi"])), "1", above(1.0), basis),
        Claim("8.4.2.turned", "8.4.2", "Draws of which the difference turns the comparison round", None,
              float(np.sum((without.ratios["multi"] > 1) & (with_it.ratios["multi"] < 1))), "1", at_least(DRAWS), basis),
    ]  # fmt: skip
    for name, found in diagnoses.items():
        first = found.effects[0].id if found.effects else "nothing"
        claims.append(
            Claim(f"8.4.diagnosis.{name.replace(' ', '_')}", "8.4", f"`diagnose` names the difference first: {name}", None,
                  float(first == EFFECT), "1", at_least(1.0), f"named first: {first}; first proof draw, {DIFFERENCE_K:g} K")
        )  # fmt: skip
    claims.append(
        Claim("8.4.fit.width_difference", "8.4", "Difference of the loop widths in the model of the device as it is", None,
              narrower, "K", within(DIFFERENCE_K, 0.1), f"`fit` of one calibration; first proof draw, {DIFFERENCE_K:g} K")
    )  # fmt: skip
    return claims


def _amplitudes(result: LoopResult) -> np.ndarray:
    """Amplitude of the error at each tone of the reference [um]; the record holds whole periods of all."""
    time = result.time_s - result.time_s[0]
    return np.array([
        2 * np.abs(np.mean(1e6 * result.error_m * np.exp(-2j * np.pi * tone * time))) for tone in _TONES_HZ
    ])  # fmt: skip


def _lower_components(runs: Mapping[tuple[str, str], LoopResult]) -> int:
    return sum(
        int(np.sum(_amplitudes(runs[kind, "H-infinity"]) < _amplitudes(runs[kind, "PID"])))
        for kind in ("multi", "noise")
    )


def _figures(shown: Mapping[tuple[str, str], LoopResult]) -> tuple[Figure, ...]:
    def tracking(kind):
        def plot(top, felt, bottom, drive):
            for name, style in (("PID", "-"), ("H-infinity", "--")):
                result = shown[kind, name]
                time = result.time_s - result.time_s[0]
                top.plot(time, 1e6 * result.deflection_m, style, label=name)
                felt.plot(time, 1e6 * (result.reference_m - result.estimate_m), style, label=name)
                bottom.plot(time, 1e6 * result.error_m, style, label=name)
                drive.plot(time, 1e3 * result.current_a, style, label=name)
            top.plot(time, 1e6 * result.reference_m, "k:", label="reference")
            top.set_ylabel("true [um]")
            felt.set_ylabel("self-sensed\nerror [um]")
            bottom.set_ylabel("true\nerror [um]")
            drive.set_ylabel("current [mA]")
            drive.set_xlabel("time [s]")

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

    return (
        draw("Fig. 8.5 and 8.6: step references, first device.", tracking("steps"), rows=4, height=1.8),
        draw("Fig. 8.7 and 8.8: multi-sine reference, first device.", tracking("multi"), rows=4, height=1.8),
        draw(
            "Fig. 8.9 and 8.10: the same with current noise, first device.",
            tracking("noise"),
            rows=4,
            height=1.8,
        ),
        draw("Fig. 8.11: spectrum of the tracking errors, first device.", spectrum),
    )
