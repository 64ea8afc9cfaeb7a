"""Turn the hooks of the effect files into the stage functions of the compiled chain.

For each hook of the catalogue one function is written that asks every effect with that hook, in the order of the
effects, and passes over those that are off. What a hook names as arguments is filled in by name: quantities of the
stage, parameters and states of the effect, constants of the device. `vo2_models.device.generated` holds the result.
"""

from __future__ import annotations

import inspect
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cache

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import CHANNELS, Block, Coefficient, blocks, first_flag
from vo2_models.device.state import Slot
from vo2_models.effects import Effect, effects
from vo2_models.effects.record import ADVANCE, HOOKS, SETTLED

__all__ = ["Plan", "plan", "source", "state_size"]

_DEVICE = {
    "time_constant_of_body": Coefficient.TIME_CONSTANT,
    "time_constant_between": Coefficient.BETWEEN,
    "ambient_of_device": Coefficient.AMBIENT,
    "on_stage": Coefficient.ON_STAGE,
}
FLAGS = (
    *HOOKS,
    "resistance",
    "middle",
    "advance:thermal",
    "advance:transition",
    "any:heat",
    "any:film",
    "any:phase",
)
"""What the chain asks before it looks at single effects: whether any that is on has the hook, heats with the film's
resistance, takes the anhysteretic curve, or has states to be moved on in the stage; and whether any of them acts on the
heat of the body, between the body and what the transitions see, or on the phase alone."""
_HEATED = ("ambient", "heating", "pumping", "conductance", "loss", "lag", "latent", "advance:thermal")
_SHIFTED = ("body", "film", "shift", "advance:transition")
_OF_PHASE = ("shift", "structural_shift", "feedback", "follow", "beside", "latent", "conductance", "bending")


@dataclass(frozen=True)
class Plan:
    """What follows from the catalogue for each block of the coefficient vector.

    Attributes
    ----------
    keys : (n,) of the blocks
    active : (n,) places that say whether each is on
    flags : (len(FLAGS), n) which blocks raise which flag
    feedback : (n,) blocks with which the exact one-step solution of the linear thermal model does not suffice
    every_step : (n,) blocks with which the transitions must be asked at every step
    """

    keys: tuple[str, ...]
    active: NDArray[np.intp]
    flags: NDArray[np.bool_]
    feedback: NDArray[np.bool_]
    every_step: NDArray[np.bool_]


def _takes(record: Effect, hook: str) -> tuple[str, ...]:
    """What a hook of an effect names as its arguments; empty where it does not have the hook."""
    return tuple(inspect.signature(record.hooks[hook]).parameters) if hook in record.hooks else ()


@cache
def plan() -> Plan:
    """Return the plan of the catalogue."""
    keys = tuple(blocks())
    records = [effects()[blocks()[key].effect] for key in keys]
    flags = np.zeros((len(FLAGS), len(keys)), dtype=bool)
    feedback = np.zeros(len(keys), dtype=bool)
    every = np.zeros(len(keys), dtype=bool)
    for k, record in enumerate(records):
        own = {state.name for state in record.states}
        warmed_by_film = any("resistance" in _takes(record, h) for h in ("heating", "film"))
        for f, name in enumerate(FLAGS):
            flags[f, k] = name in record.hooks
        flags[FLAGS.index("resistance"), k] = warmed_by_film
        flags[FLAGS.index("middle"), k] = "middle" in _takes(record, "beside")
        if "advance" in record.hooks and record.stage in ("thermal", "transition"):
            flags[FLAGS.index(f"advance:{record.stage}"), k] = True
        for name, parts in (("any:heat", _HEATED), ("any:film", _SHIFTED), ("any:phase", _OF_PHASE)):
            flags[FLAGS.index(name), k] = any(flags[FLAGS.index(part), k] for part in parts)
        feedback[k] = warmed_by_film or any(HOOKS[h].substeps for h in record.hooks if h in HOOKS)
        every[k] = (
            warmed_by_film
            or any(h in record.hooks for h in ("latent", "feedback", "follow", "beside", "conductance"))
            or "film" in _takes(record, "shift")
            or not own.isdisjoint(_takes(record, "structural_shift"))
        )
    active = np.array([blocks()[key].active for key in keys], dtype=np.intp)
    return Plan(keys, active, flags, feedback, every)


@cache
def state_size() -> int:
    """Return the length of the scalar memory: the chain's own, and the states of all effects."""
    sizes = [s.size for block in blocks().values() for s in effects()[block.effect].states]
    return len(Slot) + len(CHANNELS) + sum(sizes)


def _first_state() -> int:
    return len(Slot) + len(CHANNELS)


def _with_hook(name: str) -> Iterator[tuple[Effect, Block]]:
    """Effects with a hook, lowest order first, then by id."""
    found = [(effects()[block.effect], block) for block in blocks().values()]
    yield from sorted(
        (pair for pair in found if name in pair[0].hooks), key=lambda pair: (pair[0].order, pair[0].id)
    )


