"""Numbers no such device can have, and the unit that they may be in: what a wrong unit or a swapped column looks like."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.description import DeviceDescription, preset
from vo2_models.diagnosis.limits import Limits
from vo2_models.recording import (
    COMMANDED_CURRENT,
    HEATER_CURRENT,
    RESISTANCE,
    STAGE_TEMPERATURE,
    TIP_DEFLECTION,
    Recording,
)

__all__ = ["doubts", "impossible", "undriven", "unexcited", "unusual"]

_MARGIN = 0.05
_FAR = 30.0
_FAR_RANGE = 150.0
_MOST_OF_IT = 0.5
_HOTTEST_DEGC = 200.0
_COLDEST_DEGC = -100.0
_OVERDRIVEN = 3.0
"""Times its limits to which a drive of this device may be taken to go, by mistake: beyond it may be another channel."""
_EXCITED = 0.1
"""Share of its range that a channel spans at least where its values are taken to fit into that range."""
_PREFIXES = tuple(1000.0**k for k in range(-4, 5))


def doubts(recording: Recording, device: str) -> list[str]:
    """Return all that speaks of a wrong unit, sign or column, one clause each.

    Parameters
    ----------
    recording, device : as `impossible` takes them
    """
    found = [*impossible(recording, device), *unusual(recording, device)]
    still = unexcited(recording[HEATER_CURRENT], device) if HEATER_CURRENT in recording else ""
    return [*found, still] if still else found


def impossible(recording: Recording, device: str, *, limits: Limits | None = None) -> list[str]:
    """Return what cannot be: a copy of another channel, values beyond what the device allows or physics knows; one clause each.

    Parameters
    ----------
    recording : in roles, in the units of a recording (A, ohm, m, degC)
    device : as `preset` takes it
    limits : of copies and swaps; those of a diagnosis by default
    """
    nominal = preset(device)
    if mixed := _mixed_up(recording, nominal, limits or Limits()):
        return [nominal.in_own_names(mixed)]
    known = {name: values[np.isfinite(values)] for name, values in recording.channels.items()}
    known = {name: values for name, values in known.items() if values.size}
    return [text for name in known if (text := _impossible(name, known, nominal))]


def undriven(recording: Recording, device: str) -> str:
    """Return what says that a recording lacks the drive of the device, in its own names; empty where it has it.

    Parameters
    ----------
    recording, device : as `impossible` takes them
    """
    if HEATER_CURRENT in recording:
        return ""
    nominal = preset(device)
    says = f" (it says {recording.device})" if recording.device_id not in ("", nominal.id) else ""
    found = nominal.in_own_names(", ".join(recording.channels) or "none")
    return (
        f"found channels {found}, need {nominal.drive_channel}, the drive of device {nominal.id}: "
        f"is it a recording of another device{says}?"
    )


def unexcited(drive: NDArray[np.float64], device: str, *, limits: Limits | None = None) -> str:
    """Return what says that a drive hardly changes, as one in too large a unit; empty where it does.

    Parameters
    ----------
    drive : (n,) of a recording, or of several one after the other
    device : as `preset` takes it
    limits : of a drive that excites nothing; those of a diagnosis by default
    """
    nominal, known = preset(device), drive[np.isfinite(drive)]
    low, high = sorted(nominal.operating_range)
    extent = float(np.ptp(known)) if known.size else 0.0
    if extent >= (limits or Limits()).no_drive * (high - low):
        return ""
    guess = _by_a_thousand((high - low) / extent) if extent else " and column"
    return (
        f"{nominal.drive_channel} varies by {extent:.3g} {nominal.drive_unit} of an operating range of {high - low:.3g}: "
        f"check its unit{guess}, or record an excitation"
    )


def _mixed_up(recording: Recording, device: DeviceDescription, limits: Limits) -> str:
    """What says that two channels are one, or each other's; empty for nothing."""
    drive = COMMANDED_CURRENT if COMMANDED_CURRENT in recording else HEATER_CURRENT
    present = [c for c in (drive, RESISTANCE, TIP_DEFLECTION) if c in recording]
    for first, second in combinations(present, 2):
        x, y = recording[first], recording[second]
        both = np.isfinite(x) & np.isfinite(y) & (x != 0.0)
        if np.count_nonzero(both) > 2 and np.ptp(x[both]) > 0.0 and np.any(y[both]):
            ratio = y[both] / x[both]
            if np.ptp(ratio) <= limits.copied * float(np.max(np.abs(ratio))):
                return f"{second} is a copy of {first}, times {ratio[0]:.4g}: need what each sensor measured"
    ends = {RESISTANCE: device.resistance_range[1], TIP_DEFLECTION: max(map(abs, device.deflection_extent))}
    if all(c in recording and np.isfinite(recording[c]).any() for c in ends):
        largest = {c: float(np.nanmax(np.abs(recording[c]))) for c in ends}
        crossed = (largest[RESISTANCE] / ends[TIP_DEFLECTION], largest[TIP_DEFLECTION] / ends[RESISTANCE])
        distinct = ends[RESISTANCE] > limits.far_off**2 * ends[TIP_DEFLECTION]
        if distinct and all(1.0 / limits.far_off < ratio < limits.far_off for ratio in crossed):
            return f"{RESISTANCE} and {TIP_DEFLECTION} are swapped: each has the values of the other"
    return ""


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
    if steps <= 0 or abs(np.log10(ratio) - 3.0 * steps) >= 1.0:
        return ""
    factor = f"{10 ** (3 * steps):,}".replace(",", " ")
    return f" (off by a factor of {factor}, in the values or in the map?)"


