"""Posterior of a loop's shape: what the calibration says of the correction of the fitted loops, and what it leaves open."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations, pairwise
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cholesky_banded, solve_banded, solve_triangular
from scipy.linalg.lapack import dpstrf, dtrtri

from vo2_models.device import preset
from vo2_models.diagnosis.misfit import NO_MISFIT, Misfit, innovations
from vo2_models.diagnosis.noise import NoiseModel
from vo2_models.diagnosis.nominal import Nominal, basis_of
from vo2_models.identification.digest import CalibrationDigest
from vo2_models.identification.enrichment import LOCAL, Correction, EnrichmentBasis
from vo2_models.identification.steepness import unevenness
from vo2_models.numerics.parallel import parallel_map
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

__all__ = ["LoopShape", "loop_shapes", "open_shapes"]

Floats = NDArray[np.float64]
DOMAINS = (1e3, 4e3, 1.6e4, 1e6)
"""Numbers of domains whose scatter is tried; the calibration chooses."""
FORGIVEN = 0.1
"""Share of a channel's range by which the prior lets the loop's shape be off where no calibration says more."""
STRETCHES = 6
"""Stretches of the calibration that are left out in turn."""
_LEAST_FREE = 1e-12
"""Least eigenvalue of I - H, see `_left_out_each`: far above rounding, far below what a calibration leaves."""


class _Kind(NamedTuple):
    """What the basis does not resolve: misfit of a block by itself, or one that wanders; sizes in units of the noise, and [K].

    `size` multiplies what is expected beforehand of all weights of the basis.
    """

    rough: float = 0.0
    wandering: float = 0.0
    travel: float = 1.0
    size: float = 1.0


KINDS = (
    *(_Kind(rough) for rough in (0.0, 1.0, 3.0)),
    *(_Kind(0.0, size, travel) for size in (1.0, 3.0, 10.0) for travel in (3.0, 10.0)),
)
"""Those that are tried; the calibration chooses."""
KINDS_OF_RIGS = tuple(
    _Kind(rough, size=size) for rough in (0.0, 1.0, 2.0, 4.0) for size in (1.0, 0.3, 0.1, 0.03)
)
"""The same on a device without body, where stretches of the calibration that are left out choose."""


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
    kind : of the misfit, in units of the noise
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
    kind: _Kind = KINDS[0]

    def fold(self, moved: Mapping[str, float] | None = None) -> Correction:
        """The mean correction, as a function of the temperature, for lags that are longer than the model's by `moved` [s]."""
        mean = self.mean + sum(self.by_lag[n] * by for n, by in (moved or {}).items() if n in self.by_lag)
        return self.basis.fold(np.asarray(mean), span=self.span)

    def moved(self, weights: Floats) -> LoopShape:
        """The same with its mean moved by weights (m,)."""
        return replace(self, mean=self.mean + weights)

    @cached_property
    def spread(self) -> float:
        """Sum of the standard deviations of the weights, the roots of the diagonal of L^-T L^-1; in the weights' unit."""
        inverse, _ = dtrtri(self.factor, lower=1)
        return float(np.sum(np.linalg.norm(np.tril(inverse), axis=0)))

    def main_directions(self, gram: Floats, *, most: int, negligible: float = 0.5) -> Floats:
        """Weights (m, k) of the directions of what is left open that recordings tell from zero at all.

        They are L^-T v for the eigenvectors v of A = L^-1 G L^-T. Cholesky's elimination with pivots (LAPACK's dpstrf; Higham,
        Accuracy and Stability of Numerical Algorithms, 10.3) writes the Gram matrix as G = C C' + E, E positive semidefinite
        with a diagonal of `tol` at most. Each eigenvalue of A changes by at most tol (sum of the standard deviations)^2, here
        0.001; those of the small (L^-1 C)' L^-1 C are the same, and few where few samples or directions count.

        Parameters
        ----------
        gram : (m, m) of the whitened features, positive semidefinite, in inverse squares of the weights' unit
        most : number of directions at most, of those with the largest eigenvalues
        negligible : eigenvalue up to which a direction is left out; a unit-normal weight is known to 1 beforehand

        Returns
        -------
        (m, k) weights, largest eigenvalue last; k is 0 where the recordings tell nothing
        """
        lower, pivots, rank, _ = dpstrf(gram, tol=1e-3 / self.spread**2, lower=1)
        half = np.empty((gram.shape[0], rank))
        half[pivots - 1] = np.tril(lower[:, :rank])
        half = solve_triangular(self.factor, half, lower=True, overwrite_b=True, check_finite=False)
        value, vector = np.linalg.eigh(half.T @ half)
        kept = value > negligible
        directions = (half @ vector[:, kept] / np.sqrt(value[kept]))[:, -most:]
        return np.asarray(
            solve_triangular(self.factor, directions, lower=True, trans="T", check_finite=False)
        )

    def rough_at(self, temperature: Floats) -> Floats:
        """Misfit level (n,) at a temperature: `rough` inside the transition, none outside."""
        return np.where(self.inside(temperature), self.rough, 0.0)

    def inside(self, temperature: Floats) -> NDArray[np.bool_]:
        """Whether the film is in transition at a temperature (n,) [degC]."""
        low, high = self.basis.centre_degc
        return np.asarray((temperature > low) & (temperature < high))


