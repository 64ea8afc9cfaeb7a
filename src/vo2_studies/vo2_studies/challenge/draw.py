"""Draw a planned case: the rig, both recordings, and the answer."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, Recording

from vo2_studies.challenge.catalogue import draw_effect, families, forms, redrawn
from vo2_studies.challenge.conditions import Condition, draw_condition
from vo2_studies.challenge.constants import CONSTANTS, another_day, draw_move
from vo2_studies.challenge.device_files import device_document, draw_preset
from vo2_studies.challenge.devices import PRESETS, Device, Preset, draw_device
from vo2_studies.challenge.effect import ConcealedEffect, Context, Drawn
from vo2_studies.challenge.excess import branch_of, excess_by_channel
from vo2_studies.challenge.excitation import calibration_current, excitation
from vo2_studies.challenge.outside import COMPOSED, describe
from vo2_studies.challenge.plan import RANGE, CasePlan
from vo2_studies.challenge.rig import Noise, Plan, Truth, channels_of, draw_rig_noise, log_channels, simulate

__all__ = [
    "Case",
    "Recorded",
    "day_recording",
    "draw_case",
    "draw_rig",
    "follow_up_recording",
    "runs_of",
]

EXCESS_RANGE = {
    "one": ((3.0, 1000.0),),
    "always": ((12.0, 1000.0),),
    "beside": ((12.0, 1000.0),),
    "two": ((60.0, 3000.0), (12.0, 300.0)),
    "outside": ((12.0, 1000.0),),
}
"""Excess residual aimed at, in units of the noise power, for each effect of a case of this kind.

A draw outside is repeated up to `TRIES` times. Single effects reach below the 10 from which they are scored.
"""
TRIES = 16

Array = NDArray[np.floating]


@dataclass(frozen=True)
class Recorded:
    """One recording as a bag holds it: measurements, and stamps [s] and currents [A] of the commands if there are any."""

    measurement: Recording
    commands: tuple[Array, Array] | None


@dataclass(frozen=True)
class Case:
    """One drawn case: both recordings, what the diagnosis must not see, and what repeats the device.

    Attributes
    ----------
    plan : what was planned
    preset : the rig as its data sheet tells it; None of a measured device
    calibration, test : what the rig recorded
    answer : JSON-ready truth
    document : content of its device file; None of a rig that is a preset
    shared : name of a calibration that other cases have too, so that it is fitted once; empty for its own
    others : name, which begins with `day_`, and recording of each that is diagnosed together with the test
    """

    plan: CasePlan
    preset: Preset | None
    calibration: Recorded
    test: Recorded
    answer: dict
    document: Mapping[str, Any] | None = None
    shared: str = ""
    others: tuple[tuple[str, Recorded], ...] = ()


@dataclass(frozen=True)
class _Rig:
    """A drawn device with its sensors: what all recordings of a case share."""

    device: Device
    noise: Noise
    shunt: bool
    condition: Condition

    def run(
        self, device: Device, command: Array, plan: Plan, rng: np.random.Generator
    ) -> tuple[Truth, Recorded]:
        """Return the truth of one run and what is recorded of it."""
        jitter = self.condition.draw_jitter(rng, command.size)
        truth = simulate(device, command, plan, jitter)
        return truth, self.record(truth, plan, rng)

    def record(self, truth: Truth, plan: Plan, rng: np.random.Generator) -> Recorded:
        """Return what is recorded of a run; it starts at a random stamp."""
        channels = log_channels(truth, plan, self.noise, rng, shunt=self.shunt)
        commanded = np.concatenate([[np.nan], truth.command[:-1]])
        start = float(rng.integers(10, 1000))
        period = self.device.preset.sample_period
        whole = Recording(
            np.asarray(start + truth.time, dtype=np.float64),
            channels | {COMMANDED_CURRENT: commanded},
            self.device.preset.name,
        )
        stamps = start + np.arange(truth.command.size - 1) * period + self.condition.command_shift
        return Recorded(self.condition.spoil(rng, whole, self.noise), (stamps, truth.command[:-1]))


def draw_rig(seed: int, plan: CasePlan) -> Preset:
    """Return the rig of a case as its data sheet tells it."""
    preset = PRESETS[plan.device]
    if plan.rigs != RANGE:
        return preset
    return draw_preset(np.random.default_rng([seed, 59, plan.index]), preset)


def _rig(seed: int, plan: CasePlan, misfit: float) -> tuple[np.random.Generator, _Rig]:
    """Return the case's randomness after drawing the rig."""
    rng = np.random.default_rng([seed, 29, plan.index])
    preset = draw_rig(seed, plan)
    device = draw_device(rng, preset, misfit=misfit, family=plan.family)
    noise = draw_rig_noise(rng, device)
    needs_set_value = any(form.needs_set_value for name in plan.effects for form in forms(name))
    shunt = bool(rng.random() < 0.5) and not needs_set_value
    condition = draw_condition(
        np.random.default_rng([seed, 61, plan.index]),
        plan.condition,
        preset.sample_period,
        channels_of(device),
    )
    return rng, _Rig(device, noise, shunt, condition)


