"""What the rig plays: a calibration (damped oscillation and a little dynamics) and the recording to be diagnosed.

They are sequences of commanded currents, one per sample, drawn anew for every case within the operating range.
Levels are chosen as nominal steady temperatures, so that both presets share one design; the slow Peltier stage is
led along its profile by the inverse of its nominal first-order lag.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vo2_studies.challenge.devices import Preset

__all__ = [
    "EXCITATIONS",
    "TEST_SAMPLES",
    "calibration_current",
    "excitation",
    "informative_current",
    "loop_current",
    "played_current",
    "sines_current",
    "steps_current",
    "triangle_current",
]

Array = NDArray[np.floating]
TEST_SAMPLES = 10_000
LOOP_SAMPLES = 2600
COLD, HOT = -1.7, 1.7
"""Places below and above the transition, in the coordinate of `_Profile.at`."""


class _Profile:
    """Collects temperature profiles and current pieces of one preset into one command sequence.

    A place x is a temperature around the nominal transition: x = 0 is its middle, x = -1 and 1 its ends
    (loop half-width plus 2.2 standard deviations away). All numbers of samples are multiplied by `pace`.
    """

    def __init__(self, preset: Preset, start: float, pace: float = 1.0) -> None:
        self.preset = preset
        self.pace = pace
        self.middle = preset.heating[0] - preset.width[0] / 2
        self.half = preset.width[0] / 2 + 2.2 * preset.heating[1]
        # half-transformed on heating at +branch, on cooling at -branch
        self.branch = preset.width[0] / 2 / self.half
        self.pieces: list[Array] = []
        self.temperature = start
        self.lag = preset.time_constant / preset.sample_period
        self.quick = self.lag < 20
        cold, hot = sorted(float(preset.steady_temperature(i)) for i in preset.operating)
        self.ends = (
            (-2.2, 1.75)
            if not self.quick
            else ((cold - self.middle) / self.half, (hot - self.middle) / self.half)
        )

    def at(self, place: float) -> float:
        return self.middle + self.half * place

    def count(self, samples: int) -> int:
        return max(2, round(samples * self.pace))

    def follow(self, temperature: Array) -> None:
        """Append the currents that lead the nominal device along `temperature` (n,) [degC]."""
        goal = np.asarray(temperature, dtype=float)
        lead = 0.0 if self.quick else self.lag * np.diff(goal, prepend=self.temperature)
        self.pieces.append(self.preset.steady_current(goal + lead))
        self.temperature = float(goal[-1])

    def ramp(self, place: float, samples: int) -> None:
        """Append a ramp of the temperature to `place`."""
        self.follow(np.linspace(self.temperature, self.at(place), self.count(samples) + 1)[1:])

    def hold(self, samples: int) -> None:
        """Append a rest at the present temperature."""
        self.follow(np.full(self.count(samples), self.temperature))

    def level(self, temperature: float, samples: int) -> None:
        """Append a current step: the steady current of `temperature` [degC], held."""
        samples = self.count(samples)
        self.pieces.append(np.full(samples, float(self.preset.steady_current(temperature))))
        self.temperature = temperature + (self.temperature - temperature) * float(np.exp(-samples / self.lag))

    def chirp(self, swing: float, f0: float, f1: float, samples: int) -> None:
        """Append a logarithmic chirp around the present temperature.

        `swing` [K] is the amplitude of the steady temperature, less where a current limit is nearer;
        frequencies in cycles per sample.
        """
        samples = self.count(samples)
        k = np.arange(samples)
        phase = 2 * np.pi * f0 * samples / np.log(f1 / f0) * ((f1 / f0) ** (k / samples) - 1)
        limits = [float(self.preset.steady_temperature(i)) for i in self.preset.current_limits]
        room = min(max(limits) - self.temperature, self.temperature - min(limits))
        self.pieces.append(self.preset.steady_current(self.temperature + min(swing, room) * np.sin(phase)))

    def current(self) -> Array:
        return np.concatenate(self.pieces)


def calibration_current(rng: np.random.Generator, preset: Preset) -> Array:
    """Return commanded currents [A] (n,): cold rest, quasi-static damped oscillation, then steps and a chirp.

    `integrated` dwells 10 ms on each level (5.5 time constants); `peltier`, whose stage temperature is measured,
    is led along slow ramps instead.
    """
    profile = _Profile(preset, preset.ambient)
    quick = profile.quick
    cycles = 14 if quick else 12
    low, high = profile.ends
    profile.pieces.append(np.zeros(60))  # cold rest: the history before the recording is known
    profile.level(profile.at(low), 60)
    place = low
    for k in range(cycles):
        # linear decay down to the transition's ends, so that most turns lie inside it
        share = 1 - k / cycles
        for end in (min(high, 1.35 * share + 0.05), max(low, -1.35 * share - 0.05)):
            end = {0: high if end > 0 else low}.get(k, end) + float(rng.uniform(-0.02, 0.02)) * (k > 0)
            if quick:
                count = max(3, round(abs(end - place) * 9))
                for step in np.linspace(place, end, count + 1)[1:]:
                    profile.level(profile.at(float(step)), 10)
            else:
                profile.ramp(end, max(80, round(190 * abs(end - place))))
            place = end
    for step in rng.permutation([-1.6, 1.5, -0.6, 0.6, 0.0, 1.9, -1.0]):
        profile.level(profile.at(float(step)), 70 if quick else 420)
    profile.ramp(HOT, 60 if quick else 240)
    profile.ramp(-profile.branch, 60 if quick else 240)
    if quick:
        profile.chirp(14.0, 0.003, 0.2, 900)
    else:
        profile.chirp(24.0, 0.0006, 0.02, 3200)
    return profile.current()


def informative_current(rng: np.random.Generator, preset: Preset, samples: int = TEST_SAMPLES) -> Array:
    """Return commanded currents [A] (samples,) of the minimum informative recording.

    Two equal major loops at start and end; between them steps of several sizes, a first-order reversal fan, small
    chirps above, inside and below the transition, random levels and two holds (inside and outside), in this order.
    """
    profile = _Profile(preset, preset.ambient, samples / TEST_SAMPLES)
    quick = profile.quick
    low, high = profile.ends

    def major() -> None:
        profile.ramp(high, 560 if quick else 720)
        profile.hold(60)
        profile.ramp(low, 560 if quick else 480)
        profile.hold(60)

    profile.pieces.append(np.zeros(60))  # as a rig is switched on
    profile.ramp(low, 80 if quick else 160)
    major()
    for step in rng.permutation([1.9, -1.6, 0.5, -0.4, 1.0, -2.0, 0.1, -0.9]):
        profile.level(profile.at(float(step + rng.uniform(-0.1, 0.1))), 100 if quick else 150)
    profile.ramp(1.7, 120 if quick else 320)
    for turn in np.linspace(0.5, -0.95, 7) + rng.uniform(-0.04, 0.04, 7):
        stretch = 1.7 - float(turn)
        profile.ramp(float(turn), round(90 * stretch + 10) if quick else round(60 * stretch + 20))
        profile.ramp(1.7, round(90 * stretch + 10) if quick else round(105 * stretch + 20))
    # a slow stage undershoots at the chirp's start: begin it higher on the cooling branch
    inside = -profile.branch + (0.0 if quick else 0.25)
    for place in (HOT, inside, COLD):
        profile.ramp(place, 80 if quick else 160)
        if quick:
            profile.chirp(5.0, 0.004, 0.42, 480)
        else:
            profile.chirp(25.0, 0.006, 0.3, 400)
    for _ in range(60 if quick else 11):
        spread = profile.half * 2.2 if quick else 25.0
        temperature = profile.middle + rng.uniform(-1, 1) * spread
        profile.level(float(temperature), int(rng.integers(10, 34)) if quick else int(rng.integers(50, 100)))
    side = float(rng.choice([-1.0, 1.0]))
    inside = side * profile.branch + rng.uniform(-0.12, 0.12)
    for place in rng.permutation([inside, rng.choice([COLD, HOT])]):
        # onto the branch that is half-transformed there: from the cold for the heating branch
        profile.ramp(HOT if side < 0 else COLD, 100 if quick else 250)
        profile.ramp(float(place), 60 if quick else 150)
        profile.hold(560 if quick else 420)
    profile.ramp(low, 120 if quick else 240)
    head = profile.current()
    profile.pieces.clear()
    major()
    tail = profile.current()
    room = samples - tail.size
    if head.size < room:
        head = np.concatenate([head, np.full(room - head.size, head[-1])])
    return np.concatenate([head[:room], tail])


def loop_current(rng: np.random.Generator, preset: Preset, samples: int = LOOP_SAMPLES) -> Array:
    """Return commanded currents [A] (samples,) of one slow major loop, and nothing else.

    What a rig records first. On it effects are confounded by design: there is one rate, one history and one loop.
    """
    return _loops(rng, preset, samples, samples - 220)


def triangle_current(rng: np.random.Generator, preset: Preset, samples: int = TEST_SAMPLES) -> Array:
    """Return commanded currents [A] (samples,) of equal slow major loops and nothing else.

    The easiest recording to make, and the one that tells least: on it effects that act at one rate, on one loop or on
    one part of the loop only look alike.
    """
    return _loops(rng, preset, samples, int(rng.integers(2200, 2600)))


def _loops(rng: np.random.Generator, preset: Preset, samples: int, loop: int) -> Array:
    profile = _Profile(preset, preset.ambient)
    low, high = profile.ends
    profile.pieces.append(np.zeros(60))
    profile.ramp(low, 80 if profile.quick else 160)
    for _ in range(max(1, (samples - 220) // loop)):
        profile.ramp(high, loop // 2)
        profile.ramp(low, loop // 2)
    profile.hold(samples)
    return profile.current()[:samples]


def steps_current(rng: np.random.Generator, preset: Preset, samples: int = TEST_SAMPLES) -> Array:
    """Return commanded currents [A] (samples,) of steps between random levels, each held for 3 to 30 time constants."""
    profile = _Profile(preset, preset.ambient)
    profile.pieces.append(np.zeros(60))
    held = max(profile.lag, 2.0)
    total = 60
    while total < samples:
        count = (
            int(held * np.exp(rng.uniform(np.log(3), np.log(30))))
            if profile.quick
            else int(rng.integers(200, 900))
        )
        low, high = sorted(float(preset.steady_temperature(i)) for i in preset.operating)
        profile.level(float(rng.uniform(low, high)), count)
        total += count
    return profile.current()[:samples]


def sines_current(rng: np.random.Generator, preset: Preset, samples: int = TEST_SAMPLES) -> Array:
    """Return commanded currents [A] (samples,): a sum of three sines of the steady temperature across the transition."""
    low, high = sorted(float(preset.steady_temperature(i)) for i in preset.operating)
    k = np.arange(samples)
    frequencies = np.exp(rng.uniform(np.log(3), np.log(200), 3)) / samples
    sizes = rng.dirichlet([2.0, 2.0, 2.0]) * (high - low) / 2
    phases = rng.uniform(0, 2 * np.pi, 3)
    wave = np.sum(
        [a * np.sin(2 * np.pi * f * k + p) for a, f, p in zip(sizes, frequencies, phases, strict=True)],
        axis=0,
    )
    current = preset.steady_current((low + high) / 2 + wave)
    current[:60] = 0.0
    return current


EXCITATIONS = {
    "informative": informative_current,
    "triangle": triangle_current,
    "loop": loop_current,
    "steps": steps_current,
    "sines": sines_current,
}
"""What the recording to be diagnosed may be."""


def excitation(rng: np.random.Generator, preset: Preset, name: str, samples: int | None) -> Array:
    """Return commanded currents [A] of the excitation `name`; without `samples` as long as it usually is.

    What is longer than `TEST_SAMPLES` is several in a row, drawn anew each time.
    """
    play = EXCITATIONS[name]
    if samples is None:
        return play(rng, preset)
    count = -(-samples // TEST_SAMPLES)
    return np.concatenate([play(rng, preset, samples // count) for _ in range(count)])


def played_current(excitation: Mapping[str, Any], preset: Preset) -> Array:
    """Return the commanded currents [A] (n,) of an experiment that a diagnosis proposes.

    Understood are the identifier's parameters, with or without the prefix "excitation.": `levels_a` approached at
    `rate_a_per_s` (0: steps) and held for `hold_s` each, after and before `cold_s` at the coldest operating
    current; or `current_a`, one value a sample.

    Raises
    ------
    ValueError : neither levels nor currents, or values that are not finite.
    """
    plain = {str(key).removeprefix("excitation."): value for key, value in excitation.items()}
    period = preset.sample_period
    if "current_a" in plain:
        current = np.asarray(plain["current_a"], dtype=float)
    elif plain.get("levels_a") is not None:
        hold = max(1, round(float(plain.get("hold_s") or 10 * preset.time_constant) / period))
        rate = float(plain.get("rate_a_per_s") or 0.0)
        cold = np.full(max(1, round(float(plain.get("cold_s") or 0.0) / period)), preset.operating[0])
        pieces, last = [cold], preset.operating[0]
        for level in plain["levels_a"]:
            if rate > 0:
                pieces.append(
                    np.linspace(last, level, max(2, round(abs(level - last) / rate / period) + 1))[1:]
                )
            pieces.append(np.full(hold, float(level)))
            last = float(level)
        current = np.concatenate([*pieces, cold])
    else:
        raise ValueError(f"excitation: found {', '.join(plain) or 'nothing'}, need levels_a or current_a")
    if current.size < 2 or not np.all(np.isfinite(current)):
        raise ValueError("excitation: found fewer than 2 or non-finite currents, need finite ones")
    return np.clip(current, *preset.current_limits)
