"""Fewer plays or coarser Preisach grids in a model file, chapters 2 and 3."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from math import comb

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.model import DeviceModel
from vo2_models.device.simulation import FILM_TEMPERATURE
from vo2_models.hysteresis.compression_gpi import compress as compress_plays
from vo2_models.hysteresis.envelopes import TanhEnvelopes
from vo2_models.hysteresis.fitting_gpi import fit_play_model
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.hysteresis.prandtl_ishlinskii import GPI
from vo2_models.hysteresis.preisach.compression import compress as compress_grid
from vo2_models.hysteresis.preisach.grid import cell_areas, pack
from vo2_models.hysteresis.preisach.operator import PreisachOperator
from vo2_models.identification.excitation import damped_oscillation
from vo2_models.parameters import Value
from vo2_models.self_sensing.records import SECTION
from vo2_models.self_sensing.scaled import COLD, HOT

__all__ = ["Change", "compress_levels", "compress_plays_of"]

Floats = NDArray[np.float64]

_UNCERTAINTY = "model.uncertainty."
SATURATED = 3.0
"""Argument of a tanh envelope from which on it counts as saturated: tanh 3 = 0.995."""
PROBE_LEVEL = 24
"""Level of the damped oscillation on which a law and its compression are compared."""
MOST_CHOICES = 10**9
"""Choices of walls up to which the complete enumeration takes a minute or so."""
_OVER_RESISTANCE = (f"{SECTION}.egpi", f"{SECTION}.preisach")
"""Laws whose input is no loop coordinate but the scaled resistance."""


@dataclass(frozen=True)
class Change:
    """What became of one law of a model file.

    Attributes
    ----------
    section : such as `model.resistance`
    before, after : plays or levels
    error : largest change of the output over a damped oscillation, as a share of its range there
    over : inputs of that oscillation, in words
    kept : why the law is as it was; empty where it is not
    """

    section: str
    before: int
    after: int
    error: float
    over: str
    kept: str = ""


def compress_plays_of(values: Mapping[str, Value], plays: int) -> tuple[dict[str, Value], tuple[Change, ...]]:
    """Return the parameters of a model file with at most `plays` plays in each bank, and what was changed.

    Error bounds of self-sensing are those of the laws as they were, and left out: see `self_sensing.compressed.bounds_after`.
    A bank with one pair of envelopes is compressed by the entropy-optimal partition (3.9) over the operating range of the
    device, or between its saturations where the model names no device. Where each play has its own pair that partition does
    not exist; then as many plays are fitted to the bank's own output there, or fewer where these come nearer.

    Parameters
    ----------
    values : name -> value, as `load_model_parameters` reads them
    plays : to keep in each bank, fewer than the largest has

    Raises
    ------
    ValueError : no bank, not so many plays in any, or a bank that is not monotone; the message names the section.
    """
    banks = {
        name.removesuffix(".rising_slopes"): np.size(values[name])
        for name in sorted(values)
        if name.endswith(".rising_slopes") and not name.startswith(_UNCERTAINTY)
    }
    most = max(banks.values(), default=0)
    if most == 0:
        raise ValueError("plays: found no bank of plays in the model, need one; or give --levels")
    if not 1 <= plays < most:
        raise ValueError(f"plays: found {plays}, need 1 to {most - 1}: the largest bank has {most}")
    found, changes = dict(values), []
    for section, count in banks.items():
        if count <= plays:
            continue
        bank = PlayBank.from_parameters(section, values)
        try:
            own = _between_saturations(bank)
        except ValueError as problem:
            raise ValueError(f"{section}.{problem}") from problem
        (low, high), over = _in_use(section, values, own)
        try:
            smaller, error = _fewer(bank, plays, low, high)
        except ValueError as problem:
            raise ValueError(f"{section}.{problem}") from problem
        found |= smaller.to_parameters(section)
        changes.append(Change(section, count, np.size(smaller.weights), error, over))
    return _without_what_was_measured(found, changes), tuple(changes)


def compress_levels(values: Mapping[str, Value], level: int) -> tuple[dict[str, Value], tuple[Change, ...]]:
    """Return the parameters of a model file with Preisach grids of the level, least loss first (2.4), and what was changed.

    Error bounds of self-sensing are left out, as by `compress_plays_of`. A grid that cannot be compressed stays as it is, and
    its `Change` says why.

    Parameters
    ----------
    values : name -> value, as `load_model_parameters` reads them
    level : of the grids to keep, below that of the finest

    Raises
    ------
    ValueError : no Preisach grid, not so many levels in any, walls that do not increase; or no grid that can be compressed,
        for densities below zero or a choice of walls too large to enumerate. The message names the section.
    """
    grids = {
        name.removesuffix(".walls"): np.size(values[name]) - 1
        for name in sorted(values)
        if name.endswith(".walls") and not name.startswith(_UNCERTAINTY)
    }
    most = max(grids.values(), default=0)
    if most == 0:
        raise ValueError("levels: found no Preisach grid in the model, need one; or give --plays")
    if not 1 <= level < most:
        raise ValueError(f"levels: found {level}, need 1 to {most - 1}: the finest grid has {most}")
    found, changes = dict(values), []
    for section, before in grids.items():
        if before <= level:
            continue
        # self-sensing keeps the integrals over the cells, a law of a response the density
        kind = "weights" if f"{section}.weights" in values else "density"
        try:
            walls = np.asarray(values[f"{section}.walls"], dtype=np.float64)
            cells = np.asarray(values[f"{section}.{kind}"], dtype=np.float64)
            make = PreisachOperator.from_weights if kind == "weights" else PreisachOperator
            operator = make(walls, cells)
        except ValueError as problem:
            raise ValueError(f"{section}.{problem}") from problem
        kept = _too_many(before, level)
        try:
            if not kept:
                coarse = compress_grid(operator, level, "sum").operator
        except ValueError as problem:
            kept = str(problem)
        if kept:
            changes.append(Change(section, before, before, 0.0, "", kept))
            continue
        (low, high), over = _in_use(section, values, (float(walls[0]), float(walls[-1])))
        probe = damped_oscillation(np.unique([low, *walls[(walls > low) & (walls < high)], high]))
        output = operator(probe)
        error = float(np.max(np.abs(coarse(probe) - output)) / max(float(np.ptp(output)), 1e-300))
        masses = pack(coarse.weights)
        found[f"{section}.walls"] = coarse.walls.tolist()
        found[f"{section}.{kind}"] = (
            masses if kind == "weights" else masses / pack(cell_areas(coarse.walls))
        ).tolist()
        changes.append(Change(section, before, level, error, over))
    if all(change.kept for change in changes):
        raise ValueError("; ".join(f"{change.section}: {change.kept}" for change in changes))
    return _without_what_was_measured(found, changes), tuple(changes)


def _too_many(before: int, level: int) -> str:
    """Say which levels a grid can be brought to, where there are too many choices of this one's walls."""
    ways = {one: comb(before - 1, one - 1) for one in range(1, before)}
    if ways[level] <= MOST_CHOICES:
        return ""
    refused = [one for one, count in ways.items() if count > MOST_CHOICES]
    return (
        f"found {ways[level]:.1e} choices of {level} from {before} levels, need at most {MOST_CHOICES:.0e}: "
        f"1 to {refused[0] - 1} or {refused[-1] + 1} to {before - 1} levels"
    )


