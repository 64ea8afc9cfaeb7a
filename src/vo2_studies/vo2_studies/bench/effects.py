"""Whether every effect still gives the outputs that it gave: against a stored reference, on both shipped devices.

A change of the simulation that is meant to change no output shows here that it does not. One that is meant to, or a new
effect, writes the reference anew with `python -m vo2_studies.bench.effects`, and its commit says which outputs moved.
"""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from importlib.resources import files
from pathlib import Path

import numpy as np
from vo2_models.device.description import preset
from vo2_models.device.ground_truth import truth
from vo2_models.effects import effects

from vo2_studies.bench.entry import Entry, Figure
from vo2_studies.bench.simulation import fitted_chain

__all__ = ["ENTRIES", "Difference", "compare", "measure", "reference"]

_FILE = files("vo2_studies.bench") / "effects_reference.json"
_SETS = 2
"""Sets of signs in which the samples of a channel are added up: a change of any sample changes both sums."""

Reference = dict[str, dict[str, list[float] | str]]
"""Case -> channel -> its span and the sums; "digest" -> of all its channels."""


def _currents(device: str) -> np.ndarray:
    """Sweep, random levels of 12 samples, and long holds, for what needs the film at rest."""
    cold, warm = preset(device).operating_range
    sweep = np.linspace(0.0, 1.0, 30)
    levels = np.random.default_rng(7).uniform(0.0, 1.0, 40)
    share = np.concatenate(
        [np.repeat(np.r_[sweep, sweep[::-1], levels], 12), np.repeat([0.3, 0.6, 0.9, 0.5], 400)]
    )
    return cold + (warm - cold) * share


def measure(cases: frozenset[str] | None = None) -> Reference:
    """Return span, sums and digest of the outputs of every case.

    Parameters
    ----------
    cases : those that are wanted; None for all that the catalogue has
    """
    found: Reference = {}
    for device in ("integrated", "peltier"):
        current = _currents(device)
        simulations = {f"{device} device": truth(device, seed=1)}
        if device == "integrated":
            simulations["integrated model"] = fitted_chain()  # type: ignore[assignment]
        for kind, simulation in simulations.items():
            for name, given in _effects(device):
                case = f"{kind}, {name}" if name else kind
                if cases is None or case in cases:
                    run = simulation.with_effects(given).simulate(current, noise=False)
                    found[case] = _summary({name: run[name] for name in preset(device).channels})
    return found


def _effects(device: str) -> Iterator[tuple[str, Mapping[str, Mapping[str, float | str]]]]:
    """No effect, then each on each signal, at the geometric middle of its visible magnitudes."""
    yield "", {}
    for record in effects().values():
        if record.occurs_on(device):
            for signal in record.signals(device):
                middle: dict[str, float | str] = {
                    n: math.sqrt(low * high) for n, (low, high) in record.magnitudes(device, signal).items()
                }
                key = f"{record.id}:{signal}" if signal else record.id
                yield key, {record.id: {**middle, "signal": signal} if signal else middle}


def _summary(channels: Mapping[str, np.ndarray]) -> dict[str, list[float] | str]:
    digest = hashlib.sha256()
    found: dict[str, list[float] | str] = {}
    for channel in sorted(channels):
        values = np.ascontiguousarray(channels[channel])
        digest.update(channel.encode() + values.tobytes())
        signs = np.random.default_rng(0).choice([-1.0, 1.0], (_SETS, values.size))
        found[channel] = [float(np.ptp(values)), *(math.fsum(each * values) for each in signs)]
    return {**found, "digest": digest.hexdigest()[:16]}


def reference() -> Reference:
    """Return the stored reference."""
    return json.loads(_FILE.read_text(encoding="utf-8"))


@dataclass(frozen=True)
class Difference:
    """How far outputs are from the reference.

    Attributes
    ----------
    largest : difference [span of the channel]; of two sums over n samples, divided by the square root of n
    where : case and channel of the largest
    exact, cases : how many cases agree to the last bit, of how many
    """

    largest: float
    where: str
    exact: int
    cases: int


def compare(stored: Reference, now: Reference) -> Difference:
    """Return how far outputs are from the stored ones; one that is gone or NaN is infinitely far.

    Parameters
    ----------
    stored, now : as `measure` returns them
    """
    largest, where = 0.0, "nowhere"
    for case, channels in stored.items():
        for channel, expected in channels.items():
            if channel == "digest":
                continue
            found = now.get(case, {}).get(channel)
            apart = math.inf
            if found is not None:
                step = float(np.max(np.abs(np.subtract(found, expected, dtype=np.float64))))
                scale = float(expected[0] or 1.0) * math.sqrt(_currents(case.split()[0]).size)
                apart = math.inf if math.isnan(step) else step / scale
            if apart > largest:
                largest, where = apart, f"{case}: {channel}"
    exact = sum(now.get(case, {}).get("digest") == channels["digest"] for case, channels in stored.items())
    return Difference(largest, where, exact, len(stored))


def unchanged() -> Figure:
    """The largest difference of any output of any case from the reference, in units of the channel's span."""
    stored = reference()
    apart = compare(stored, measure(frozenset(stored)))
    note = f"{apart.exact} of {apart.cases} cases to the last bit; largest difference: {apart.where}"
    return Figure(apart.largest, "of span", note=note)


ENTRIES = (Entry("effects", unchanged, 1e-12),)


if __name__ == "__main__":
    rows = ",\n".join(f"{json.dumps(case)}: {json.dumps(values)}" for case, values in measure().items())
    Path(str(_FILE)).write_text(f"{{\n{rows}\n}}\n", encoding="utf-8")
    print(f"wrote {_FILE}")
