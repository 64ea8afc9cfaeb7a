"""What the nuisance model may absorb: the loop shape as far as the calibration left it open, and the heat's parameters."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_factor, cho_solve, cholesky, cholesky_banded, solve_banded, solve_triangular

from vo2_models.device import DeviceModel, preset
from vo2_models.diagnosis.misfit import NO_MISFIT, Misfit, innovations
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.nominal import Nominal, basis_of
from vo2_models.diagnosis.parallel import parallel_map
from vo2_models.identification.bank_fit import BankShape, evaluate
from vo2_models.identification.enrichment import Correction, EnrichmentBasis
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = [
    "ANOTHER_DAY",
    "Constant",
    "Coverage",
    "LoopShape",
    "constants_of",
    "coverage",
    "coverage_of",
    "law_columns",
    "loop_shapes",
    "open_shapes",
    "refitted_constants",
]

Floats = NDArray[np.float64]
DOMAINS = (1e3, 4e3, 1.6e4, 1e6)
"""Numbers of domains whose scatter is tried; the calibration chooses."""
FORGIVEN = 0.1
"""Share of a channel's range by which the prior lets the loop's shape be off where no calibration says more."""
ROUGHNESS = (0.0, 1.0, 3.0)
"""Misfit of a block beyond what the basis resolves, in units of the noise; the calibration chooses."""
MISFITS = ((1.0, 3.0), (1.0, 10.0), (3.0, 3.0), (3.0, 10.0), (10.0, 3.0), (10.0, 10.0))
"""Wandering misfit in place of it: size in units of the noise, and length [K]; the calibration chooses."""
STRETCHES = 6
"""Stretches of the calibration that are left out in turn."""


@dataclass(frozen=True)
class LoopShape:
    """Posterior of the loop-shape correction of one channel: mean + L^-T z, z unit normal.

    Attributes
    ----------
    basis : with the number of domains that the calibration chose
    span : range of the channel
    mean : (m,) weights
    factor : (m, m) lower Cholesky factor of the posterior precision
    rough : misfit that remains at single temperatures, in the channel's unit
    misfit : misfit that goes on from one temperature to the next; none where there is a rough one
    left_out : excess power, in noise powers, of the stretch of the calibration that the others predict worst
    by_lag : time constant or dead time -> (m,) change of the mean by it [1/s]: the calibration fixes loop and lag together
    """

    basis: EnrichmentBasis
    span: float
    mean: Floats
    factor: Floats
    rough: float
    by_lag: Mapping[str, Floats] = field(default_factory=dict)
    misfit: Misfit = NO_MISFIT
    left_out: float = 0.0

    def fold(self, moved: Mapping[str, float] | None = None) -> Correction:
        """The mean correction, as a function of the temperature, for lags that are longer than the model's by `moved` [s]."""
        mean = self.mean + sum(self.by_lag[n] * by for n, by in (moved or {}).items() if n in self.by_lag)
        return self.basis.fold(np.asarray(mean), span=self.span)

    def moved(self, weights: Floats) -> LoopShape:
        """The same with its mean moved by weights (m,)."""
        return replace(self, mean=self.mean + weights)

    def spread(self, directions: Floats) -> Floats:
        """Weights (m, k) that unit-normal directions (m, k) of what the calibration leaves open stand for."""
        return np.asarray(
            solve_triangular(self.factor, directions, lower=True, trans="T", check_finite=False)
        )

    def whitened(self, gram: Floats) -> Floats:
        """Gram matrix (m, m) of the unit-normal columns, from that of the features: L^-1 G L^-T."""
        half = solve_triangular(self.factor, gram, lower=True, check_finite=False)
        return np.asarray(solve_triangular(self.factor, half.T, lower=True, check_finite=False))

    def rough_at(self, temperature: Floats) -> Floats:
        """Misfit level (n,) at a temperature: `rough` inside the transition, none outside."""
        return np.where(self.inside(temperature), self.rough, 0.0)

    def inside(self, temperature: Floats) -> NDArray[np.bool_]:
        """Whether the film is in transition at a temperature (n,) [degC]."""
        low, high = self.basis.centre_degc
        return np.asarray((temperature > low) & (temperature < high))


