"""The calibration in short: what the nominal model left over, so that a diagnosis knows how well the base is known.

A calibration of tens of thousands of samples becomes some thousand mean residuals along the path of the
temperature. They stand in the model file. A diagnosis fits them together with the new recording, so a loop
shape may move exactly as far as the calibration left it undetermined, and no further.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.identification.enrichment import EnrichmentBasis
from vo2_models.parameters import Parameter, Value
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION
from vo2_models.validation import finite_array

__all__ = ["DIGEST_PARAMETERS", "LAGS", "CalibrationDigest", "digest_of", "digest_of_drive"]

Floats = NDArray[np.float64]
_PREFIX = "model.enrichment."
LAGS = ("thermal.time_constant", "driver.dead_time")
"""What makes a loop wider that is recorded at a steady rate: the fitted loops hold for the lags they were fitted with."""


def _step_of(channel: str) -> str:
    return f"{_PREFIX}step_{channel}"


DIGEST_PARAMETERS = (
    Parameter(f"{_PREFIX}temperature", [], "degC", "film temperature at the ends of the blocks", kind="float_array"),
    Parameter(f"{_PREFIX}count", [], "1", "samples of each block", kind="float_array"),
    Parameter(f"{_PREFIX}log_resistance", [], "1", "mean residual of log10 R/ohm in each block", kind="float_array"),
    Parameter(f"{_PREFIX}deflection", [], "m", "mean residual of the deflection in each block", kind="float_array"),
    *(
        Parameter(
            f"{_PREFIX}{channel}_by_{name.partition('.')[2]}", [], f"{unit}/s", f"change of the model by {name}, block means",
            kind="float_array",
        )
        for name in LAGS
        for channel, unit in (("log_resistance", "1"), ("deflection", "m"))
    ),
    Parameter(f"{_PREFIX}noise_log_resistance", [], "1", "noise of log10 R: innovation, then AR terms", kind="float_array"),
    Parameter(f"{_PREFIX}noise_deflection", [], "m", "noise of deflection: innovation, then AR terms", kind="float_array"),
    Parameter(f"{_PREFIX}noise_stage", [], "K", "noise of stage temperature: innovation, then AR terms", kind="float_array"),
    Parameter(f"{_PREFIX}noise_current", [], "A", "noise of a current reading: innovation, then AR terms", kind="float_array"),
    *(
        Parameter(_step_of(channel), [], unit, f"distance of neighbouring values of {channel}", kind="float_array")
        for channel, unit in ((RESISTANCE, "ohm"), (TIP_DEFLECTION, "m"), (STAGE_TEMPERATURE, "K"))
    ),
    Parameter(f"{_PREFIX}current_reading", [], "A", "current reading at none, and per commanded ampere", kind="float_array"),
)  # fmt: skip
"""Records of the section `model.enrichment.*` of a model file; empty arrays mean that it was not identified."""


@dataclass(frozen=True)
class CalibrationDigest:
    """Mean residuals (measured minus nominal) of a calibration, along the temperature's path from a cold rest.

    Attributes
    ----------
    temperature : (n + 1,) film temperature at the ends of the blocks; monotone within each [degC]
    count : (n,) number of samples in each block
    log_resistance : (n,) mean residual of log10 R
    deflection : (n,) mean residual [m]
    noise_log_resistance, noise_deflection, noise_stage, noise_current : innovation deviation, then AR coefficients;
        empty where unknown
    current_reading : what a current reading shows at no current [A], and per commanded ampere; empty where the logged
        current was no reading of its own
    steps : channel -> distance of neighbouring values [unit of the channel], where all values lay on a comb
    by_lag : name of `LAGS` -> (n, 2) change of the model's log10 R [1/s] and deflection [m/s] by it; may lack names
    """

    temperature: Floats
    count: Floats
    log_resistance: Floats
    deflection: Floats
    noise_log_resistance: tuple[float, ...] = ()
    noise_deflection: tuple[float, ...] = ()
    noise_stage: tuple[float, ...] = ()
    noise_current: tuple[float, ...] = ()
    current_reading: tuple[float, ...] = ()
    by_lag: Mapping[str, Floats] = field(default_factory=dict)
    steps: Mapping[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        size = self.count.size
        finite_array(self.temperature, "temperature", size=size + 1)
        for name in ("count", "log_resistance", "deflection"):
            finite_array(getattr(self, name), name, size=size)
        if self.current_reading and (len(self.current_reading) != 2 or self.current_reading[1] == 0.0):
            raise ValueError(
                f"{_PREFIX}current_reading: found {list(self.current_reading)}, need none or an offset and a gain that is not 0"
            )
        for name, values in self.by_lag.items():
            if values.shape != (size, 2):
                raise ValueError(f"{name}: found shape {values.shape}, need ({size}, 2)")

    def features(self, basis: EnrichmentBasis, *, span: float) -> Floats:
        """Mean of `basis.features` over each block, (n, columns), by Simpson's rule along the block."""
        ends = self.temperature
        path = np.empty(2 * ends.size - 1)
        path[::2] = ends
        path[1::2] = 0.5 * (ends[1:] + ends[:-1])
        columns = basis.features(path, span=span)
        return (columns[:-2:2] + 4.0 * columns[1::2] + columns[2::2]) / 6.0

    def to_parameters(self) -> dict[str, Value]:
        """Return the section `model.enrichment.*`, rounded to what the noise leaves meaningful."""

        def rounded(values: ArrayLike, digits: int) -> list[float]:
            return [float(f"{v:.{digits}g}") for v in np.atleast_1d(values)]

        return {
            f"{_PREFIX}temperature": rounded(self.temperature, 7),
            f"{_PREFIX}count": rounded(self.count, 6),
            f"{_PREFIX}log_resistance": rounded(self.log_resistance, 5),
            f"{_PREFIX}deflection": rounded(self.deflection, 5),
            **{
                f"{_PREFIX}{channel}_by_{name.partition('.')[2]}": rounded(values[:, k], 4)
                for name, values in self.by_lag.items()
                for k, channel in enumerate(("log_resistance", "deflection"))
            },
            f"{_PREFIX}noise_log_resistance": rounded(self.noise_log_resistance, 5),
            f"{_PREFIX}noise_deflection": rounded(self.noise_deflection, 5),
            f"{_PREFIX}noise_stage": rounded(self.noise_stage, 5),
            f"{_PREFIX}noise_current": rounded(self.noise_current, 5),
            f"{_PREFIX}current_reading": rounded(self.current_reading, 7),
            **{_step_of(channel): rounded(step, 10) for channel, step in self.steps.items()},
        }

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> CalibrationDigest | None:
        """Read the section; None where a model file has none (or an empty one)."""
        if not parameters.get(f"{_PREFIX}count"):
            return None

        def array(name: str) -> Floats:
            return finite_array(parameters.get(_PREFIX + name, []), _PREFIX + name)

        by_lag = {}
        for name in LAGS:
            columns = [array(f"{c}_by_{name.partition('.')[2]}") for c in ("log_resistance", "deflection")]
            if all(column.size for column in columns):
                by_lag[name] = np.column_stack(columns)
        return cls(
            array("temperature"),
            array("count"),
            array("log_resistance"),
            array("deflection"),
            tuple(array("noise_log_resistance").tolist()),
            tuple(array("noise_deflection").tolist()),
            tuple(array("noise_stage").tolist()),
            tuple(array("noise_current").tolist()),
            tuple(array("current_reading").tolist()),
            by_lag,
            {
                channel: float(array(f"step_{channel}")[0])
                for channel in (RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE)
                if parameters.get(_step_of(channel))
            },
        )


