"""Numbers no such device can have, and the unit that they may be in: what a wrong unit or a swapped column looks like."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import DeviceDescription, preset
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
_FAR_RANGE = 150.0
_MOST_OF_IT = 0.5
_HOTTEST_DEGC = 200.0
_COLDEST_DEGC = -100.0


def impossible(recording: Recording, device: str) -> list[str]:
    """Return what cannot be: values beyond what the device allows or physics knows, one clause each.

    Parameters
    ----------
    recording : in roles, in the units of a recording (A, ohm, m, degC)
    device : as `preset` takes it
    """
    nominal = preset(device)
    found = []
    for name, values in recording.channels.items():
        finite = values[np.isfinite(values)]
        if finite.size and (text := _impossible(name, finite, nominal)):
            found.append(text)
    return found


def unusual(recording: Recording, device: str) -> list[str]:
    """Return what is far from the device of the preset, but may be so on another one of its kind; one clause each.

    Parameters
    ----------
    recording : in the contract's channels and units
    """
    nominal = preset(device)
    small = _small_deflection(recording, nominal)
    if (
        not nominal.tells("responses", nominal.names.get(RESISTANCE, ""), "range")
        or RESISTANCE not in recording
    ):
        return small
    values = recording[RESISTANCE]
    values = values[np.isfinite(values)]
    found = []
    negative = int(np.count_nonzero(values <= 0))
    if 0 < negative <= 0.5 * values.size:
        found.append(
            f"{nominal.names[RESISTANCE]} is not above zero in {negative} samples, which count as missing"
        )
    values = values[values > 0]
    if values.size:
        low, high = nominal.resistance_range
        ratio = float(np.sqrt(values.min() * values.max()) / np.sqrt(low * high))
        if not 1 / _FAR < ratio < _FAR:
            guess = " (is it in kohm?)" if ratio < 1 else ""
            found.append(
                f"{nominal.names[RESISTANCE]} runs from {values.min():.4g} to {values.max():.4g} ohm, device {nominal.id} has "
                f"{low:.4g} to {high:.4g} ohm: check the unit{guess}"
            )
    return found + small


def _small_deflection(recording: Recording, nominal: DeviceDescription) -> list[str]:
    """What says that a deflection is in too large a unit: next to none of it, though the drive went far."""
    name = nominal.names.get(TIP_DEFLECTION, "")
    if not nominal.tells("responses", name, "range") or not {TIP_DEFLECTION, HEATER_CURRENT} <= set(
        recording.channels
    ):
        return []
    tip, drive = (v[np.isfinite(v)] for v in (recording[TIP_DEFLECTION], recording[HEATER_CURRENT]))
    low, high = nominal.operating_range
    if not tip.size or not drive.size or np.ptp(drive) < _MOST_OF_IT * abs(high - low):
        return []
    # a constant is a broken lead in any unit
    if np.ptp(tip) == 0.0 or np.ptp(tip) * _FAR_RANGE > nominal.deflection_range:
        return []
    unit = nominal.units.get(TIP_DEFLECTION, "m")
    return [
        f"{name} spans {np.ptp(tip):.3g} {unit}, device {nominal.id} spans {nominal.deflection_range:.4g} {unit}: "
        f"check the unit{_by_a_thousand(nominal.deflection_range / float(np.ptp(tip)))}"
    ]


def _by_a_thousand(ratio: float) -> str:
    """What a ratio of sizes hints at: nothing where it is far from powers of a thousand."""
    steps = round(np.log10(ratio) / 3.0) if ratio > 0.0 else 0
    near = steps > 0 and abs(np.log10(ratio) - 3.0 * steps) < 1.0
    return f" (off by a factor of {10 ** (3 * steps):,}?)".replace(",", " ") if near else ""


def _impossible(role: str, values: NDArray[np.float64], nominal: DeviceDescription) -> str:
    low, high = float(np.min(values)), float(np.max(values))
    name, unit = nominal.names.get(role, role), nominal.units.get(role, "")
    if role == HEATER_CURRENT:
        least, most = nominal.current_range
        slack = _MARGIN * (most - least)
        if low >= least - slack and high <= most + slack:
            return ""
        milli = low >= 1e3 * (least - slack) and high <= 1e3 * (most + slack) and high > 20 * most
        guess = (
            f" (is it in m{unit}?)"
            if milli and len(unit) == 1
            else _by_a_thousand(high / most)
            if most > 0
            else ""
        )
        if least >= 0 > low and high <= slack:
            guess = " (is its sign reversed?)"
        return (
            f"{name} runs from {low:.4g} to {high:.4g} {unit}, device {nominal.id} allows {least:.4g} to {most:.4g} "
            f"{unit}: check the unit{guess}"
        )
    if role == RESISTANCE and np.count_nonzero(values > 0) < 0.5 * values.size:
        return f"{name} is not above zero in most samples ({low:.4g} to {high:.4g} {unit}): check the sign and the column"
    if role == TIP_DEFLECTION and nominal.tells("responses", name, "range"):
        extent = nominal.deflection_range
        if high - low > _FAR_RANGE * extent:
            guess = " (is it in um?)" if unit == "m" else _by_a_thousand((high - low) / extent)
            return (
                f"{name} runs from {low:.4g} to {high:.4g} {unit}, device {nominal.id} spans {extent:.4g} {unit}: "
                f"check the unit{guess}"
            )
    if role == STAGE_TEMPERATURE and (low < _COLDEST_DEGC or high > _HOTTEST_DEGC):
        guess = " (is it in K?)" if low > 200 else ""
        return f"{name} runs from {low:.4g} to {high:.4g} degC: check the unit{guess}"
    return ""
