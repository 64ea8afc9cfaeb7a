"""Prandtl-Ishlinskii models: classical (CPI), generalised (GPI) and extended (EGPI), appendix B and chapter 6.

Parameters are frozen; the memory is a separate float64 array that the caller owns:
`state[0]` is the present input, `state[1:]` the outputs of the plays; many independent devices have
one such row each. Copy it, save it, hand it back: nothing else remembers anything.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any, ClassVar, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis import kernels
from vo2_models.hysteresis.envelopes import Envelopes, LinearEnvelopes
from vo2_models.hysteresis.law import Inverse, Law, Saturation
from vo2_models.hysteresis.layout import POLYNOMIAL, TANH, Numbers
from vo2_models.hysteresis.memoryless import Memoryless, Zero
from vo2_models.hysteresis.play_bank import PlayBank
from vo2_models.parameters import Value
from vo2_models.validation import finite_array, nonnegative

__all__ = ["CPI", "EGPI", "GPI", "OrderWarning", "PlayModel"]

FloatArray = NDArray[np.float64]
Disorder = Literal["refuse", "warn", "accept"]

ORDER_TOLERANCE = 1e-7
"""How far, relative to the envelopes' spread, they may cross before it counts: above what a fit leaves open, far below use."""
_GRID = 257


class OrderWarning(UserWarning):
    """The envelopes cross within the inputs in use, so the play does not preserve order."""


