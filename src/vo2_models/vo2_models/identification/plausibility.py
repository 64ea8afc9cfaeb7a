"""Numbers no such device can have, and the unit that they may be in: what a wrong unit or a swapped column looks like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.presets import PRESETS, Preset
from vo2_models.recording import (
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

__all__ = ["impossible", "unusual"]

_MARGIN = 0.05
_FAR = 30.0
_LONGEST_M = 10e-3
_HOTTEST_DEGC = 200.0
_COLDEST_DEGC = -100.0


def impossible(recording: Recording, device: str) -> list[str]:
    """Return what cannot be: values beyond what the device allows or physics knows, one clause each.

    Nothing is said about a device without a preset.

    Parameters
    ----------
    recording : in the units of a recording (A, ohm, m, degC)
    device : preset id
    """
    nominal = PRESETS.get(device)
    if nominal is None:
        return []
    found = []
    for name, values in recording.channels.items():
        finite = values[np.isfinite(values)]
        if finite.size and (text := _impossible(name, finite, nominal)):
            found.append(text)
    return found


def unusual(recording: Recording, device: str) -> list[str]:
    """Return what is far from the device of the preset, but may be so on another one of its kind; one clause each."""
    nominal = PRESETS.get(device)
    if nominal is None or RESISTANCE not in recording:
        return []
    values = recording[RESISTANCE]
    values = values[np.isfinite(values)]
    found = []
    negative = int(np.count_nonzero(values <= 0))
    if 0 < negative <= 0.5 * values.size:
        found.append(f"{RESISTANCE} is not above zero in {negative} samples, which count as missing")
    values = values[values > 0]
    if values.size:
        low, high = nominal.resistance_range
        ratio = float(np.sqrt(values.min() * values.max()) / np.sqrt(low * high))
        if not 1 / _FAR < ratio < _FAR:
            guess = " (is it in kohm?)" if ratio < 1 else ""
            found.append(
                f"{RESISTANCE} runs from {values.min():.4g} to {values.max():.4g} ohm, device {nominal.id} has "
                f"{low:.4g} to {high:.4g} ohm: check the unit{guess}"
            )
    return found


def _impossible(name: str, values: NDArray[np.float64], nominal: Preset) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    if name == HEATER_CURRENT:
        least, most = nominal.current_range
        slack = _MARGIN * (most - least)
        if low >= least - slack and high <= most + slack:
            return ""
        milli = low >= 1e3 * (least - slack) and high <= 1e3 * (most + slack) and high > 20 * most
        guess = " (is it in mA?)" if milli else ""
        if least >= 0 > low and high <= slack:
            guess = " (is its sign reversed?)"
        return (
            f"{name} runs from {low:.4g} to {high:.4g} A, device {nominal.id} allows {least:.4g} to {most:.4g} A: "
            f"check the unit{guess}"
        )
    if name == RESISTANCE and np.count_nonzero(values > 0) < 0.5 * values.size:
        return f"{name} is not above zero in most samples ({low:.4g} to {high:.4g} ohm): check the sign and the column"
    if name == TIP_DEFLECTION and high - low > _LONGEST_M:
        return (
            f"{name} runs from {low:.4g} to {high:.4g} m, device {nominal.id} bends by "
            f"{nominal.deflection_range:.4g} m: check the unit (is it in um?)"
        )
    if name == STAGE_TEMPERATURE and (low < _COLDEST_DEGC or high > _HOTTEST_DEGC):
        guess = " (is it in K?)" if low > 200 else ""
        return f"{name} runs from {low:.4g} to {high:.4g} degC: check the unit{guess}"
    return ""