def loop_shapes(nominal: Nominal) -> dict[str, LoopShape]:
    """Return the posterior of the loop shape of resistance and deflection, from the digest of the calibration.

    The number of domains and the kind of misfit are those of highest marginal likelihood. Without a digest the
    prior alone stands, which forgives ten per cent of the loop's shape, or what the fit of a device without body missed.

    Parameters
    ----------
    nominal : fitted simulation
    """
    laws = {RESISTANCE: nominal.model.resistance.present, TIP_DEFLECTION: nominal.model.deflection.present}
    present = [channel for channel, known in laws.items() if known]
    return dict(
        zip(present, parallel_map(lambda channel: _loop_shape(nominal, channel), present), strict=True)
    )


def _loop_shape(nominal: Nominal, channel: str) -> LoopShape:
    """Posterior of one channel, by conjugate Gaussian regression on the digest, whose blocks have correlated noise."""
    basis, span = basis_of(nominal.device), nominal.span[channel]
    digest = nominal.digest
    if digest is None:
        tight = max(FORGIVEN * span / _own_misfit(nominal, channel, span), 1.0)
        return LoopShape(basis, span, np.zeros(basis.columns), tight * np.eye(basis.columns), 0.0)
    noise = nominal.noise[channel]
    target = digest.log_resistance if channel == RESISTANCE else digest.deflection
    features = digest.features(basis, span=span)
    # with another lag the model would have left another residual
    lags = [-values[:, 0 if channel == RESISTANCE else 1] for values in digest.by_lag.values()]
    covariance = _block_covariance(noise, digest.count)
    covariance[0, digest.count <= 0.0] = 1e8 * noise.level**2
    middle = 0.5 * (digest.temperature[1:] + digest.temperature[:-1])
    inside = (middle > basis.centre_degc[0]) & (middle < basis.centre_degc[1])
    best: tuple[float, LoopShape, Floats, Floats] | None = None
    every = np.column_stack([features, target, *lags])

    def rough_by(size: float) -> tuple[Floats, float]:
        """Whitened columns, and the logarithm of the determinant, for a misfit of each block by itself."""
        spread = covariance.copy()
        spread[0] += np.where(inside, (size * noise.level) ** 2, 0.0)
        root = cholesky_banded(spread, lower=True)
        return solve_banded((root.shape[0] - 1, 0), root, every), 2.0 * float(np.sum(np.log(root[0])))

    def wandering(size: float, travel: float) -> tuple[Floats, float]:
        """The same for a misfit that goes on from block to block; beside it the noise's colour over blocks is nothing."""
        way = np.abs(np.diff(middle, prepend=middle[:1])) / travel
        return innovations(every, np.asarray(size * noise.level * inside), way, covariance[0])

    kinds = [(size * noise.level, NO_MISFIT, partial(rough_by, size)) for size in ROUGHNESS]
    kinds += [(0.0, Misfit(s * noise.level, k), partial(wandering, s, k)) for s, k in MISFITS]
    for rough, misfit, whitened in kinds:
        both, log_determinant = whitened()
        weighted, aim, others = np.split(both, [basis.columns, basis.columns + 1], axis=1)
        aim = aim[:, 0]
        gram, right, right_others = weighted.T @ weighted, weighted.T @ aim, weighted.T @ others
        energy = float(aim @ aim) + log_determinant
        for domains in DOMAINS:
            scale = np.ones(basis.columns)
            scale[basis.groups["scatter"]] = np.sqrt(basis.domains / domains)
            precision = gram * np.outer(scale, scale)
            precision[np.diag_indices_from(precision)] += 1.0
            factor = cholesky(precision, lower=True, check_finite=False)
            half = solve_triangular(factor, scale * right, lower=True, check_finite=False)
            score = -0.5 * (energy - half @ half) - float(np.sum(np.log(np.diag(factor))))
            if best is None or score > best[0]:
                mean = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
                half = solve_triangular(factor, scale[:, None] * right_others, lower=True, check_finite=False)
                means = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
                shape = LoopShape(
                    replace(basis, domains=domains), span, mean, factor, rough,
                    dict(zip(digest.by_lag, means.T, strict=True)), misfit,
                )  # fmt: skip
                best = (score, shape, weighted * scale, aim)
    if best is None:
        raise ValueError(
            "loop shapes: found no candidate of ROUGHNESS, MISFITS and DOMAINS, need at least one"
        )
    _, chosen, columns, aim = best
    return replace(chosen, left_out=_left_out(columns, aim, digest.count))


