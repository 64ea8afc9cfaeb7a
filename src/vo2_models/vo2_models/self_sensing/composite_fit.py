"""Laws of the composite scheme's own: as those of the fitted simulation, with twice the plays.

In a hold inside the transition the scheme's error is hardly noise: without noise it is as large. It is the scatter of
a device made of a few thousand switching domains, and twelve diagonals in the Preisach plane where the device has all
loop widths: a bank of 12 plays follows the major loop and misses the share of switched domains behind a state inside it
by 0.3 % (simulated devices; 0.15 % with 100 000 domains), one of 24 by 0.2 %, and so does any finer model, as a
recording of 30 levels tells no more. The fit stops early: run to the end, it follows the recording's noise, and the
estimate is worse by a tenth to a fifth.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.model import DeviceModel
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape, evaluate, fit_bank, starting_shape
from vo2_models.identification.grid import on_grid
from vo2_models.identification.loops_fit import SECTIONS, film_path
from vo2_models.parameters import Value
from vo2_models.recording import COMMANDED_CURRENT, HEATER_CURRENT, Recording
from vo2_models.self_sensing.records import COMPOSITE

__all__ = ["PLAYS", "composite_parameters"]

Floats = NDArray[np.float64]

PLAYS = 24
"""Of each law."""
_ITERATIONS, _TOLERANCE = 40, 1e-4
_PARAMETERS_PER_PLAY = 4
_WORSE = 1.2


def composite_parameters(
    recording: Recording, parameters: Mapping[str, Value], plays: int = PLAYS
) -> dict[str, Value]:
    """Return the flat `model.self_sensing.composite.*` parameters; empty banks where the model's laws serve as they are.

    They do where the recording has no current or too few samples, where a law of the model was not written by a fit,
    and where a new law follows the recording clearly worse, which no early stop explains.

    Parameters
    ----------
    recording : identification recording with current, `film_resistance` and `tip_deflection`
    parameters : flat `model.*` parameters of the fitted simulation
    plays : of each law
    """
    found = _refit(recording, parameters, plays)
    return {
        name: value
        for section in SECTIONS.values()
        for name, value in found.get(section, PlayBank()).to_parameters(f"{COMPOSITE}.{section}").items()
    }


def _refit(recording: Recording, parameters: Mapping[str, Value], plays: int) -> dict[str, PlayBank]:
    if HEATER_CURRENT not in recording and COMMANDED_CURRENT not in recording:
        return {}
    model = DeviceModel.from_parameters(parameters)
    banks = {section: getattr(model, section) for section in SECTIONS.values()}
    if not all(_fitted(bank) for bank in banks.values()):
        return {}
    grid = on_grid(recording)
    values = {SECTIONS[name]: np.concatenate([[np.nan], grid.measured[name]]) for name in SECTIONS}
    enough = 4 * _PARAMETERS_PER_PLAY * plays
    if any(np.count_nonzero(np.isfinite(v)) < enough for v in values.values()):
        return {}
    shapes = {section: BankShape.of_bank(bank) for section, bank in banks.items()}
    # whether the recording starts from a cold rest or settled is not in the model file: the model's own laws tell
    paths = [film_path(model, [grid], settled) for settled in (False, True)]
    path = min(paths, key=lambda p: sum(_misfit(shapes[s], p, v) / _span(v) for s, v in values.items()))
    better = {}
    for section, measured in values.items():
        start = starting_shape(path, measured, plays=plays)
        shape = fit_bank(path, measured, start, iterations=_ITERATIONS, tolerance=_TOLERANCE).shape
        if not _misfit(shape, path, measured) < _WORSE * _misfit(shapes[section], path, measured):
            return {}
        better[section] = shape.bank()
    return better


def _fitted(bank: PlayBank) -> bool:
    """Whether the law has the form that a fit writes; one given by hand stays as it is."""
    return (
        bank.present
        and np.size(bank.weights) > 0
        and not np.any(bank.radii)
        and np.allclose(bank.rising_slopes, bank.falling_slopes)
        and bool(np.all(np.asarray(bank.weights) > 0.0))
    )


def _misfit(shape: BankShape, path: Floats, measured: Floats) -> float:
    """Root mean square of measured minus law."""
    return float(np.sqrt(np.nanmean((measured - evaluate(shape, path)[0]) ** 2)))


def _span(values: Floats) -> float:
    return max(float(np.nanmax(values) - np.nanmin(values)), 1e-300)
