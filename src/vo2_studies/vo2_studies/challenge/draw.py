"""Draw cases: which kind, which device, which effects; then both recordings and the answer.

The plan of case i depends on the seed and on i only, so that a longer run continues a shorter one. Of eight
cases two have no effect, four have one, one has two, one has an effect outside the catalogue; single effects are
taken in turn, a shuffled catalogue at a time, and each effect in turn on the presets it applies to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, Recording

from vo2_studies.challenge.catalogue import CATALOGUE, OUTSIDE, draw_effect, find
from vo2_studies.challenge.devices import PRESETS, Device, draw_device
from vo2_studies.challenge.effect import ConcealedEffect, Context, Drawn
from vo2_studies.challenge.excess import branch_of, excess_by_channel
from vo2_studies.challenge.excitation import EXCITATIONS, calibration_current
from vo2_studies.challenge.rig import Noise, Plan, Truth, draw_rig_noise, log_channels, simulate

__all__ = ["KINDS", "Case", "CasePlan", "draw_case", "follow_up_recording", "plan_case"]

KINDS = ("none", "one", "two", "outside")
ROUND = ("none", "one", "two", "one", "none", "one", "outside", "one")
EXCESS_RANGE = {"one": (3.0, 1000.0), "two": (12.0, 1000.0), "outside": (12.0, 1000.0)}
"""Excess residual aimed at, in units of the noise power, for each effect of a case of this kind.

A draw outside is repeated up to `TRIES` times. Single effects reach below the 10 from which they are scored.
"""
TRIES = 16
CONFUSABLE = (
    {"sensor_lag", "clock_offset", "sensor_gain_drift", "adc_saturation", "adc_quantization"},
    {"driver_saturation", "driver_slew", "driver_deadzone"},
)
"""A case of two effects takes at most one of each group: two converters on one channel are no separate effects."""

Array = NDArray[np.floating]


@dataclass(frozen=True)
class CasePlan:
    """What case `index` is about: kind, preset, effect ids, family of the hysteresis."""

    index: int
    kind: str
    device: str
    effects: tuple[str, ...]
    family: str = "plays"


@dataclass(frozen=True)
class Case:
    """One drawn case: both recordings, what the diagnosis must not see, and what repeats the device.

    Attributes
    ----------
    plan : what was planned
    calibration, test : recordings, effect-free and with the effects
    answer : JSON-ready truth
    """

    plan: CasePlan
    calibration: Recording
    test: Recording
    answer: dict


def _turn(seed: int, stream: int, count: int, number: int) -> int:
    """Return the `number`-th element of an endless sequence of shuffled decks of `count` cards."""
    deck, card = divmod(number, count)
    return int(np.random.default_rng([seed, stream, deck]).permutation(count)[card])


def plan_case(
    seed: int,
    index: int,
    *,
    only_effects: Sequence[str] = (),
    device: str | None = None,
    kinds: Sequence[str] = (),
    families: Sequence[str] = ("plays",),
) -> CasePlan:
    """Return the plan of case `index`; `families` are taken in turn, a shuffled deck at a time.

    With `only_effects` every case has one effect, of these; `device` restricts to one preset (an effect that does
    not apply to it is left out); `kinds` restricts the kinds, in the order of the contract's shares.

    Raises
    ------
    ValueError : unknown effect, device or kind, or nothing left to draw from.
    """
    if device is not None and device not in PRESETS:
        raise ValueError(f"device: found {device!r}, need one of {', '.join(PRESETS)}")
    if unknown := sorted(set(kinds) - set(KINDS)):
        raise ValueError(f"kinds: found {', '.join(unknown)}, need some of {', '.join(KINDS)}")
    cycle = [kind for kind in ROUND if not kinds or kind in kinds]
    if only_effects:
        cycle = ["one"]
    kind = cycle[index % len(cycle)]
    # how many of this kind came before: its turn in the deck
    number = index // len(cycle) * cycle.count(kind) + cycle[: index % len(cycle)].count(kind)
    family = families[_turn(seed, 37, len(families), index)]
    rng = np.random.default_rng([seed, 11, index])
    presets = list(PRESETS) if device is None else [device]

    def usable(effects: Sequence[ConcealedEffect]) -> list[ConcealedEffect]:
        left = [effect for effect in effects if set(effect.presets) & set(presets)]
        if not left:
            raise ValueError(f"effects: found none that applies to {', '.join(presets)}")
        return left

    if kind == "none":
        return CasePlan(index, kind, presets[number % len(presets)], (), family)
    if kind == "two":
        name = presets[number % len(presets)]
        pool = [effect for effect in CATALOGUE if name in effect.presets]
        first = pool[_turn(seed, 13, len(pool), number // len(presets))]
        rivals = [e for e in pool if e is not first and not any({e.id, first.id} <= g for g in CONFUSABLE)]
        return CasePlan(index, kind, name, (first.id, rivals[int(rng.integers(len(rivals)))].id), family)
    wanted = [find(name) for name in only_effects] if only_effects else CATALOGUE
    pool = usable(OUTSIDE if kind == "outside" else wanted)
    effect = pool[_turn(seed, 17 if kind == "one" else 19, len(pool), number)]
    where = [name for name in effect.presets if name in presets]
    deck = number // len(pool)
    start = int(np.random.default_rng([seed, 23, pool.index(effect)]).integers(len(where)))
    return CasePlan(index, kind, where[(deck + start) % len(where)], (effect.id,), family)


def _case_parts(seed: int, plan: CasePlan, misfit: float) -> tuple[np.random.Generator, Device, Noise, bool]:
    """Return the case's randomness after drawing device, noise and whether the rig logs the true current."""
    rng = np.random.default_rng([seed, 29, plan.index])
    device = draw_device(rng, plan.device, misfit=misfit, family=plan.family)
    noise = draw_rig_noise(rng, device)
    shunt = bool(rng.random() < 0.5) and not any(find(name).needs_set_value for name in plan.effects)
    return rng, device, noise, shunt