def _left_out(columns: Floats, target: Floats, count: Floats) -> float:
    """Excess power of a stretch of the calibration, given the others, in noise powers of a sample; of the worst one.

    With W_k, y_k the whitened columns and residuals of stretch k, P = I + sum over the other stretches of W'W and
    m = P^-1 sum over them of W'y,

        chi^2_k = (y_k - W_k m)' (I + W_k P^-1 W_k')^-1 (y_k - W_k m).

    A law that the device obeys leaves it at the number of blocks, n; what is beyond chance, n + 2 sqrt(2 n), is misfit.
    Slow large loops are in one stretch and fast small ones in another, as one recording is unlike the next.

    Parameters
    ----------
    columns : (n, m) whitened features of the blocks
    target : (n,) whitened residuals
    count : (n,) samples of each block
    """
    edges = np.linspace(0, target.size, STRETCHES + 1).astype(int)
    pieces = [slice(a, b) for a, b in pairwise(edges)]
    grams = [columns[piece].T @ columns[piece] for piece in pieces]
    rights = [columns[piece].T @ target[piece] for piece in pieces]
    gram, right = np.sum(grams, axis=0) + np.eye(columns.shape[1]), np.sum(rights, axis=0)
    worst = 0.0
    for piece, own, ours in zip(pieces, grams, rights, strict=True):
        samples, blocks = float(np.sum(count[piece])), float(np.count_nonzero(count[piece] > 0.0))
        if samples <= 0.0:
            continue
        factor = cho_factor(gram - own, lower=True, check_finite=False)
        left = target[piece] - columns[piece] @ cho_solve(factor, right - ours, check_finite=False)
        spread = columns[piece] @ cho_solve(factor, columns[piece].T, check_finite=False)
        spread[np.diag_indices_from(spread)] += 1.0
        chi_square = float(left @ cho_solve(cho_factor(spread), left, check_finite=False))
        worst = max(worst, (chi_square - blocks - 2.0 * np.sqrt(2.0 * blocks)) / samples)
    return worst


def _own_misfit(nominal: Nominal, channel: str, span: float) -> float:
    """What the fit of a device without body missed of held-out parts of its calibration; all that is forgiven where unknown."""
    sensor = nominal.model.sensors.get(channel)
    known = sensor is not None and sensor.misfit > 0.0 and not preset(nominal.device).has_body
    return sensor.misfit if sensor is not None and known else FORGIVEN * span


@dataclass(frozen=True)
class Coverage:
    """Temperatures at which the calibration has been, kelvin by kelvin.

    Attributes
    ----------
    edges : (m + 1,) of the kelvins [degC]
    enough : (m,) whether the calibration has been there for some samples
    """

    edges: Floats
    enough: NDArray[np.bool_]

    def holds(self, temperature: Floats) -> NDArray[np.bool_]:
        """Whether temperatures (n,) [degC] are covered."""
        place = np.searchsorted(self.edges, temperature, side="right") - 1
        return np.concatenate([[False], self.enough, [False]])[place + 1]

    def __str__(self) -> str:
        """The stretches that are covered, in words."""
        turns = np.flatnonzero(np.diff(np.concatenate([[False], self.enough, [False]]).astype(int)))
        ends = self.edges[turns].reshape(-1, 2)
        return ", ".join(f"{low:.0f} to {high:.0f}" for low, high in ends) + " degC"


def coverage(nominal: Nominal, *, samples: float = 8.0) -> Coverage:
    """Return the kelvins in which the calibration has `samples` samples.

    Elsewhere, on the way from a cold rest for instance, the fitted loops are a guess, and a recording that differs there
    says nothing about the device. The rest itself says much: no current, no heat. Everything is covered where the
    model file has no digest.

    Parameters
    ----------
    nominal : fitted simulation with the digest of its calibration
    samples : least number in a kelvin
    """
    digest = nominal.digest
    if digest is None:
        return Coverage(np.array([-np.inf, np.inf]), np.ones(1, dtype=bool))
    low = np.minimum(digest.temperature[1:], digest.temperature[:-1])
    high = np.maximum(digest.temperature[1:], digest.temperature[:-1])
    edges = np.arange(np.floor(low.min()), np.ceil(high.max()) + 1.0)
    high = np.maximum(high, low + 1e-6)  # at rest
    # a block's samples, spread evenly over its temperatures
    shares = np.minimum(high[:, None], edges[1:]) - np.maximum(low[:, None], edges[:-1])
    shares = np.maximum(shares, 0.0) / (high - low)[:, None]
    return Coverage(edges, digest.count @ shares >= samples)