def loop_shapes(nominal: Nominal, chosen: Mapping[str, LoopShape] | None = None) -> dict[str, LoopShape]:
    """Return the posterior of the loop shape of resistance and deflection, from the digest of the calibration.

    Number of domains, kind of misfit, and whether the loops have local memory, are those of highest marginal likelihood.
    Without a digest the prior alone stands, which forgives ten per cent of the loop's shape, or what the fit of a device
    without body missed.

    Parameters
    ----------
    nominal : fitted simulation
    chosen : with another noise, whose basis and kind of misfit stay
    """
    return _shapes(nominal, lambda channel: _loop_shape(nominal, channel, (chosen or {}).get(channel)))


def open_shapes(nominal: Nominal) -> dict[str, LoopShape]:
    """Return loop shapes that nothing is known of but the prior, ten per cent of the model's, and the kinds of basis and misfit.

    What a law misses of the calibration is also what an effect does there: a bound of the device's own misfit from above.

    Parameters
    ----------
    nominal : fitted simulation
    """
    known = loop_shapes(nominal)

    def opened(channel: str) -> LoopShape:
        own = known[channel]
        prior = _prior_shape(nominal, channel, own.basis)
        return replace(prior, rough=own.rough, misfit=own.misfit, left_out=own.left_out, kind=own.kind)

    return _shapes(nominal, opened)


def _shapes(nominal: Nominal, of: Callable[[str], LoopShape]) -> dict[str, LoopShape]:
    """What `of` returns of each channel that the model has a loop of."""
    laws = {RESISTANCE: nominal.model.resistance.present, TIP_DEFLECTION: nominal.model.deflection.present}
    present = [channel for channel, known in laws.items() if known]
    return dict(zip(present, parallel_map(of, present), strict=True))


def _prior_shape(nominal: Nominal, channel: str, basis: EnrichmentBasis) -> LoopShape:
    """The prior alone."""
    span = nominal.span[channel]
    tight = max(FORGIVEN * span / _own_misfit(nominal, channel, span), 1.0)
    return LoopShape(basis, span, np.zeros(basis.columns), tight * np.eye(basis.columns), 0.0)


def _loop_shape(nominal: Nominal, channel: str, chosen: LoopShape | None) -> LoopShape:
    """Posterior of one channel, its hyperparameters one after the other by their marginal likelihood."""
    basis, digest = basis_of(nominal.model), nominal.digest
    if digest is None:
        return _prior_shape(nominal, channel, basis)
    wide = replace(basis, local=LOCAL) if chosen is None else chosen.basis
    size = _size_along(nominal, channel, digest.temperature)
    evidence = _Evidence(digest, nominal.noise[channel], channel, wide, nominal.span[channel], size)
    if chosen is not None:
        return evidence.shape(evidence.of(chosen.kind, chosen.basis))
    if not nominal.model.description.has_body:
        # the law was fitted to these residuals: evidence would take them for all that it misses
        best = max(KINDS_OF_RIGS, key=lambda kind: evidence.of_stretches(kind, basis))
        return evidence.shape(evidence.of(best, basis))
    fit = evidence.of(KINDS[0], basis)
    memories = [kinds for count in range(len(LOCAL) + 1) for kinds in combinations(LOCAL, count)]
    # one after the other, and once more with what the others have become
    for kinds, domains, local in (
        (KINDS, (), ()),
        ((), (), memories),
        (KINDS, (), ()),
        ((), DOMAINS, ()),
        ((), (), memories),
        (KINDS, (), ()),
    ):
        here = fit
        tried = [evidence.of(kind, here.basis) for kind in kinds if kind != here.kind]
        tried += [
            evidence.of(here.kind, replace(here.basis, domains=n)) for n in domains if n != here.basis.domains
        ]
        tried += [
            evidence.of(here.kind, replace(here.basis, local=m)) for m in local if m != here.basis.local
        ]
        fit = max([here, *tried], key=lambda one: one.score)
    return evidence.shape(fit)