def _changed(seed: int, plan: CasePlan, device: Device) -> tuple[Device, dict]:
    """Return the device on the day of the test and what the answer says of it."""
    rng = np.random.default_rng([seed, 67, plan.index])
    said: dict = {"day": {}, "moved": []}
    if plan.kind == "day":
        device, said["day"] = another_day(rng, device)
    if plan.constant:
        (constant,) = (one for one in CONSTANTS if one.name == plan.constant)
        by = draw_move(rng, constant)
        device = constant.move(device, by)
        said["moved"] = [{"constant": constant.name, "by": by, "unit": constant.unit}]
    return device, said


def draw_case(seed: int, plan: CasePlan, *, misfit: float = 0.1) -> Case:
    """Draw the case of `plan`: same arguments, same recordings bit for bit."""
    rng, rig = _rig(seed, plan, misfit)
    preset, noise = rig.device.preset, rig.noise
    first = calibration_current(rng, preset)
    command = excitation(rng, preset, plan.excitation, plan.samples)
    device, said = _changed(seed, plan, rig.device)
    jitter = rig.condition.draw_jitter(rng, command.size)
    clean = simulate(device, command, Plan(), jitter)
    unchanged = clean if device is rig.device else simulate(rig.device, command, Plan(), jitter)
    context = Context(rng, device, command.size * preset.sample_period)
    drawn, each = [], []
    limits = EXCESS_RANGE.get(plan.kind, ())
    order = rng.permutation(len(plan.effects))  # which of two is the larger
    for k, name in enumerate(plan.effects):
        effect, alone, excess = _draw_in_range(
            forms(name), context, clean, command, noise, limits[int(order[k])], jitter
        )
        drawn.append(effect)
        each.append((alone, excess))
    together = Plan()
    for effect in drawn:
        effect.into(together, context)
    truth = each[0][0] if len(drawn) == 1 else simulate(device, command, together, jitter)
    test = rig.record(truth, together, rng)
    _, calibration = rig.run(rig.device, first, together if plan.kind == "always" else Plan(), rng)
    excess = excess_by_channel(unchanged, truth, together, noise)
    answer = {
        "index": plan.index,
        "kind": plan.kind,
        "device": plan.device,
        "duration_s": context.duration,
        "samples": int(command.size),
        "logged_current": "shunt" if rig.shunt else "set",
        "misfit": misfit,
        "family": plan.family,
        "condition": plan.condition,
        "command_delay_s": -rig.condition.command_shift,
        "excitation": plan.excitation,
        "rig": {"id": preset.name, "scales": preset.scales._asdict()},
        **said,
        "effects": [
            _effect_answer(effect, alone_excess, clean, alone, noise, rig.shunt, context)
            for effect, (alone, alone_excess) in zip(drawn, each, strict=True)
        ],
        "excess_by_channel": excess,
        "excess": max(excess.values(), default=0.0),
        "noise": {name: {"sd": n.sd, "coloured": n.coloured, "rho": n.rho} for name, n in noise.items()},
    }
    document = device_document(preset) if plan.rigs == RANGE else None
    return Case(plan, preset, calibration, test, answer, document)