def coverage_of(paths: Sequence[Floats], *, samples: float = 8.0) -> Coverage:
    """Return the kelvins in which recordings have `samples` samples on average.

    Parameters
    ----------
    paths : temperatures (n,) of each recording [degC]
    samples : least number in a kelvin
    """
    every = np.concatenate(paths)
    edges = np.arange(np.floor(every.min()), np.floor(every.max()) + 2.0)
    return Coverage(edges, np.histogram(every, edges)[0] >= samples * len(paths))


def _block_covariance(noise: NoiseModel, count: Floats, *, band: int = 12) -> Floats:
    """Covariance of the means of successive blocks, lower banded (band, n), for noise of one colour.

    With V(m) the variance of the sum of m neighbours, sums over [a, b) and [c, d) have the covariance
    (V(d - a) - V(c - a) - V(d - b) + V(c - b)) / 2.
    """
    # whole samples, so that it is the covariance of a series; tapered, so that its band alone is one too
    ends = np.concatenate([[0], np.cumsum(np.maximum(np.rint(count), 1.0))]).astype(np.intp)
    known = noise.variance_of_sums(int(np.max(ends[band:] - ends[:-band] if ends.size > band else ends)))
    out = np.zeros((band, count.size))
    for lag in range(min(band, count.size)):
        a, b = ends[: count.size - lag], ends[1 : count.size - lag + 1]
        c, d = ends[lag : count.size], ends[lag + 1 :]
        v = [known[np.abs(x)] for x in (d - a, c - a, d - b, c - b)]
        taper = 0.5 * (1.0 - lag / band) / ((b - a) * (d - c))
        out[lag, : count.size - lag] = taper * (v[0] - v[1] - v[2] + v[3])
    return out


@dataclass(frozen=True)
class Constant:
    """One way in which a constant of the device may differ from the model file's.

    Attributes
    ----------
    name : as in the model file (`thermal.ambient`), or `deflection.zero`, `deflection.gain`, `resistance.gain`
    unit : of its value
    value : of the model; 0 for a zero, 1 for a gain
    spread : standard deviation beforehand, in `unit`
    drifts : True where the device has changed since its calibration, and the loops are as they were calibrated; False
        where the calibration did not know better, and the loops go along with the lags
    straight : move, in units of `spread`, over which the simulation is linear in it
    """

    name: str
    unit: str
    value: float
    spread: float
    drifts: bool = False
    straight: float = 1.0


ANOTHER_DAY = {
    "thermal.ambient": ("degC", 1.0),
    "thermal.linear_gain": ("K/A", 0.005),
    "thermal.square_gain": ("K/A^2", 0.005),
    "thermal.time_constant": ("s", 0.05),
    "driver.dead_time": ("s", 0.05),
    "deflection.zero": ("m", 0.01),
    "deflection.gain": ("1", 0.01),
    "resistance.gain": ("1", 0.01),
}
"""Unit, and standard deviation of what differs between two days of an unchanged rig: of the ambient in kelvin, of the
deflection's zero as a share of its range, of the others as a share of the value. A room is held within 1 K, a thermal
grease or a clamp set anew changes a time constant by some per cent, an optical lever is aligned to some tenths of a
micrometre, a meter keeps its gain within a per cent. Assumed: no statistics over days are published."""


def constants_of(nominal: Nominal) -> tuple[Constant, ...]:
    """Return the constants that a refit may move: as uncertain as the calibration left them, and as they differ from day to day.

    Parameters
    ----------
    nominal : fitted simulation
    """
    return (*_calibrated(nominal.model), *_drifting(nominal))


REFITTED = {
    "thermal.ambient": 2.0,
    "thermal.linear_gain": 0.05,
    "thermal.square_gain": 0.05,
    "thermal.time_constant": 0.5,
    "driver.dead_time": 1.0,
}
"""Standard deviation, in kelvin for the ambient and as a share of the value for the others, of what a fit of the nominal
device may have taken up of an effect that was there in its calibration: a slow sensor doubles the time constant of a
quick device, a slow parallel mode of some per cent changes the gain by as much."""