class PlayModel(Law):
    """What the three models have in common; not for use by itself. The memoryless part is in the compiled step."""

    move = staticmethod(kernels.move_egpi)
    sweep = staticmethod(kernels.sweep_egpi)
    described: ClassVar = PlayBank.described

    radii: Numbers
    weights: Numbers
    envelopes: Envelopes
    memoryless: Memoryless
    bias: float
    input_range: tuple[float, float] | None
    on_disorder: Disorder
    _packed: FloatArray

    def _check(self) -> None:
        radii = nonnegative(finite_array(self.radii, "radii"), "radii")
        weights = finite_array(self.weights, "weights", size=radii.size)
        if radii.size == 0:
            raise ValueError("radii: found none, need at least one play")
        if np.any(np.diff(radii) < 0):
            k = int(np.flatnonzero(np.diff(radii) < 0)[0])
            raise ValueError(
                f"radii: found {radii[k + 1]:g} after {radii[k]:g} at index {k + 1}, need ascending radii"
            )
        if not isinstance(self.envelopes, Envelopes):
            raise ValueError(f"envelopes: found {type(self.envelopes).__name__}, need an envelope pair")
        if self.envelopes.plays not in (None, radii.size):
            raise ValueError(
                f"envelopes: found pairs for {self.envelopes.plays} play(s), need one shared pair or {radii.size}"
            )
        if not isinstance(self.memoryless, Memoryless):
            raise ValueError(f"memoryless: found {type(self.memoryless).__name__}, need a memoryless part")
        if self.on_disorder not in ("refuse", "warn", "accept"):
            raise ValueError(f"on_disorder: found {self.on_disorder!r}, need 'refuse', 'warn' or 'accept'")
        bias = float(finite_array(self.bias, "bias", ndim=0))
        terms = self.memoryless.terms()
        kind, stride, numbers = self.envelopes.packed()
        header = [radii.size, kind, self.envelopes.plays is None, stride, bias, len(terms)]
        packed = np.concatenate([np.array(header, dtype=np.float64), weights, radii, numbers, *terms])
        for array in (radii, weights, packed):
            array.setflags(write=False)
        object.__setattr__(self, "radii", radii)
        object.__setattr__(self, "weights", weights)
        object.__setattr__(self, "bias", bias)
        object.__setattr__(self, "_packed", packed)
        if self.input_range is not None:
            low, high = finite_array(self.input_range, "input_range", size=2)
            if not low < high:
                raise ValueError(f"input_range: found ({low:g}, {high:g}), need lower < upper")
            object.__setattr__(self, "input_range", (float(low), float(high)))
            self.check_order(float(low), float(high))

    @property
    def packed(self) -> FloatArray:
        """The parameters as one read-only vector, laid out as `kernels` describes, for other compiled loops."""
        return self._packed

    @property
    def plays(self) -> int:
        """Number of plays N."""
        return int(self.radii.size)

    @property
    def memory_size(self) -> int:
        """Length of the memory: present input and the outputs of the plays."""
        return 1 + self.plays

    @property
    def span(self) -> tuple[float, float]:
        """Weighted sum of the plays, with the bias, in both saturations; infinite for envelopes without limit."""
        lower, upper = self.initial_state("lower"), self.initial_state("upper")
        return self.bias + float(lower[1:] @ self.weights), self.bias + float(upper[1:] @ self.weights)

    def initial_memory(self, saturation: Saturation = "lower") -> FloatArray:
        """Return the memory (memory_size,) far in saturation."""
        return self.initial_state(saturation)

    def inverse(self, input_range: tuple[float, float] | None = None) -> Inverse:
        """Return the inverse over inputs (low, high); None takes the model's."""
        from vo2_models.hysteresis.inverse_robust import RobustInverse

        return RobustInverse(self, input_range)

    def bank(self) -> PlayBank:
        """Return the model as a bank of plays, the form of model files.

        Raises
        ------
        ValueError : envelopes other than tanh, or a memoryless part other than a polynomial.
        """
        terms = self.memoryless.terms()
        kind, stride, numbers = self.envelopes.packed()
        if kind != TANH or any(int(term[0]) != POLYNOMIAL for term in terms):
            raise ValueError(
                f"model: found {type(self.envelopes).__name__} and {type(self.memoryless).__name__}, need tanh "
                "envelopes and a polynomial for a bank of plays"
            )
        pairs = np.broadcast_to(numbers.reshape(2 * stride, -1), (2 * stride, self.plays))
        polynomial = np.polynomial.Polynomial([self.bias])
        for term in terms:
            polynomial += np.polynomial.Polynomial(term[2:])
        return PlayBank(self.weights, self.radii, pairs[0], pairs[1], pairs[2], pairs[3], polynomial.coef)

    def to_parameters(self, section: str) -> dict[str, Value]:
        """Return the flat parameters of `bank`."""
        return self.bank().to_parameters(section)

    def order_excess(self, low: float, high: float) -> tuple[float, float, int]:
        """Return the largest gamma_R(v) - gamma_L(v) - 2 r on [low, high], its input, and the play.

        Order is preserved where it is not above zero; judged on 257 inputs, over the plays that have a weight.
        """
        worst, place, play = kernels.order_excess(self._packed, float(low), float(high), _GRID)
        return float(worst), float(place), int(play)

    def check_order(self, low: float, high: float) -> None:
        """Refuse, warn of, or accept (as `on_disorder` says) envelopes that cross on [low, high].

        Raises
        ------
        ValueError : the order gamma_R(v) - r <= gamma_L(v) + r is violated and `on_disorder` is "refuse".
        """
        if self.on_disorder == "accept":
            return
        excess, place, play = self.order_excess(low, high)
        spread = np.max(np.abs(self.envelopes.rising(high) - self.envelopes.falling(low)), initial=0.0)
        if excess <= ORDER_TOLERANCE * max(float(spread), 1e-300):
            return
        message = (
            f"envelopes: found gamma_R(v) - r above gamma_L(v) + r by {excess:.3g} at v = {place:.6g} for play {play}, "
            "need gamma_R(v) - r <= gamma_L(v) + r over the inputs in use; adjust the envelopes, "
            'or pass on_disorder="warn" or "accept"'
        )
        if self.on_disorder == "refuse":
            raise ValueError(message)
        warnings.warn(message, OrderWarning, stacklevel=3)

    def initial_state(
        self,
        saturation: Literal["lower", "upper"] = "lower",
        *,
        v: float | None = None,
        memory: ArrayLike | None = None,
        devices: int | None = None,
    ) -> FloatArray:
        """Return a memory to start from.

        Parameters
        ----------
        saturation : "lower": the input was far up and then far down, "upper": the other way round
        v : present input; None stays where it saturated (at -inf or inf, from where any input comes next)
        memory : (N,) outputs of the plays to start from, brought into the band
            [gamma_R(v) - r, gamma_L(v) + r] at the present input `v`, which must then be given
        devices : number m of independent devices, None for one

        Returns
        -------
        (1 + N,), or (m, 1 + N): present input, then the outputs of the plays.
        """
        low, high = self.envelopes.limits
        if saturation not in ("lower", "upper"):
            raise ValueError(f"saturation: found {saturation!r}, need 'lower' or 'upper'")
        state = np.empty(1 + self.plays)
        if memory is not None:
            if v is None:
                raise ValueError("v: found none, need the present input that belongs to the memory given")
            state[0] = float(finite_array(v, "v", ndim=0))
            state[1:] = finite_array(memory, "memory", size=self.plays)
            top = self.envelopes.falling(state[0]) + self.radii
            bottom = self.envelopes.rising(state[0]) - self.radii
            state[1:] = np.maximum(bottom, np.minimum(top, state[1:]))
        elif saturation == "lower":
            state[0] = -np.inf
            state[1:] = low + self.radii
        else:
            state[0] = np.inf
            state[1:] = high - self.radii
        if memory is None and v is not None:
            kernels.egpi_step(float(finite_array(v, "v", ndim=0)), self._packed, state)
        return state if devices is None else np.tile(state, (devices, 1))

    def simulate(self, v: ArrayLike, state: FloatArray | None = None) -> tuple[FloatArray, FloatArray]:
        """Run the model over inputs.

        Parameters
        ----------
        v : (n,) inputs of one device, or (m, n) of m independent devices
        state : (1 + N,) or (m, 1 + N) memory before the first input; None for lower saturation. Not changed.

        Returns
        -------
        output : of the shape of v
        state : the memory after the last input

        Raises
        ------
        ValueError : inputs not finite or of a wrong shape, a memory that does not fit, or crossing envelopes.
        """
        inputs = finite_array(v, "v", ndim=(1, 2))
        rows = np.atleast_2d(inputs)
        if state is None:
            final = self.initial_state(devices=rows.shape[0])
        else:
            final = self._checked_state(state, rows.shape[0] if inputs.ndim == 2 else None)
        if inputs.size:
            self._check_visited(rows, final)
        output = np.empty_like(rows)
        kernels.simulate_many(self._packed, rows, final, output)
        return (output, final) if inputs.ndim == 2 else (output[0], final[0])

    def update(self, v: float, state: FloatArray) -> Any:
        """Move to the input v and return the output; `state` is updated in place.

        Evaluates (B.6) as it stands; the order of the envelopes is checked at construction over `input_range`.

        Parameters
        ----------
        v : the next input; for m devices (m,)
        state : (1 + N,) from `initial_state` or `simulate`; for m devices (m, 1 + N)

        Returns
        -------
        The output as a float; for m devices (m,)
        """
        if state.ndim == 1:
            output = kernels.egpi_step(float(v), self._packed, state)
            if output == output:
                return output
            finite_array(v, "v", ndim=0)
        self._checked_state(state, state.shape[0] if state.ndim == 2 else None)
        column = finite_array(v, "v", size=state.shape[0])[:, None]
        outputs = np.empty_like(column)
        kernels.simulate_many(self._packed, column, state, outputs)
        return outputs[:, 0]

    def output(self, state: FloatArray) -> Any:
        """Output in the given state, a float, or (m,) for m devices; the state stays as it is."""
        rows = self._checked_state(state, state.shape[0] if state.ndim == 2 else None)
        outputs = rows[:, 1:] @ self.weights + self.bias + self.memoryless(rows[:, 0])
        return outputs if state.ndim == 2 else float(outputs[0])

    def play_outputs(self, v: ArrayLike, state: FloatArray | None = None) -> FloatArray:
        """Outputs of the plays (n, N) along the inputs v (n,), from `state` or lower saturation."""
        inputs = finite_array(v, "v")
        memory = self.initial_state() if state is None else self._checked_state(state, None)[0]
        outputs = np.empty((inputs.size, self.plays))
        kernels.play_outputs(self._packed, inputs, memory, outputs)
        return outputs

    def _checked_state(self, state: FloatArray, devices: int | None) -> FloatArray:
        """A writable copy as rows (m, 1 + N)."""
        shape = (1 + self.plays,) if devices is None else (devices, 1 + self.plays)
        copy = np.array(state, dtype=np.float64)
        if copy.shape != shape:
            raise ValueError(f"state: found shape {copy.shape}, need {shape}, as initial_state returns it")
        if np.any(np.isnan(copy)):
            raise ValueError("state: found NaN, need a memory from initial_state or simulate")
        return np.atleast_2d(copy)

    def _check_visited(self, rows: FloatArray, states: FloatArray) -> None:
        low, high = float(rows.min()), float(rows.max())
        before = states[:, 0][np.isfinite(states[:, 0])]
        if before.size:
            low, high = min(low, float(before.min())), max(high, float(before.max()))
        verified = self.input_range
        if verified is None or low < verified[0] or high > verified[1]:
            self.check_order(low, high)


