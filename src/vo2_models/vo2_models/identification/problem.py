"""One least-squares problem: chosen parameters of a device's simulation and effects against recordings.

Every parameter is a name: `thermal.time_constant`, `effects.latent_heat.latent`,
`effects.sensor_lag.tip_deflection.time_constant`, or `resistance` and `deflection` for all shapes and weights of
a bank. Parameters that are positive by nature are fitted as logarithms. Residuals are whitened by the
channel's noise. Columns of the Jacobian are simulations side by side on the cores.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from vo2_models.device.coefficients import CHANNELS
from vo2_models.device.model import SCALARS, DeviceModel
from vo2_models.device.simulation import Simulation
from vo2_models.device.state import ChainState
from vo2_models.effects import effect
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.identification.bank_fit import BankShape
from vo2_models.identification.grid import GriddedRecording
from vo2_models.identification.levenberg_marquardt import LeastSquares, levenberg_marquardt
from vo2_models.numerics.parallel import parallel_map
from vo2_models.recording import HEATER_CURRENT, RESISTANCE

__all__ = ["Coordinate", "Problem"]

Floats = NDArray[np.float64]
_BANKS = ("resistance", "deflection")
_BANK_SCALE = (0.05, 0.2, 0.05, 0.05)


@dataclass(frozen=True)
class Coordinate:
    """One fitted number.

    Attributes
    ----------
    name : parameter, for a bank with its place, as `resistance[17]`
    logarithmic : whether the number is the logarithm of the parameter
    lower, upper : bounds of the number
    scale : size of a small but visible change of the number
    """

    name: str
    logarithmic: bool
    lower: float
    upper: float
    scale: float


@dataclass(frozen=True)
class Problem:
    """Residuals of a model with some parameters free.

    Attributes
    ----------
    model : where the fit starts; its banks must be ones that a fit wrote
    grids : recordings
    free : names of the free parameters
    levels : channel -> noise standard deviation (resistance in log10 ohm); absent channels are left out. None takes
        the model's sensors
    colours : channel -> AR(1) coefficient of the noise, absent for white
    settled : whether the recordings start settled at their first current
    """

    model: DeviceModel
    grids: Sequence[GriddedRecording]
    free: Sequence[str]
    levels: Mapping[str, float] | None = None
    colours: Mapping[str, float] = field(default_factory=dict)
    settled: bool = False

    def __post_init__(self) -> None:
        levels = self.levels
        if levels is None:
            levels = {
                name: sensor.noise / (np.log(10.0) if name == RESISTANCE else 1.0)
                for name, sensor in self.model.sensors.items()
                if sensor.noise > 0.0
            }
        object.__setattr__(self, "levels", {name: v for name, v in levels.items() if name != HEATER_CURRENT})
        shapes = {
            name: BankShape.of_bank(getattr(self.model, name))
            for name in _BANKS
            if np.size(getattr(self.model, name).weights)
        }
        object.__setattr__(self, "_shapes", shapes)
        coordinates, start = [], []
        for name in self.free:
            more, values = self._expand(name)
            coordinates += more
            start += values
        object.__setattr__(self, "coordinates", tuple(coordinates))
        object.__setattr__(self, "start", np.array(start))
        base = replace(self.model, effects={})
        object.__setattr__(self, "_base", base.simulation)

    # set in __post_init__
    coordinates: tuple[Coordinate, ...] = field(init=False)
    start: Floats = field(init=False, repr=False)
    _shapes: dict[str, BankShape] = field(init=False, repr=False)
    _base: Simulation = field(init=False, repr=False)

    def _expand(self, name: str) -> tuple[list[Coordinate], list[float]]:
        if name in SCALARS:
            value = self.model.scalars[name]
            _, _, low, high = SCALARS[name]
            if low > 0.0:
                return [Coordinate(name, True, np.log(low), np.log(high), 0.01)], [float(np.log(value))]
            # a gain of zero is the other device's law, an ambient or delay of zero is not: any visible change serves
            scale = 0.01 * abs(value) if name.endswith("gain") and value else 0.1
            if name == "driver.dead_time":
                scale = 0.1 * self.grids[0].dt
            return [Coordinate(name, False, low, high, scale)], [value]
        if name in self._shapes:
            vector = self._shapes[name].vector
            plays = self._shapes[name].centre.size
            weight = float(np.exp(self._shapes[name].log_weight).sum())
            scales = np.concatenate([np.full(plays, s) for s in _BANK_SCALE])
            scales = np.concatenate([scales, np.full(vector.size - 4 * plays, 0.01 * weight)])
            return (
                [Coordinate(f"{name}[{k}]", False, -np.inf, np.inf, float(s)) for k, s in enumerate(scales)],
                vector.tolist(),
            )
        if name.startswith("effects."):
            key, parameter = _effect_place(name)
            record = effect(key.split(":")[0])
            known = {p.name: p for p in record.parameters}
            if parameter not in known:
                raise ValueError(f"{name}: found parameter {parameter!r}, need one of {', '.join(known)}")
            low, high = float(known[parameter].lower or 0.0), float(known[parameter].upper or np.inf)
            present = self.model.effects.get(key, {}).get(parameter, known[parameter].default)
            value = float(present)  # type: ignore[arg-type]
            if low > 0.0:
                return [Coordinate(name, True, np.log(low), np.log(high), 0.02)], [float(np.log(value))]
            ranges = record.magnitudes(self.model.device, key.partition(":")[2])
            scale = 0.1 * ranges[parameter][0] if parameter in ranges else 1e-3 * min(high - low, 1.0)
            return [Coordinate(name, False, low, high, scale)], [value]
        raise ValueError(
            f"free: found {name!r}, need a scalar of the model, resistance, deflection or effects.*"
        )

    def model_at(self, theta: Floats) -> DeviceModel:
        """Return the model with the free parameters at theta."""
        scalars, banks, effects = self._values(theta)
        return replace(self.model, scalars=scalars, effects=effects, **banks)  # type: ignore[arg-type]

    def _values(
        self, theta: Floats
    ) -> tuple[dict[str, float], dict[str, PlayBank], dict[str, dict[str, float | str]]]:
        scalars = dict(self.model.scalars)
        effects = {key: dict(values) for key, values in self.model.effects.items()}
        banks = {}
        at = 0
        for name in self.free:
            if name in self._shapes:
                size = self._shapes[name].vector.size
                plays = self._shapes[name].centre.size
                banks[name] = BankShape.of(np.asarray(theta[at : at + size]), plays).bank()
                at += size
                continue
            coordinate = self.coordinates[at]
            value = float(np.exp(theta[at])) if coordinate.logarithmic else float(theta[at])
            if name in SCALARS:
                scalars[name] = value
            else:
                key, parameter = _effect_place(name)
                entry = effects.setdefault(key, {"signal": key.partition(":")[2]} if ":" in key else {})
                # exp(log(bound)) may lie a rounding outside of what the record allows
                record = next(p for p in effect(key.partition(":")[0]).parameters if p.name == parameter)
                entry[parameter] = float(np.clip(value, record.lower, record.upper))
            at += 1
        return scalars, banks, effects

    def simulation(self, theta: Floats) -> Simulation:
        """Return the compiled chain with the free parameters at theta; it always takes the steps feedback needs."""
        scalars, banks, effects = self._values(theta)
        model = replace(self.model, scalars=scalars, effects={}, **banks)  # type: ignore[arg-type]
        needed = any(name.startswith("effects.") for name in self.free) or bool(effects)
        return replace(model.simulation.with_effects(effects), force_feedback=needed)

    def outputs(self, theta: Floats) -> list[dict[str, Floats]]:
        """Return, for each recording, channel -> (n,) simulated without noise; resistance as y = -log10(R / ohm)."""
        simulation = self.simulation(theta)
        found = []
        for grid in self.grids:
            state: ChainState | None = (
                simulation.settled_state(grid.current[0], grid.dt) if self.settled else None
            )
            out = simulation.run(grid.current, dt=grid.dt, state=state)
            one = {name: out[:, CHANNELS.index(name)] for name in self.levels if name in grid.measured}  # type: ignore[union-attr]
            if RESISTANCE in one:
                one[RESISTANCE] = -np.log10(np.maximum(one[RESISTANCE], 1e-30))
            found.append(one)
        return found

    def residual(self, theta: Floats) -> Floats:
        """Return simulated minus measured, whitened, all recordings and channels one behind the other; 0 where missing."""
        parts = []
        for grid, simulated in zip(self.grids, self.outputs(theta), strict=True):
            for name, values in simulated.items():
                gap = values - grid.measured[name]
                parts.append(_whitened(gap, self.levels[name], self.colours.get(name, 0.0)))  # type: ignore[index]
        return np.concatenate(parts)

    def jacobian(self, theta: Floats) -> Floats:
        """Return the derivative of `residual` (n, p) by differences of a tenth of each coordinate's scale."""
        here = self.residual(theta)

        def column(k: int) -> Floats:
            step = 0.1 * self.coordinates[k].scale
            if theta[k] + step > self.coordinates[k].upper:
                step = -step
            moved = theta.copy()
            moved[k] += step
            return (self.residual(moved) - here) / step

        return np.column_stack(parallel_map(column, range(theta.size)))

    def solve(
        self,
        start: Floats | None = None,
        *,
        prior: Floats | float = 0.0,
        steps: int = 30,
        tolerance: float = 1e-4,
    ) -> LeastSquares:
        """Fit the free parameters from `start` (default: the model's); see `levenberg_marquardt`."""

        def evaluate(theta: Floats) -> tuple[Floats, Callable[[], Floats]]:
            return self.residual(theta), lambda: self.jacobian(theta)

        scale = np.array([c.scale for c in self.coordinates])
        return levenberg_marquardt(
            evaluate,
            self.start if start is None else start,
            lower=np.array([c.lower for c in self.coordinates]),
            upper=np.array([c.upper for c in self.coordinates]),
            largest_step=100.0 * scale,
            prior=prior,
            steps=steps,
            tolerance=tolerance,
        )


def _effect_place(name: str) -> tuple[str, str]:
    """`effects.id.parameter` -> (id, parameter); `effects.id.channel.parameter` -> (id:channel, parameter)."""
    parts = name.split(".")
    if len(parts) == 3:
        return parts[1], parts[2]
    if len(parts) == 4:
        return f"{parts[1]}:{parts[2]}", parts[3]
    raise ValueError(f"{name}: need effects.ID.PARAMETER or effects.ID.CHANNEL.PARAMETER")


def _whitened(gap: Floats, level: float, colour: float) -> Floats:
    """Innovations of unit variance of an AR(1) noise; samples that are missing, or follow a missing one, count 0."""
    out = gap.copy()
    if colour:
        out[1:] = (gap[1:] - colour * gap[:-1]) / np.sqrt(1.0 - colour * colour)
    return np.where(np.isfinite(out), out / level, 0.0)