class _Fit(NamedTuple):
    """A choice of hyperparameters, the logarithm of its marginal likelihood but for a constant, and the posterior's factor."""

    score: float
    kind: _Kind
    basis: EnrichmentBasis
    factor: Floats


class _Whitened(NamedTuple):
    """Features (n, m), residual (n,) and its changes by the lags (n, l), whitened, with their products."""

    features: Floats
    target: Floats
    gram: Floats
    right: Floats
    right_of_lags: Floats
    energy: float
    log_determinant: float


class _Evidence:
    """Conjugate Gaussian regression of the digest's blocks, whose noise is correlated, on the features of a basis.

    With W, y features and residuals whitened by the noise and misfit of covariance S, and P = W'W + I,

        log p(y) = -(y'y - y'W P^-1 W'y + log |S| + log |P|) / 2 + constant.

    Bishop, Pattern Recognition and Machine Learning, 2006, section 3.5.
    """

    def __init__(
        self,
        digest: CalibrationDigest,
        noise: NoiseModel,
        channel: str,
        basis: EnrichmentBasis,
        span: float,
        size: Floats,
    ) -> None:
        place = 0 if channel == RESISTANCE else 1
        target = digest.log_resistance if channel == RESISTANCE else digest.deflection
        # with another lag the model would have left another residual
        lags = [-values[:, place] for values in digest.by_lag.values()]
        self.digest, self.noise, self.basis, self.span = digest, noise, basis, span
        self._every = np.column_stack([digest.features(basis, span=span), target, *lags])
        self._covariance = _block_covariance(noise, digest.count)
        for lag, row in enumerate(self._covariance):
            row[: size.size - lag] *= size[: size.size - lag] * size[lag:]
        self._covariance[0, digest.count <= 0.0] = 1e8 * noise.level**2
        self._middle = 0.5 * (digest.temperature[1:] + digest.temperature[:-1])
        low, high = basis.centre_degc
        self._inside = (self._middle > low) & (self._middle < high)
        self._known: dict[_Kind, _Whitened] = {}
        self._fits: dict[tuple[_Kind, EnrichmentBasis], _Fit] = {}

    def of(self, kind: _Kind, basis: EnrichmentBasis) -> _Fit:
        """Return the evidence of a kind of misfit and a basis."""
        known = self._fits.get((kind, basis))
        if known is not None:
            return known
        white = self._whitened(kind)
        own, scale = self._columns(basis), self._scale(basis)
        precision = white.gram[np.ix_(own, own)]
        precision *= scale
        precision *= scale[:, None]
        precision[np.diag_indices_from(precision)] += kind.size**-2
        factor = np.asarray(np.linalg.cholesky(precision), np.float64)
        half = solve_triangular(factor, scale * white.right[own], lower=True, check_finite=False)
        score = -0.5 * (white.energy - float(half @ half)) - float(np.sum(np.log(np.diag(factor))))
        return self._fits.setdefault((kind, basis), _Fit(score, kind, basis, factor))

    def of_stretches(self, kind: _Kind, basis: EnrichmentBasis) -> float:
        """Return the logarithm of the probability of each stretch of the calibration given the others, summed."""
        white = self._whitened(kind)
        columns = white.features[:, self._columns(basis)] * self._scale(basis) * kind.size
        found = sum(
            -0.5 * (chi_square + log_determinant)
            for _, chi_square, log_determinant in _left_out_each(columns, white.target)
        )
        return found - 0.5 * white.log_determinant

    def shape(self, fit: _Fit) -> LoopShape:
        """Return the posterior of a choice."""
        white, scale, factor = self._whitened(fit.kind), self._scale(fit.basis), fit.factor
        own = self._columns(fit.basis)
        right = np.column_stack([white.right, white.right_of_lags])[own]
        half = solve_triangular(factor, scale[:, None] * right, lower=True, check_finite=False)
        means = solve_triangular(factor, half, lower=True, trans="T", check_finite=False)
        level = self.noise.level
        misfit = Misfit(fit.kind.wandering * level, fit.kind.travel) if fit.kind.wandering else NO_MISFIT
        columns = white.features[:, own] * scale * fit.kind.size
        left = _left_out(columns, white.target, self.digest.count)
        by_lag = dict(zip(self.digest.by_lag, means[:, 1:].T, strict=True))
        return LoopShape(
            fit.basis, self.span, means[:, 0], factor, fit.kind.rough * level, by_lag, misfit, left, fit.kind
        )

    def _columns(self, basis: EnrichmentBasis) -> NDArray[np.intp]:
        """Which of the columns a basis has."""
        groups = self.basis.groups
        return np.concatenate([np.arange(groups[name].start, groups[name].stop) for name in basis.groups])

    def _scale(self, basis: EnrichmentBasis) -> Floats:
        """What a basis multiplies the columns by, of those that it has."""
        scale = np.ones(basis.columns)
        scale[basis.groups["scatter"]] = np.sqrt(self.basis.domains / basis.domains)
        return scale

    def _whitened(self, kind: _Kind) -> _Whitened:
        if kind not in self._known:
            both, log_determinant = self._wandering(kind) if kind.wandering else self._rough(kind)
            features, aim, lags = np.split(both, [self.basis.columns, self.basis.columns + 1], axis=1)
            target = aim[:, 0]
            self._known[kind] = _Whitened(
                features, target, features.T @ features, features.T @ target, features.T @ lags,
                float(target @ target) + log_determinant, log_determinant,
            )  # fmt: skip
        return self._known[kind]

    def _rough(self, kind: _Kind) -> tuple[Floats, float]:
        """Whitened columns, and the logarithm of the determinant, for a misfit of each block by itself."""
        spread = self._covariance.copy()
        spread[0] += np.where(self._inside, (kind.rough * self.noise.level) ** 2, 0.0)
        root = cholesky_banded(spread, lower=True)
        return solve_banded((root.shape[0] - 1, 0), root, self._every), 2.0 * float(np.sum(np.log(root[0])))

    def _wandering(self, kind: _Kind) -> tuple[Floats, float]:
        """The same for a misfit that goes on from block to block; beside it the noise's colour over blocks is nothing."""
        way = np.abs(np.diff(self._middle, prepend=self._middle[:1])) / kind.travel
        size = np.where(self._inside, kind.wandering * self.noise.level, 0.0)
        return innovations(self._every, size, way, self._covariance[0])


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
    worst = 0.0
    for piece, chi_square, _ in _left_out_each(columns, target):
        samples, blocks = float(np.sum(count[piece])), float(np.count_nonzero(count[piece] > 0.0))
        if samples > 0.0:
            worst = max(worst, (chi_square - blocks - 2.0 * np.sqrt(2.0 * blocks)) / samples)
    return worst