@dataclass(frozen=True, eq=False)
class CPI(PlayModel):
    """Classical Prandtl-Ishlinskii model y = bias + sum_j p_j F_{r_j}[v], (B.4).

    Parameters
    ----------
    radii : (N,) ascending, >= 0 [input unit]; the term p(r_0) v of (B.4) is the play of radius 0
    weights : (N,) [output unit per input unit]
    bias : constant [output unit]

    Examples
    --------
    >>> model = CPI(radii=[0.0, 1.0], weights=[1.0, 1.0])
    >>> output, state = model.simulate([0.0, 3.0, 2.0, 0.0], model.initial_state(v=0.0, memory=[0.0, 0.0]))
    >>> output.tolist()
    [0.0, 5.0, 4.0, 1.0]
    """

    name = "cpi"

    radii: Numbers
    weights: Numbers
    bias: float = 0.0
    input_range: tuple[float, float] | None = None
    envelopes: Envelopes = field(default_factory=LinearEnvelopes, init=False)
    memoryless: Memoryless = field(default_factory=Zero, init=False)
    on_disorder: Disorder = field(default="accept", init=False)
    _packed: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()


@dataclass(frozen=True, eq=False)
class GPI(PlayModel):
    """Generalised Prandtl-Ishlinskii model y = bias + sum_j p_j F^gamma_{r_j}[v], (B.8).

    Parameters
    ----------
    radii : (N,) ascending, >= 0, in the unit of the envelopes (below 1 for tanh: a larger play never moves)
    weights : (N,) [output unit]
    envelopes : gamma_R and gamma_L, shared or one pair per play
    bias : constant [output unit]
    input_range : inputs in use; the order of the envelopes is checked over it at construction
    on_disorder : "refuse" (ValueError), "warn" (`OrderWarning`) or "accept" envelopes that cross where the
        inputs are, so that gamma_R(v) - r > gamma_L(v) + r (errata on B.6)
    """

    name = "gpi"

    radii: Numbers
    weights: Numbers
    envelopes: Envelopes
    bias: float = 0.0
    input_range: tuple[float, float] | None = None
    on_disorder: Disorder = "refuse"
    memoryless: Memoryless = field(default_factory=Zero, init=False)
    _packed: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()


@dataclass(frozen=True, eq=False)
class EGPI(PlayModel):
    """Extended generalised model y = bias + D(v) + sum_j p_j F^gamma_{r_j}[v], (6.1).

    Parameters
    ----------
    radii, weights, envelopes, bias, input_range, on_disorder : as for `GPI`
    memoryless : D

    Examples
    --------
    The first steps of section 6.4.1, Table 6.3 with D(v) = 5 cos v:

    >>> from vo2_models.hysteresis import Cosine
    >>> model = EGPI(radii=[0, 0.2, 0.4, 0.6, 0.8, 2], weights=[6, 2, 1, 2, 4, 4], memoryless=Cosine(5.0))
    >>> state = model.initial_state(v=0.0, memory=[0] * 6)
    >>> model.output(state), round(model.update(1.0, state), 4)
    (5.0, 12.5015)
    """

    name = "egpi"

    radii: Numbers
    weights: Numbers
    envelopes: Envelopes = field(default_factory=LinearEnvelopes)
    memoryless: Memoryless = field(default_factory=Zero)
    bias: float = 0.0
    input_range: tuple[float, float] | None = None
    on_disorder: Disorder = "refuse"
    _packed: FloatArray = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._check()