def _fits(values: NDArray[np.float64], ends: tuple[float, float]) -> bool:
    """Whether values (n,) lie between ends, and span enough of what is between them to be at home there."""
    slack = _MARGIN * (ends[1] - ends[0])
    inside = ends[0] - slack <= np.min(values) and np.max(values) <= ends[1] + slack
    return bool(inside and np.ptp(values) >= _EXCITED * (ends[1] - ends[0]))


def _swapped(
    known: dict[str, NDArray[np.float64]], nominal: DeviceDescription, factors: Sequence[float]
) -> str:
    """The response whose column may be that of the drive and the other way round, up to factors of units; empty for none."""
    extents = {RESISTANCE: nominal.resistance_range, TIP_DEFLECTION: nominal.deflection_extent}
    for role, extent in extents.items():
        if role not in known or not any(_fits(f * known[role], nominal.current_range) for f in factors):
            continue
        told = nominal.tells("responses", nominal.names.get(role, ""), "range")
        if not told or any(_fits(f * known[HEATER_CURRENT], extent) for f in _PREFIXES):
            return nominal.names.get(role, role)
    return ""


def _impossible(role: str, known: dict[str, NDArray[np.float64]], nominal: DeviceDescription) -> str:
    values = known[role]
    low, high = float(np.min(values)), float(np.max(values))
    name, unit = nominal.names.get(role, role), nominal.units.get(role, "")
    if role == HEATER_CURRENT:
        least, most = nominal.current_range
        slack = _MARGIN * (most - least)
        if low >= least - slack and high <= most + slack:
            return ""
        allowed = f"device {nominal.id} allows {least:.4g} to {most:.4g} {unit}"
        told = f"{name} runs from {low:.4g} to {high:.4g} {unit}, {allowed}: check "
        if least - slack <= -high and -low <= most + slack:
            return f"{told}the unit (is its sign reversed?)"
        times = max(abs(low), abs(high)) / max(abs(least), abs(most))
        guess = _by_a_thousand(times)
        far = high < least - slack or low > most + slack or times > _OVERDRIVEN
        # where a unit explains it, another column must fit as it is
        other = _swapped(known, nominal, (1.0,) if guess else _PREFIXES) if far else ""
        swap = f"the column: are those of {name} and {other} swapped?" if other else ""
        return told + " and ".join(filter(None, [f"the unit{guess}" if guess or not other else "", swap]))
    if role == RESISTANCE and np.count_nonzero(values > 0) < 0.5 * values.size:
        return f"{name} is not above zero in most samples ({low:.4g} to {high:.4g} {unit}): check the sign and the column"
    if role == TIP_DEFLECTION and nominal.tells("responses", name, "range"):
        extent = nominal.deflection_range
        if high - low > _FAR_RANGE * extent:
            return (
                f"{name} runs from {low:.4g} to {high:.4g} {unit}, device {nominal.id} spans {extent:.4g} {unit}: "
                f"check the unit{_by_a_thousand((high - low) / extent)}"
            )
    if role == STAGE_TEMPERATURE and (low < _COLDEST_DEGC or high > _HOTTEST_DEGC):
        guess = " (is it in K?)" if low > 200 else ""
        return f"{name} runs from {low:.4g} to {high:.4g} degC: check the unit{guess}"
    return ""