def digest_of(
    temperature: ArrayLike,
    log_resistance: ArrayLike,
    deflection: ArrayLike,
    *,
    inside_degc: tuple[float, float],
    step_k: float = 0.7,
    outside_step_k: float = 4.0,
    most: int = 3000,
) -> CalibrationDigest:
    """Shorten residuals along a temperature path to block means.

    Parameters
    ----------
    temperature : (n,) film temperature of the nominal model [degC], from a cold rest
    log_resistance, deflection : (n,) residuals, measured minus nominal; NaN where a sample is missing
    inside_degc : temperatures between which the loop is open and blocks are short
    step_k, outside_step_k : length of a block inside and outside [K]
    most : largest number of blocks; the steps are widened until it holds

    Returns
    -------
    CalibrationDigest : block means over temperature

    Raises
    ------
    ValueError : shapes differ, or fewer than 100 samples.
    """
    path = finite_array(temperature, "temperature")
    if path.size < 100:
        raise ValueError(f"temperature: found {path.size} samples, need at least 100")
    residuals = np.column_stack([log_resistance, deflection])
    if residuals.shape[0] != path.size:
        raise ValueError(f"residuals: found {residuals.shape[0]} samples, need {path.size}")
    while True:
        edges = _block_edges(path, inside_degc, step_k, outside_step_k)
        if edges.size - 1 <= most:
            break
        step_k, outside_step_k = 1.3 * step_k, 1.3 * outside_step_k
    return _block_means(path, residuals, edges)