def _value(record: Effect, block: Block, name: str, quantities: Mapping[str, str]) -> str:
    """Expression for one argument of a hook."""
    if name in block.places:
        return f"c[{block.places[name]}]"
    if name in block.states:
        place = _first_state() + block.states[name]
        size = next(s.size for s in record.states if s.name == name)
        return f"x[{place}]" if size == 1 else str(place)
    if name == "memory":
        return "x"
    if name == "course":
        return f"x[{int(Slot.COURSE)}]"
    if name == "period":
        return f"c[{int(Coefficient.SAMPLE_PERIOD)}]"
    if name in _DEVICE:
        return f"c[{int(_DEVICE[name])}]"
    if name == "fraction" and "phase" in block.places:
        return quantities["fraction"].replace("WHICH", f"lead(c[{block.places['phase']}], x)")
    return quantities[name].replace("WHICH", "lead(0.0, x)")


def _call(record: Effect, block: Block, hook: str, quantities: Mapping[str, str]) -> str:
    arguments = (_value(record, block, name, quantities) for name in _takes(record, hook))
    return f"{_name(record, hook)}({', '.join(arguments)})"


def _name(record: Effect, hook: str) -> str:
    return f"{record.id}__{hook}"


def _assign(record: Effect, block: Block, hook: str, quantities: Mapping[str, str], indent: str) -> list[str]:
    """Lines that give the states what `advance` or `settled` returns."""
    states = [s for s in record.states if hook == "settled" or s.size == 1]
    call = _call(record, block, hook, quantities)
    if not states:
        return [f"{indent}{call}"]
    lines = [f"{indent}new = {call}"]
    for k, state in enumerate(states):
        place = _first_state() + block.states[state.name]
        value = "new" if len(states) == 1 else f"new[{k}]"
        target = f"x[{place}]" if state.size == 1 else f"x[{place}:{place + state.size}]"
        lines.append(f"{indent}{target} = {value}")
    return lines


def _settle(record: Effect, block: Block, quantities: Mapping[str, str], indent: str) -> list[str]:
    if "settled" in record.hooks:
        return _assign(record, block, "settled", quantities, indent)
    lines = []
    for state in record.states:
        place = _first_state() + block.states[state.name]
        target = f"x[{place}]" if state.size == 1 else f"x[{place}:{place + state.size}]"
        lines.append(f"{indent}{target} = {state.settled!r}")
    return lines


def _plain(names: Sequence[str]) -> dict[str, str]:
    return {name: name for name in names}


def _guarded(name: str, arguments: Sequence[str], flag: str, otherwise: str) -> list[str]:
    """A function so short that the compiler takes it into its caller, and the head of the one that asks the effects."""
    given = ", ".join(["c", "x", *arguments])
    return [
        f"def {name}({given}):",
        f"    if c[{first_flag() + FLAGS.index(flag)}] == 0.0:",
        f"        return {otherwise}",
        f"    return {name}_of_effects({given})",
        "",
        f"def {name}_of_effects({given}):",
    ]


def _sum(hook: str, *, start: str = "0.0", by: str = "+=") -> list[str]:
    """Function that adds up, or multiplies, what the effects give."""
    names = list(HOOKS[hook].takes)
    quantities = _plain(names)
    if hook == "conductance":
        names = []
        quantities = {
            "fraction": f"(x[{int(Slot.FRACTION_R)} + WHICH] + 0.5 * x[{int(Slot.LAST_CHANGE_R)} + WHICH])"
        }
    if hook in ("shift", "structural_shift"):
        names, quantities = [], {"film": f"x[{int(Slot.FILM)}]"}
    lines = [*_guarded(hook, names, hook, start), f"    total = {start}"]
    for record, block in _with_hook(hook):
        lines += [
            f"    if c[{block.active}] != 0.0:",
            f"        total {by} {_call(record, block, hook, quantities)}",
        ]
    return [*lines, "    return total", ""]


def _pair(hook: str) -> list[str]:
    """Function that adds up pairs."""
    names = list(HOOKS[hook].takes)
    lines = [*_guarded(hook, names, hook, "0.0, 0.0"), "    one, other = 0.0, 0.0"]
    for record, block in _with_hook(hook):
        call = _call(record, block, hook, _plain(names))
        lines += [
            f"    if c[{block.active}] != 0.0:",
            f"        a, b = {call}",
            "        one += a",
            "        other += b",
        ]
    return [*lines, "    return one, other", ""]


def _first(hook: str, otherwise: str, *, of: str = "") -> list[str]:
    """Function that asks the first effect that is on; `of` : text to return instead of what the hook gives."""
    names = list(HOOKS[hook].takes) if not of else []
    lines = _guarded(f"lead_of_{hook}" if of else hook, names, hook, otherwise)
    for record, block in _with_hook(hook):
        phase = f"c[{block.places['phase']}]" if "phase" in block.places else "0.0"
        given = of.replace("PHASE", phase) or _call(record, block, hook, _plain(names))
        lines += [f"    if c[{block.active}] != 0.0:", f"        return {given}"]
    return [*lines, f"    return {otherwise}", ""]