def draw_case(
    seed: int,
    plan: CasePlan,
    *,
    misfit: float = 0.1,
    excitation: str = "informative",
) -> Case:
    """Draw the case of `plan`: same arguments, same recordings bit for bit. `excitation` is one of `EXCITATIONS`."""
    rng, device, noise, shunt = _case_parts(seed, plan, misfit)
    preset = device.preset
    calibration = _record(
        device, simulate(device, calibration_current(rng, preset), Plan()), Plan(), noise, rng, shunt
    )
    command = EXCITATIONS[excitation](rng, preset)
    clean = simulate(device, command, Plan())
    context = Context(rng, device, command.size * preset.sample_period)
    drawn, each = [], []
    for name in plan.effects:
        effect, alone, excess = _draw_in_range(
            find(name), context, clean, command, noise, EXCESS_RANGE[plan.kind]
        )
        drawn.append(effect)
        each.append((alone, excess))
    together = Plan()
    for effect in drawn:
        effect.into(together, context)
    truth = each[0][0] if len(drawn) == 1 else simulate(device, command, together)
    test = _record(device, truth, together, noise, rng, shunt)
    excess = excess_by_channel(clean, truth, together, noise)
    answer = {
        "index": plan.index,
        "kind": plan.kind,
        "device": plan.device,
        "duration_s": context.duration,
        "logged_current": "shunt" if shunt else "set",
        "misfit": misfit,
        "family": plan.family,
        "effects": [
            _effect_answer(effect, alone_excess, clean, alone, noise, shunt, context)
            for effect, (alone, alone_excess) in zip(drawn, each, strict=True)
        ],
        "excess_by_channel": excess,
        "excess": max(excess.values(), default=0.0),
        "noise": {name: {"sd": n.sd, "coloured": n.coloured, "rho": n.rho} for name, n in noise.items()},
    }
    return Case(plan, calibration, test, answer)


def follow_up_recording(
    seed: int,
    plan: CasePlan,
    answer: dict,
    command: Array,
    *,
    misfit: float = 0.1,
) -> Recording:
    """Return a recording of the same concealed device with the same effects, driven with `command` (n,) [A].

    This is what a user gets who plays the experiment that the diagnosis proposes.
    """
    _, device, noise, shunt = _case_parts(seed, plan, misfit)
    rng = np.random.default_rng([seed, 31, plan.index])
    # drifts keep the pace that they had in the first recording
    context = Context(rng, device, answer["duration_s"])
    together = Plan()
    for entry in answer["effects"]:
        parameters = {name: (p["value"], p["unit"]) for name, p in entry["parameters"].items()}
        Drawn(find(entry["id"]), parameters, entry["signal"]).into(together, context)
    return _record(device, simulate(device, command, together), together, noise, rng, shunt)


def _draw_in_range(
    effect: ConcealedEffect,
    context: Context,
    clean: Truth,
    command: Array,
    noise: Noise,
    limits: tuple[float, float],
) -> tuple[Drawn, Truth, dict[str, float]]:
    """Draw `effect` until its excess is inside `limits`; else keep the draw that came nearest."""
    best: tuple[float, Drawn, Truth, dict[str, float]] | None = None
    low, high = np.log(limits)
    for _ in range(TRIES):
        drawn = draw_effect(effect, context)
        plan = Plan()
        drawn.into(plan, context)
        truth = simulate(context.device, command, plan)
        excess = excess_by_channel(clean, truth, plan, noise)
        size = np.log(max(*excess.values(), 1e-9))
        miss = max(low - size, size - high, 0.0)
        if best is None or miss < best[0]:
            best = (miss, drawn, truth, excess)
        if miss == 0.0:
            break
    assert best is not None
    return best[1:]


def _record(
    device: Device, truth: Truth, plan: Plan, noise: Noise, rng: np.random.Generator, shunt: bool
) -> Recording:
    """Return the logged channels as a recording that starts at a random stamp."""
    channels = log_channels(truth, plan, noise, rng, shunt=shunt)
    commanded = np.concatenate([[np.nan], truth.command[:-1]])
    start = float(rng.integers(10, 1000))
    time = np.asarray(start + truth.time, dtype=np.float64)
    return Recording(time, channels | {COMMANDED_CURRENT: commanded}, device.preset.name)


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
    values = {name: value for name, (value, _) in drawn.parameters.items()}
    steady = drawn.effect.id == "laser_heating" and values["switched_off"] > context.duration
    return {
        "id": drawn.effect.id,
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