def refitted_constants(nominal: Nominal) -> tuple[Constant, ...]:
    """Return the constants that are fitted anew where the effect may have been there in the calibration.

    Where no temperature is measured, ambient and gain are the scale that temperature is expressed in: with the loops fitted
    anew as well they would only trade with them.

    Parameters
    ----------
    nominal : fitted simulation
    """
    found = []
    scale = () if preset(nominal.device).measures_temperature else ("ambient", "linear_gain", "square_gain")
    for name, spread in REFITTED.items():
        if name.partition(".")[2] in scale:
            continue
        value = nominal.model.scalars[name]
        size = spread if name == "thermal.ambient" else abs(value) * spread
        if size > 0.0:
            found.append(Constant(name, ANOTHER_DAY[name][0], value, size, drifts=True, straight=0.05))
    return tuple(found)


def open_shapes(nominal: Nominal) -> dict[str, LoopShape]:
    """Return loop shapes that nothing is known of but the prior: ten per cent of the model's, and the number of domains.

    Parameters
    ----------
    nominal : fitted simulation
    """
    known = loop_shapes(nominal)
    return {
        channel: replace(shape, basis=known[channel].basis)
        for channel, shape in loop_shapes(replace(nominal, digest=None)).items()
    }


LAW = (0.3, 1.0, 0.3, 0.5, 0.1)
"""Standard deviation of what a fit of the nominal law may be off by where an effect was in its calibration: of the
logarithm of a play's slope, its centre [K], the logarithms of its half width and weight, and a coefficient of the
polynomial as a share of the range. A loop that took up a creep has plays of its own for that."""


def law_columns(nominal: Nominal, channel: str, path: Floats) -> Floats:
    """Return the change (n, l) of a channel by each parameter of its fitted law, each scaled to a unit normal.

    None, l = 0, for a law that no fit wrote.

    Parameters
    ----------
    nominal : fitted simulation
    channel : resistance or deflection
    path : (n,) temperature from a cold rest [degC]
    """
    bank = nominal.model.resistance if channel == RESISTANCE else nominal.model.deflection
    try:
        shape = BankShape.of_bank(bank)
    except ValueError:
        return np.zeros((path.size, 0))
    plays = shape.centre.size
    spread = np.concatenate(
        [
            np.repeat(LAW[:4], plays),
            np.full(shape.polynomial.size, LAW[4] * nominal.span[channel]),
        ]
    )
    # the law is that of -log10 R
    sign = -1.0 if channel == RESISTANCE else 1.0
    return np.asarray(sign * evaluate(shape, path)[1] * spread)


def _calibrated(model: DeviceModel) -> list[Constant]:
    """Thermal constants within the fit's own standard deviation.

    With a floor for what differs between two recordings of an unchanged device, and a default for a model file without
    deviations. Ambient and gain have next to none: without a temperature sensor they are the scale that temperature is
    expressed in, and they are the same for both recordings.
    """
    floors = {
        "thermal.time_constant": (0.003, 0.10),
        "driver.dead_time": (0.003, 0.10),
        "thermal.linear_gain": (1e-4, 1e-4),
        "thermal.square_gain": (1e-4, 1e-4),
    }
    found = []
    for name, (floor, default) in floors.items():
        value = model.scalars[name]
        known = model.uncertainty.get(name)
        # a dead time of nothing is as uncertain as the fit says, too
        spread = max(known[0] if known else abs(value) * default, abs(value) * floor)
        if spread > 0.0:
            found.append(Constant(name, ANOTHER_DAY[name][0], value, spread))
    name = "thermal.ambient"
    known = model.uncertainty.get(name)
    spread = max(known[0] if known else 0.0, 0.01)
    return [*found, Constant(name, ANOTHER_DAY[name][0], model.scalars[name], spread)]


def _drifting(nominal: Nominal) -> list[Constant]:
    """Constants that another day may have moved, sensors included."""
    model, found = nominal.model, []
    for name, (unit, spread) in ANOTHER_DAY.items():
        section, _, what = name.partition(".")
        if section in ("thermal", "driver"):
            value = model.scalars[name]
            if value == 0.0:
                continue
            size = spread if name == "thermal.ambient" else abs(value) * spread
        else:
            if not getattr(model, section).present:
                continue
            value = 0.0 if what == "zero" else 1.0
            size = spread * nominal.span[TIP_DEFLECTION] if what == "zero" else spread
        found.append(Constant(name, unit, value, size, drifts=True, straight=0.1))
    return found