def _in_turn(hook: str, quantity: str, *, linear: bool = False) -> list[str]:
    """Function that passes a quantity through the effects; states of the stage are moved on just before each."""
    names = list(HOOKS[hook].takes)
    name = f"linear_{hook}" if linear else hook
    lines = _guarded(name, names, hook, quantity)
    for record, block in _with_hook(hook):
        if linear and not record.linear:
            continue
        lines.append(f"    if c[{block.active}] != 0.0:")
        if "advance" in record.hooks:
            lines += _assign(record, block, "advance", _plain(list(ADVANCE[record.stage])), " " * 8)
        lines.append(f"        {quantity} = {_call(record, block, hook, _plain(names))}")
    return [*lines, f"    return {quantity}", ""]


def _rest_in_turn(hook: str, quantity: str, extra: Mapping[str, str]) -> list[str]:
    """Function that brings the states of a stage to rest, and returns the quantity behind it."""
    stage = HOOKS[hook].stage
    lines = [f"def settle_{stage}(c, x, {quantity}):"]
    quantities = {**_plain([quantity]), **extra}
    for record, block in _with_hook(hook):
        lines.append(f"    if c[{block.active}] != 0.0:")
        if record.states:
            lines += _settle(record, block, quantities, " " * 8)
        lines.append(f"        {quantity} = {_call(record, block, hook, quantities)}")
    return [*lines, f"    return {quantity}", ""]


def _of_stage(stage: str, what: str) -> list[str]:
    """Function that moves on, or brings to rest, all states of the thermal or the transition stage."""
    names = list(ADVANCE[stage] if what == "advance" else SETTLED[stage])
    name = f"{what}_{stage}"
    if what == "advance":
        lines = _guarded(name, names, name.replace("_", ":"), "None")
    else:
        lines = [f"def {name}({', '.join(['c', 'x', *names])}):"]
    for record, block in _with_hook("advance"):
        if record.stage == stage:
            lines.append(f"    if c[{block.active}] != 0.0:")
            if what == "advance":
                lines += _assign(record, block, "advance", _plain(names), " " * 8)
            else:
                lines += _settle(record, block, _plain(names), " " * 8)
    return [*lines, "    return None", ""]


def _sensors(hook: str, *, rest: bool = False) -> list[str]:
    """Function that passes a channel's value through its sensor effects, in time or at rest."""
    names = list(HOOKS[hook].takes)
    at_rest = {"value": "value", "time": "0.0", "period": "1.0", "sample": "0", "current": "0.0"}
    head = ["def settle_sensor(c, x, channel, value):"]
    lines = head if rest else _guarded(hook, ["channel", *names], hook, "value")
    for place, channel in enumerate(CHANNELS):
        inner: list[str] = []
        for record, block in _with_hook(hook):
            if block.signal != channel:
                continue
            inner.append(f"        if c[{block.active}] != 0.0:")
            if rest:
                if record.states:
                    inner += _settle(record, block, at_rest, " " * 12)
                continue
            if "advance" in record.hooks:
                inner += _assign(record, block, "advance", _plain(names), " " * 12)
            inner.append(f"            value = {_call(record, block, hook, _plain(names))}")
        if rest:  # an effect without memory leaves nothing to be done
            inner = [line for k, line in enumerate(inner) if not _empty(inner, k)]
        if inner:
            lines += [f"    if channel == {place}:", *inner]
    return [*lines, "    return value", ""]


def _empty(lines: Sequence[str], k: int) -> bool:
    """Whether line k is a condition with nothing below it."""
    return lines[k].endswith(":") and (k + 1 == len(lines) or lines[k + 1].endswith(":"))


@cache
def source() -> str:
    """Return the text of the generated module."""
    parts: list[str] = [
        "def lead(phase, x):",
        '    """Which transition stands for the phase: the structural one, if it is known, unless the effect says otherwise."""',
        f"    return 0 if x[{int(Slot.HAS_D)}] == 0.0 or (phase > 0.5 and x[{int(Slot.HAS_R)}] > 0.0) else 1",
        "",
    ]
    for hook in (
        "ambient",
        "heating",
        "pumping",
        "conductance",
        "latent",
        "film",
        "shift",
        "structural_shift",
    ):
        parts += _sum(hook)
    for hook in ("feedback", "beside", "bending"):
        parts += _sum(hook)
    parts += _pair("loss") + _pair("body") + _sum("lag", start="1.0", by="*=")
    parts += _first("follow", "equilibrium")
    parts += _first("latent", "1", of="lead(PHASE, x)")
    parts += _in_turn("drive", "current") + _in_turn("terminals", "value")
    parts += _in_turn("structure", "deflection") + _in_turn("structure", "deflection", linear=True)
    parts += _rest_in_turn("drive", "current", {"previous": "0.0", "time": "0.0", "period": "1.0"})
    parts += _rest_in_turn(
        "terminals", "value", {"current": "0.0", "time": "0.0", "film": f"x[{int(Slot.FILM)}]"}
    )
    parts += _rest_in_turn("structure", "deflection", {"period": "1.0"})
    for stage in ("thermal", "transition"):
        parts += _of_stage(stage, "advance") + _of_stage(stage, "settle")
    parts += _sensors("sensor") + _sensors("sensor", rest=True) + _sensors("converter")
    return "\n".join(parts)
