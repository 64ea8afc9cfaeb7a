"""Whether the drive of a film heats it: not at all, through a heater of its own, or in the film itself.

Over which coordinate a film's loops lie is chosen by what predicts parts of the calibration that a fit was not given:

- the drive itself, v;
- the heat of a separate heater, g v^2;
- the heat in the film, g v^2 / R where v is the voltage over it, g v^2 R where it is the current through it. R is the
  film's own resistance, with its hysteresis: as R falls the heat grows, and the film may switch by itself.

Behind each stand one lag or two (`rig_dynamics.after`), which are fitted for every coordinate before these are compared:
else a second lag passes for heat. Joule's law with Newtonian cooling, tau dT/dt = T0 + g P - T; that it is the heat which
switches a VO2 film under voltage: Zimmers et al., Phys. Rev. Lett. 110, 056601, 2013.

A fit sees the heat of the measured resistance. It is judged by free runs, in which the model's own resistance makes the
heat: with the measured one any resistance would predict itself. With three recordings or more each is left out in turn,
the largest too: a film that runs away there shows it. The recordings are compared by the logarithm of their errors, so that
none outweighs the others.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize

from vo2_models.device.description import DeviceDescription
from vo2_models.device.model import DeviceModel
from vo2_models.identification.bank_fit import evaluate
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.loop_law import FEWEST_RECORDINGS, folds_of_recordings
from vo2_models.identification.play_dictionary import PlayDictionary, fit_dictionary, fold_of
from vo2_models.identification.rig_dynamics import (
    COLD,
    LAGS,
    RigDynamics,
    after,
    loop_path,
    relaxing,
)
from vo2_models.recording import RESISTANCE

__all__ = ["RigHeat", "choose_heat", "free_run", "heat_path", "heat_scalars"]

Floats = NDArray[np.float64]
UNITS = ("V", "A")
"""Units of a drive that can heat a film."""
_MARGIN = 0.9
"""Share of the held-out error of a simpler coordinate below which a heat is taken: it is another kind of model."""
_TWO_LAGS = 0.95
"""Share of the held-out error with one lag below which there are two."""
_SHARES, _SLOWER = (0.2, 0.5), (4.0, 16.0, 64.0)
"""Shares and ratios of the slower lag that are tried first."""
_STEPS = 40
_PLAYS = {"centres": 12, "widths": 7}
_SAMPLES = 2500
_WORST = 1e3
"""Error, in decades, that stands for a simulation that ran away."""


@dataclass(frozen=True)
class RigHeat:
    """The coordinate that a film's loops lie over.

    Attributes
    ----------
    kind : "drive", "heater" or "film"
    dynamics : both lags
    gain : rise per squared drive [K/V^2 or K/A^2] or per power [K/W]; the largest rise of the calibration is the span of
        the loop coordinate, as no temperature is known
    errors : (m,) root mean square of the free run's error on each part that was left out, in judged units
    between : (m,) whether a part is no extrapolation
    """

    kind: str
    dynamics: RigDynamics
    gain: float = 0.0
    errors: Floats = field(default_factory=lambda: np.empty(0), repr=False)
    between: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=np.bool_), repr=False)

    @property
    def score(self) -> float:
        """Mean of the logarithm of the errors."""
        return float(np.mean(np.log(self.errors)))

    def notes(self, device: DeviceDescription) -> list[str]:
        """Say what was found beside a single lag.

        Parameters
        ----------
        device : whose names and units are told
        """
        lags = f"lag {self.dynamics.lag:.3g} s"
        if share := self.dynamics.slow_share:
            lags += f", and for {100 * share:.0f} % of it {self.dynamics.slow:.3g} s"
        power = {"V": "V^2/R", "A": "I^2 R"}.get(device.drive_unit, "")
        told = {
            "drive": [f"{device.drive_channel} acts with two lags: {lags}"] if share else [],
            "heater": [f"{device.drive_channel} heats by its square, from rest: {lags}"],
            "film": [f"{device.names.get(RESISTANCE)} is its own heater, by {power}, from rest: {lags}"],
        }
        return told[self.kind]


def heat_scalars(heat: RigHeat, device: DeviceDescription) -> dict[str, float]:
    """Return the scalars of a model with this heat.

    Parameters
    ----------
    heat : chosen
    device : completed description
    """
    low = min(device.steady_temperature(v) for v in device.operating_range)
    scalars = {
        "thermal.ambient": low,
        "thermal.linear_gain": 0.0,
        "thermal.square_gain": heat.gain if heat.kind == "heater" else 0.0,
        "thermal.power_gain": heat.gain if heat.kind == "film" else 0.0,
    }
    return (scalars if heat.kind != "drive" else {}) | lag_scalars(heat.dynamics)


def lag_scalars(dynamics: RigDynamics) -> dict[str, float]:
    """Return the scalars of delay and lags that are there.

    Parameters
    ----------
    dynamics : chosen
    """
    scalars = {"driver.dead_time": dynamics.delay}
    if dynamics.held:
        scalars["driver.held"] = 1.0
    if dynamics.lag:
        scalars["thermal.time_constant"] = dynamics.lag
    if dynamics.slow_share:
        scalars |= {"thermal.slow_share": dynamics.slow_share, "thermal.slow_time_constant": dynamics.slow}
    return scalars


def heat_path(
    grids: Sequence[GriddedRecording], device: DeviceDescription, heat: RigHeat
) -> tuple[Floats, float]:
    """Return the loop coordinate as `loop_path` does, and the gain; heat starts from rest, without drive.

    Parameters
    ----------
    grids : recordings in roles; for the heat in the film with its resistance, which is taken one sample before
    device : completed description
    heat : kind and lags

    Returns
    -------
    (n,) loop coordinate [degC], from the resistance that was measured, and the gain
    """
    if heat.kind == "drive":
        return loop_path(grids, device, heat.dynamics), 0.0
    low, high = sorted(device.steady_temperature(v) for v in device.operating_range)
    rises = []
    for grid in grids:
        power = grid.current**2
        if heat.kind == "film":
            y = grid.measured[RESISTANCE]
            seen = np.flatnonzero(np.isfinite(y))
            log_r = -np.interp(np.arange(y.size) - 1, seen, y[seen])
            power = power * 10.0 ** (-log_r if device.drive_unit == "V" else log_r)
        rises.append(after(power, heat.dynamics, grid.dt, 0.0))
    gain = (high - low) / max(float(rise.max()) for rise in rises)
    return np.concatenate([np.r_[COLD, low + gain * rise] for rise in rises]), gain


def free_run(model: DeviceModel, grids: Sequence[GriddedRecording], role: str) -> Floats:
    """Return the judged response (n,) along all recordings, from rest, the model's own resistance making the heat.

    Parameters
    ----------
    model : with its laws
    grids : recordings in roles
    role : of the response
    """
    parts = []
    for grid in grids:
        run = model.simulate(grid.current, dt=grid.dt, noise=False)[role]
        parts.append(np.r_[np.nan, -np.log10(np.maximum(run, 1e-300)) if role == RESISTANCE else run])
    return np.concatenate(parts)


def choose_heat(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    values: Mapping[str, Floats],
    found: RigDynamics,
) -> RigHeat:
    """Return over which coordinate the loops of a device without body lie.

    Only a resistance under a voltage or a current can tell; its own heat or a heater's is taken where it predicts parts
    that were left out clearly better than the drive itself, each with the lags that suit it best.

    Parameters
    ----------
    grids : recordings in roles
    device : completed description
    values : role -> (n,) judged values along `loop_path`
    found : lags over the drive itself
    """
    over_drive = RigHeat("drive", found)
    film = device.has_resistance and all(RESISTANCE in grid.measured for grid in grids)
    if not film or device.drive_unit not in UNITS:
        return over_drive
    parts = _parts(grids, values[RESISTANCE])

    def tried(heat: RigHeat) -> RigHeat:
        return _judged(grids, device, values[RESISTANCE], heat, parts)

    dt, longest = grids[0].dt, max(grid.current.size for grid in grids)
    lags = [0.0, *(k * dt for k in LAGS if k < 0.1 * longest)]
    over_drive, lagged = tried(over_drive), replace(found, relaxation=0.0)
    cold = replace(lagged, delay=0.0, falling=False)
    drive = min(
        (over_drive, _with_lags(tried, "drive", lagged, lags, dt * longest)), key=lambda one: one.score
    )
    if drive.score >= over_drive.score + np.log(_TWO_LAGS):
        drive = over_drive
    best = drive
    for kind in ("heater", "film"):  # the simpler one first
        heated = _with_lags(tried, kind, cold, lags, dt * longest)
        best = heated if heated.score < best.score + np.log(_MARGIN) else best
    return best


def _parts(grids: Sequence[GriddedRecording], values: Floats) -> NDArray[np.int64]:
    """Part that each sample (n,) is left out with: its recording, or with few of them a block of time; -1 without value."""
    good = np.isfinite(values)
    if len(grids) < FEWEST_RECORDINGS:
        return fold_of(good)
    which = np.concatenate([np.full(grid.current.size + 1, k) for k, grid in enumerate(grids)])
    return np.where(good, which, -1)


def _judged(
    grids: Sequence[GriddedRecording],
    device: DeviceDescription,
    values: Floats,
    heat: RigHeat,
    parts: NDArray[np.int64],
) -> RigHeat:
    """The same with gain and errors."""
    path, gain = heat_path(grids, device, heat)
    heat = replace(heat, gain=gain)
    inside = path[path > COLD]
    plays = PlayDictionary.over(float(inside.min()), float(inside.max()), **_PLAYS)
    degree, late = heat.dynamics.degree, relaxing(grids, device, heat.dynamics)
    inner = folds_of_recordings([grid.current for grid in grids], parts) >= 0
    errors, between = [], []
    for part in np.unique(parts[parts >= 0]):
        left_out = parts == part
        between.append(bool(inner[left_out].any()))
        fit = fit_dictionary(
            plays, path, np.where(left_out, np.nan, values), degree=degree, most=_SAMPLES, late=late
        )
        shape = fit.shape(degree=degree)
        if heat.kind == "film":
            model = DeviceModel(device.key, scalars=heat_scalars(heat, device), resistance=shape.bank())
            output = free_run(model, grids, RESISTANCE)
        else:
            output = evaluate(shape, path, late)[0]
        gap = (values - output)[left_out]
        error = float(np.sqrt(np.mean(gap**2)))
        errors.append(min(max(error, 1e-300), _WORST) if np.isfinite(error) else _WORST)
    return replace(heat, errors=np.array(errors), between=np.array(between))


def _with_lags(
    tried: Callable[[RigHeat], RigHeat], kind: str, start: RigDynamics, lags: Sequence[float], longest: float
) -> RigHeat:
    """A coordinate with the lags [s] that predict best: one, or two, none above `longest`, that are better by a margin."""
    one = min((tried(RigHeat(kind, replace(start, lag=lag))) for lag in lags), key=lambda each: each.score)

    def of(vector: Floats) -> RigHeat:
        lag = float(np.exp(vector[0]))
        share, slow = 1.0 / (1.0 + np.exp(-vector[1])), lag * (1.0 + np.exp(vector[2]))
        return RigHeat(kind, replace(start, lag=lag, slow_share=float(share), slow=min(float(slow), longest)))

    def score(vector: Floats) -> float:
        return tried(of(vector)).score

    # the best single lag lies between the two, from where the search may find neither
    first = min(
        (
            np.array([np.log(lag), np.log(share / (1.0 - share)), np.log(ratio)])
            for lag in {*lags[1::2], one.dynamics.lag or lags[1]}
            for share in _SHARES
            for ratio in _SLOWER
        ),
        key=score,
    )
    found = minimize(
        score,
        first,
        method="Nelder-Mead",
        options={
            "maxfev": _STEPS,
            "initial_simplex": np.vstack([first, first + np.diag([-0.5, 0.7, 0.7])]),
            "xatol": 0.02,
            "fatol": 0.005,
        },
    )
    two = tried(of(found.x))
    return two if two.score < one.score + np.log(_TWO_LAGS) else one