def _block_means(path: Floats, residuals: Floats, edges: NDArray[np.intp]) -> CalibrationDigest:
    """Mean residuals (n, 2) of a path (n,) between its samples `edges`."""
    valid = np.isfinite(residuals).all(axis=1)
    sums = np.column_stack([np.where(valid, column, 0.0) for column in residuals.T] + [valid])
    # trapezoids: an end counts half for either block, else the mean would lag half a sample behind the path
    totals = np.add.reduceat(0.5 * (sums[1:] + sums[:-1]), edges[:-1], axis=0)
    count = totals[:, 2]
    mean = totals[:, :2] / np.maximum(count, 1.0)[:, None]
    return CalibrationDigest(path[edges], count, mean[:, 0], mean[:, 1])


def digest_of_drive(
    path: ArrayLike,
    log_resistance: ArrayLike,
    deflection: ArrayLike,
    *,
    starts: Collection[int],
    most: int = 3000,
) -> CalibrationDigest:
    """Shorten residuals along the drive of a device without body to block means, one recording behind the other.

    Parameters
    ----------
    path : (n,) loop coordinate [degC]; each recording is preceded by a sample from which nothing is remembered
    log_resistance, deflection : (n,) residuals, measured minus nominal [log10 ohm, m]; NaN where a sample is missing
    starts : places of the samples that precede a recording
    most : largest number of blocks, but for two at each start; turns that are smaller than a block are passed over

    Returns
    -------
    CalibrationDigest : block means over the path

    Raises
    ------
    ValueError : a path that is not finite.
    """
    values = finite_array(path, "path")
    moves = np.abs(np.diff(values))
    first = np.array(sorted(starts), dtype=np.intp)
    moves[first] = 0.0
    moves[first[first > 0] - 1] = 0.0
    step = max(float(np.sum(moves)) / most, 1e-9)
    while (edges := _edges_of_drive(values, frozenset(first.tolist()), step)).size > most + 2 * first.size:
        step *= 1.3
    residuals = np.column_stack([log_resistance, deflection])
    # the way to and from a start is no part of a recording
    apart = np.concatenate([first, first + 1, first[first > 0] - 1])
    residuals[apart] = np.nan
    return _block_means(values, residuals, edges)


def _edges_of_drive(path: Floats, starts: frozenset[int], step: float) -> NDArray[np.intp]:
    """Samples at which blocks end: every turning point of more than `step`, and every `step` of travel between them."""
    edges, turn, way = [0], 0, 0.0
    for k in range(1, path.size):
        if k in starts or k - 1 in starts:
            edges += [j for j in (k - 1, k) if j > edges[-1]]
            turn, way = k, 0.0
            continue
        move = path[k] - path[turn]
        if move * way >= 0.0:
            turn, back = k, False
        else:
            back = abs(move) >= step
        if back and turn > edges[-1]:
            edges.append(turn)
        if abs(path[k] - path[edges[-1]]) >= step and (back or turn == k):
            edges.append(k)
            turn, way = k, 1.0 if path[k] > path[edges[-2]] else -1.0
    if edges[-1] != path.size - 1:
        edges.append(path.size - 1)
    return np.array(edges)


def _block_edges(
    path: Floats, inside: tuple[float, float], step: float, outside_step: float
) -> NDArray[np.intp]:
    """Samples at which blocks end: every turning point, and every `step` of travel between them."""
    edges = [0]
    start, direction = path[0], 0.0
    for k in range(1, path.size):
        move = path[k] - path[k - 1]
        if move * direction < 0.0:
            if edges[-1] != k - 1:
                edges.append(k - 1)
            start = path[k - 1]
            direction = np.sign(move)
        elif move != 0.0:
            direction = np.sign(move)
        width = step if inside[0] <= path[k] <= inside[1] else outside_step
        if abs(path[k] - start) >= width:
            edges.append(k)
            start = path[k]
    if edges[-1] != path.size - 1:
        edges.append(path.size - 1)
    return np.array(edges)
