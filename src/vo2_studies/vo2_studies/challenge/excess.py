"""How much an effect changes a recording, in units of the noise power: known exactly, by running with and without."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from vo2_models.recording import RESISTANCE

from vo2_studies.challenge.rig import Noise, Plan, Truth

__all__ = ["branch_of", "excess_by_channel", "residuals"]

Array = NDArray[np.floating]
ONE_SIDED = 4.0
"""A branch counts as the place of an effect if its mean excess a sample is this many times that of the other."""


def _judged(channel: str, values: Array) -> Array:
    """Return values as they are judged: resistance in log10 ohm."""
    return np.log10(values) if channel == RESISTANCE else values


def _difference(clean: Truth, truth: Truth, channel: str, plan: Plan, noise: Noise) -> Array:
    """Return with minus without (n,), both behind the same noise where a converter acts on the channel."""
    without, with_ = clean.channels[channel], truth.channels[channel]
    converters = [convert for name, convert in plan.converter if name == channel]
    if converters:
        # the noise decides which steps of a converter are reached: one fixed realisation for both
        unit = np.random.default_rng(5).standard_normal(without.size) * noise[channel].sd
        shake = (lambda y: y * 10**unit) if channel == RESISTANCE else (lambda y: y + unit)
        without, with_ = shake(without), shake(with_)
        for convert in converters:
            with_ = convert(with_)
    return _judged(channel, with_) - _judged(channel, without)


def residuals(clean: Truth, truth: Truth, plan: Plan, noise: Noise) -> Array:
    """Return with minus without of all channels, one behind the other (n,), in standard deviations of each one's noise."""
    return np.concatenate(
        [_difference(clean, truth, name, plan, noise) / noise[name].sd for name in clean.channels]
    )


def excess_by_channel(clean: Truth, truth: Truth, plan: Plan, noise: Noise) -> dict[str, float]:
    """Return channel -> mean square of (with - without) over the channel's noise variance [1]."""
    return {
        name: float(np.mean(_difference(clean, truth, name, plan, noise) ** 2)) / noise[name].sd ** 2
        for name in clean.channels
    }


def branch_of(clean: Truth, truth: Truth, noise: Noise) -> str:
    """Return "heating", "cooling" or "both": where the noise-weighted excess lies.

    One-sided means that its mean per sample on that branch is `ONE_SIDED` times that on the other; samples at
    rest count for neither.
    """
    rate = np.gradient(clean.temperature)
    moving = np.abs(rate) > 0.02 * np.quantile(np.abs(rate), 0.95)
    energy = np.zeros(rate.size)
    for name in clean.channels:
        energy += (_judged(name, truth.channels[name]) - _judged(name, clean.channels[name])) ** 2 / noise[
            name
        ].sd ** 2
    up, down = (float(np.mean(energy[moving & side])) for side in (rate > 0, rate < 0))
    if up > ONE_SIDED * down:
        return "heating"
    return "cooling" if down > ONE_SIDED * up else "both"