def _left_out_each(columns: Floats, target: Floats) -> Iterator[tuple[slice, float, float]]:
    """Each stretch, its chi-square given the others, and the logarithm of the determinant of I + W_k P^-1 W_k'.

    One factor serves all of them. With A = W'W + I and m of all stretches, and H = W_k A^-1 W_k', Woodbury's identity gives
    I + W_k P^-1 W_k' = (I - H)^-1, and what the others leave of the stretch is (I - H)^-1 (y_k - W_k m).
    """
    edges = np.linspace(0, target.size, STRETCHES + 1).astype(int)
    gram = columns.T @ columns
    gram[np.diag_indices_from(gram)] += 1.0
    factor = np.linalg.cholesky(gram)
    half = solve_triangular(factor, columns.T, lower=True, check_finite=False)
    left = target - half.T @ (half @ target)
    for piece in (slice(a, b) for a, b in pairwise(edges)):
        taken, direction = np.linalg.eigh(half[:, piece].T @ half[:, piece])
        # what only this stretch determines leaves 1 - H next to nothing, and rounding may make it less
        free = np.maximum(1.0 - taken, _LEAST_FREE)
        yield piece, float(np.sum((direction.T @ left[piece]) ** 2 / free)), -float(np.sum(np.log(free)))


def _size_along(nominal: Nominal, channel: str, ends: Floats) -> Floats:
    """Size (n,) of the noise of blocks over its level, from the ends (n + 1,) of the blocks: it may be uneven."""
    model = nominal.model
    sensor = model.sensors.get(channel)
    if sensor is None or not (nominal.uneven and sensor.misfit_flat):
        return np.ones(ends.size - 1)
    path = np.empty(2 * ends.size - 1)
    path[::2] = ends
    path[1::2] = 0.5 * (ends[1:] + ends[:-1])
    law = model.resistance if channel == RESISTANCE else model.deflection
    along = law.run(path, law.initial_memory())
    return unevenness(model.description, sensor, path, along)[1::2]


def _own_misfit(nominal: Nominal, channel: str, span: float) -> float:
    """What the fit of a device without body missed of held-out parts of its calibration; all that is forgiven where unknown."""
    sensor = nominal.model.sensors.get(channel)
    known = sensor is not None and sensor.misfit > 0.0 and not preset(nominal.device).has_body
    return sensor.misfit if sensor is not None and known else FORGIVEN * span


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