def _between_saturations(bank: PlayBank) -> tuple[float, float]:
    """Return the inputs beyond which no play of a bank moves any more."""
    slopes = np.concatenate([bank.rising_slopes, bank.falling_slopes])
    offsets = np.concatenate([bank.rising_offsets, bank.falling_offsets])
    return float(np.min((-SATURATED - offsets) / slopes)), float(np.max((SATURATED - offsets) / slopes))


def _in_use(
    section: str, values: Mapping[str, Value], own: tuple[float, float]
) -> tuple[tuple[float, float], str]:
    """Return the part of a law's own inputs, those between its saturations, that it sees in use, and what these are in words."""
    if section in _OVER_RESISTANCE:
        (low, high), words = (COLD, HOT), "the resistances it was fitted to"
    elif values.get("model.device"):
        model = DeviceModel.from_parameters(values)
        device, (low, high) = model.description, own
        ends = [
            float(model.simulate([drive], settled=True, noise=False)[FILM_TEMPERATURE][-1])
            for drive in device.operating_range
        ]
        if np.all(np.isfinite(ends)):
            low, high = sorted(ends)
        first, last = sorted(device.operating_range)
        unit = "" if device.drive_unit == "1" else f" {device.drive_unit}"
        words = f"the device's operating range, {device.drive_channel} {first:g} to {last:g}{unit}"
    else:
        (low, high), words = own, f"inputs from {own[0]:.4g} to {own[1]:.4g}, between its saturations"
    inside = max(low, own[0]), min(high, own[1])
    # what lies beyond a saturation tells nothing, and would take levels from what lies between
    return (inside if inside[0] < inside[1] else (low, high)), words


def _fewer(bank: PlayBank, plays: int, low: float, high: float) -> tuple[PlayBank, float]:
    """Return a bank with fewer plays, and the largest change over a damped oscillation as a share of the range there."""
    probe = damped_oscillation(np.linspace(low, high, PROBE_LEVEL + 1))
    path = np.interp(np.linspace(0, probe.size - 1, 4 * probe.size), np.arange(probe.size), probe)
    names = ("rising_slopes", "rising_offsets", "falling_slopes", "falling_offsets")
    pairs = [np.asarray(getattr(bank, name)) for name in names]
    shared = all(np.ptp(pair) == 0.0 for pair in pairs) and bool(np.all(np.diff(np.asarray(bank.radii)) > 0))
    wanted = bank.run(path)
    polynomial = np.array(bank.polynomial if np.size(bank.polynomial) else [0.0], dtype=np.float64)
    bias = float(polynomial[0])
    smooth = bank.polynomial_part(path) - bias
    if shared:
        plain = GPI(bank.radii, bank.weights, TanhEnvelopes(*(pair[0] for pair in pairs)), bias)
        smaller = compress_plays(plain, plays, input_range=(low, high)).model
    else:
        if np.any(np.asarray(bank.weights) < 0):
            raise ValueError(f"weights: found {np.min(bank.weights):g}, need weights >= 0 to compress")
        # a fit of more plays may end in a minimum that one of fewer does not have
        fits = [
            fit_play_model(
                path, wanted - smooth, plays=count, per_play=count > 1, initial="lower", max_evaluations=60
            ).model
            for count in range(plays, max(plays // 2, 1) - 1, -1)
        ]
        smaller = min(fits, key=lambda model: float(np.sum((model.bank().run(path) - wanted + smooth) ** 2)))
    found = smaller.bank()
    polynomial[0] = smaller.bias
    found = replace(found, polynomial=polynomial)
    change = found.run(path) - wanted
    return found, float(np.max(np.abs(change)) / max(float(np.ptp(wanted)), 1e-300))


def _without_what_was_measured(values: dict[str, Value], changes: list[Change]) -> dict[str, Value]:
    """Standard deviations and error bounds belong to the parameters that were fitted, not to those of a compression."""
    stale = (
        *(f"{_UNCERTAINTY}{c.section.removeprefix('model.')}." for c in changes if not c.kept),
        *(["model.self_sensing.bounds."] if changes else []),
    )
    return {name: value for name, value in values.items() if not (stale and name.startswith(stale))}