def follow_up_recording(
    seed: int, plan: CasePlan, answer: dict, command: Array, *, misfit: float = 0.1
) -> Recorded:
    """Return a recording of the same concealed device with the same effects, driven with `command` (n,) [A].

    This is what a user gets who plays the experiment that the diagnosis proposes.
    """
    _, rig = _rig(seed, plan, misfit)
    device, _ = _changed(seed, plan, rig.device)
    rng = np.random.default_rng([seed, 31, plan.index])
    # drifts keep the pace that they had in the first recording
    context = Context(rng, device, answer["duration_s"])
    together = Plan()
    for entry in answer["effects"]:
        redrawn(entry["id"], entry["form"], entry["parameters"], entry["signal"]).into(together, context)
    return rig.run(device, command, together, rng)[1]


def day_recording(
    seed: int, plan: CasePlan, answer: dict, day: int, *, misfit: float = 0.1
) -> tuple[Recorded, dict[str, float]]:
    """Return what the device of a case records on another day with another path, and what is other that day.

    Parameters
    ----------
    seed, plan, misfit : of the case
    answer : of it, with the effects that act that day
    day : number of the day, from 1
    """
    _, rig = _rig(seed, plan, misfit)
    rng = np.random.default_rng([seed, 71, plan.index, day])
    device, other = another_day(rng, rig.device)
    command = excitation(rng, rig.device.preset, plan.excitation, plan.samples)
    context = Context(rng, device, answer["duration_s"])
    together = Plan()
    for entry in answer["effects"]:
        redrawn(entry["id"], entry["form"], entry["parameters"], entry["signal"]).into(together, context)
    return rig.run(device, command, together, rng)[1], other


def runs_of(
    seed: int, plan: CasePlan, answer: dict, *, misfit: float = 0.1
) -> tuple[Device, Plan, tuple[Array, Array], Noise]:
    """Return the concealed device, its effects, the commands [A] of calibration and recording, and the noise.

    Parameters
    ----------
    seed, plan, misfit : of the case
    answer : of it
    """
    rng, rig = _rig(seed, plan, misfit)
    first = calibration_current(rng, rig.device.preset)
    command = excitation(rng, rig.device.preset, plan.excitation, plan.samples)
    context = Context(rng, rig.device, answer["duration_s"])
    together = Plan()
    for entry in answer["effects"]:
        redrawn(entry["id"], entry["form"], entry["parameters"], entry["signal"]).into(together, context)
    return rig.device, together, (first, command), rig.noise


def _draw_in_range(
    choices: tuple[ConcealedEffect, ...],
    context: Context,
    clean: Truth,
    command: Array,
    noise: Noise,
    limits: tuple[float, float],
    jitter: Array | None,
) -> tuple[Drawn, Truth, dict[str, float]]:
    """Draw one of the forms until its excess is inside `limits`; else keep the draw that came nearest."""
    tried: list[tuple[float, Drawn, Truth, dict[str, float]]] = []
    low, high = np.log(limits)
    effect = choices[int(context.rng.integers(len(choices)))]
    for _ in range(TRIES):
        drawn = draw_effect(effect, context)
        plan = Plan()
        drawn.into(plan, context)
        truth = simulate(context.device, command, plan, jitter)
        excess = excess_by_channel(clean, truth, plan, noise)
        size = np.log(max(*excess.values(), 1e-9))
        miss = max(low - size, size - high, 0.0)
        tried.append((miss, drawn, truth, excess))
        if miss == 0.0:
            break
    return min(tried, key=lambda one: one[0])[1:]


def _effect_answer(
    drawn: Drawn,
    excess: dict[str, float],
    clean: Truth,
    truth: Truth,
    noise: Noise,
    shunt: bool,
    context: Context,
) -> dict:
    total = sum(excess.values())
    channels = [name for name, value in excess.items() if total > 0 and value >= 0.2 * total]
    if drawn.effect.driver and shunt:
        channels.append(HEATER_CURRENT)
    values = drawn.values
    steady = drawn.effect.id == "laser_heating" and values["switched_off"] > context.duration
    return {
        "id": drawn.effect.id,
        "form": drawn.effect.form,
        "siblings": list(drawn.effect.siblings),
        "families": list(families(drawn)),
        "composition": describe(values) if drawn.effect is COMPOSED else None,
        "signal": drawn.signal,
        "parameters": {
            name: {"value": value, "unit": unit} for name, (value, unit) in drawn.parameters.items()
        },
        "excess": max(excess.values(), default=0.0),
        "excess_by_channel": excess,
        "channels": channels,
        "branch": branch_of(clean, truth, noise),
        "absorbed_by_constant": bool(steady),
    }
