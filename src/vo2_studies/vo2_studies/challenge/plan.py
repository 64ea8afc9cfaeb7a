"""What a case is about, decided by the seed and its number alone, so that a longer run continues a shorter one.

Of sixteen cases four have no effect that a diagnosis may name (two unchanged, one on another day, one with a constant
moved), eight have one effect (five since the calibration, two there all along, one beside a moved constant), two have
two, and two have physics composed outside the catalogue. Effects, families, conditions and excitations are taken in
turn, a shuffled deck at a time, and each effect in turn on the presets it applies to.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from vo2_studies.challenge.catalogue import IDS, OUTSIDE, presets_of
from vo2_studies.challenge.conditions import CONDITIONS
from vo2_studies.challenge.constants import CONSTANTS
from vo2_studies.challenge.devices import PRESETS
from vo2_studies.challenge.excitation import EXCITATIONS
from vo2_studies.challenge.families import ALL, chosen_families

__all__ = ["KINDS", "ROUND", "CasePlan", "Choice", "plan_case"]

KINDS = ("none", "day", "moved", "one", "always", "beside", "two", "outside")
"""Unchanged, unchanged on another day, a constant moved, an effect since the calibration, an effect that was there all
along, an effect beside a moved constant, two effects, physics outside the catalogue."""
ROUND = (
    *("none", "one", "two", "always", "day", "one", "outside", "one"),
    *("moved", "beside", "two", "one", "none", "always", "outside", "one"),
)
ONE = ("one", "always", "beside")
CONFUSABLE = (
    {"sensor_lag", "clock_offset", "sensor_gain_drift", "adc_saturation", "adc_quantization", "averaging"},
    {"driver_saturation", "driver_slew", "driver_deadzone", "drive_gain_drift", "source_compression"},
)
"""A case of two effects takes at most one of each group: two converters on one channel are no separate effects."""
VARIED = "all"
CLEAN, INFORMATIVE, PRESET, RANGE, BODYLESS = "clean", "informative", "preset", "range", "bodyless"


@dataclass(frozen=True)
class Choice:
    """What cases are drawn from; the same in every case of a run.

    Attributes
    ----------
    family, leave_out : of the hysteresis, see `chosen_families`
    device : one preset only, None for both
    only_effects : every case has one effect, of these
    kinds : some of `KINDS`, empty for all in the shares of `ROUND`
    condition, excitation : one, or "all" in turn
    samples : fewest and most samples of the recording to be diagnosed, None for what the excitation takes
    rigs : "preset", or "range" for devices over factors of 3 about it, given as device files
    """

    family: str = ALL
    leave_out: str = ""
    device: str | None = None
    only_effects: tuple[str, ...] = ()
    kinds: tuple[str, ...] = ()
    condition: str = CLEAN
    excitation: str = INFORMATIVE
    samples: tuple[int, int] | None = None
    rigs: str = PRESET

    def check(self) -> None:
        """Raise a `ValueError` that names what is not among what can be drawn."""
        chosen_families(self.family, self.leave_out)
        if self.device is not None and self.device not in PRESETS:
            raise ValueError(f"device: found {self.device!r}, need one of {', '.join(PRESETS)}")
        if unknown := sorted(set(self.kinds) - set(KINDS)):
            raise ValueError(f"kinds: found {', '.join(unknown)}, need some of {', '.join(KINDS)}")
        for option, value, known in (
            ("condition", self.condition, (VARIED, *CONDITIONS)),
            ("excitation", self.excitation, (VARIED, *EXCITATIONS)),
            ("rigs", self.rigs, (PRESET, RANGE)),
        ):
            if value not in known:
                raise ValueError(f"{option}: found {value!r}, need one of {', '.join(known)}")
        if self.samples is not None and not 500 <= self.samples[0] <= self.samples[1] <= 1_000_000:
            raise ValueError(f"samples: found {self.samples[0]} to {self.samples[1]}, need 500 to 1000000")


PRESETS_ONLY = Choice(family="plays")


@dataclass(frozen=True)
class CasePlan:
    """What case `index` is about.

    Attributes
    ----------
    kind, device, effects : kind, preset, effect ids
    family, condition, excitation : of the hysteresis, of the recordings, of the recording to be diagnosed
    constant : the one that has moved, or ""
    samples : of the recording to be diagnosed, None for what the excitation takes
    rigs : whether the rig is the preset or drawn about it
    """

    index: int
    kind: str
    device: str
    effects: tuple[str, ...]
    family: str = "plays"
    condition: str = CLEAN
    excitation: str = INFORMATIVE
    constant: str = ""
    samples: int | None = None
    rigs: str = field(default=PRESET)


def _turn(seed: int, stream: int, count: int, number: int) -> int:
    """Return the `number`-th element of an endless sequence of shuffled decks of `count` cards."""
    deck, card = divmod(number, count)
    return int(np.random.default_rng([seed, stream, deck]).permutation(count)[card])


def plan_case(seed: int, index: int, choice: Choice = PRESETS_ONLY) -> CasePlan:
    """Return the plan of case `index`.

    Raises
    ------
    ValueError : nothing that can be drawn, see `Choice.check`; or an effect that applies to none of the presets.
    """
    choice.check()
    cycle = [kind for kind in ROUND if not choice.kinds or kind in choice.kinds]
    if choice.only_effects:
        cycle = [kind for kind in choice.kinds if kind in ONE] or ["one"]
    kind = cycle[index % len(cycle)]
    # how many of this kind came before: its turn in the deck
    number = index // len(cycle) * cycle.count(kind) + cycle[: index % len(cycle)].count(kind)
    presets = list(PRESETS) if choice.device is None else [choice.device]
    device, effects = _device_and_effects(seed, index, kind, number, presets, choice.only_effects)

    def in_turn(stream: int, cards: Sequence[str], chosen: str) -> str:
        return chosen if chosen != VARIED else cards[_turn(seed, stream, len(cards), index)]

    families = chosen_families(choice.family, choice.leave_out)
    constants = [constant.name for constant in CONSTANTS]
    samples = None
    if choice.samples is not None:
        low, high = np.log(choice.samples)
        samples = round(float(np.exp(np.random.default_rng([seed, 41, index]).uniform(low, high))))
    return CasePlan(
        index,
        kind,
        device,
        effects,
        family=families[_turn(seed, 37, len(families), index)],
        condition=in_turn(43, CONDITIONS, choice.condition),
        excitation=in_turn(47, tuple(EXCITATIONS), choice.excitation),
        constant=constants[_turn(seed, 53, len(constants), number)] if kind in ("moved", "beside") else "",
        samples=samples,
        rigs=choice.rigs,
    )


def _device_and_effects(
    seed: int, index: int, kind: str, number: int, presets: Sequence[str], only: Sequence[str]
) -> tuple[str, tuple[str, ...]]:
    """Return preset and effect ids of the `number`-th case of this kind."""
    alternating = presets[number % len(presets)]
    if kind in ("none", "day", "moved"):
        return alternating, ()
    if kind == "outside":
        return alternating, (OUTSIDE,)
    if kind == "two":
        pool = [name for name in IDS if alternating in presets_of(name)]
        first = pool[_turn(seed, 13, len(pool), number // len(presets))]
        rivals = [e for e in pool if e != first and not any({e, first} <= group for group in CONFUSABLE)]
        rng = np.random.default_rng([seed, 11, index])
        return alternating, (first, rivals[int(rng.integers(len(rivals)))])
    pool = [name for name in (only or IDS) if set(presets_of(name)) & set(presets)]
    if not pool:
        raise ValueError(f"effects: found none that applies to {', '.join(presets)}")
    stream = 17 + ONE.index(kind)
    effect = pool[_turn(seed, stream, len(pool), number)]
    where = [name for name in presets_of(effect) if name in presets]
    deck = number // len(pool)
    start = int(np.random.default_rng([seed, 23, pool.index(effect)]).integers(len(where)))
    return where[(deck + start) % len(where)], (effect,)
