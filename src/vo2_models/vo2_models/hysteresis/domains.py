"""An ensemble of interacting domains: relays in a mean field.

Domain k switches up where the field rises to its threshold alpha_k and down where it falls to beta_k < alpha_k. The
field is the input plus what the other domains add,

    h = u + J (s - 1/2),        y = lower + (upper - lower) s,        s = sum of the weights of the domains that are up,

so that J > 0 makes domains switch in avalanches and steepens the loop, J < 0 spreads them, and J = 0 is a Preisach
model with the ensemble as its density. With J the minor loops between the same two inputs differ with their height: it
is a moving Preisach model (Della Torre, IEEE Trans. Audio Electroacoustics 14, 1966, 86; mean field as in the
random-field Ising model of Sethna et al., Phys. Rev. Lett. 70, 1993, 3347).

Domains are taken in the order of their thresholds, so one pass finds the avalanche, and the result does not depend on
how finely the input is sampled.

    packed = [n, J, lower, upper, alpha sorted (n), their domains (n), beta sorted (n), their domains (n), weights (n)]
    memory = [u, h, s, up (n)]
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any, ClassVar

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.hysteresis.law import Law, Saturation, side_of
from vo2_models.numerics.kernel import kernel
from vo2_models.validation import finite_array, nonnegative

__all__ = ["DomainEnsemble", "move_domains"]

Floats = NDArray[np.float64]

HEADER = 4
"""Elements of a packed ensemble before its arrays."""
STATES = 3
"""Elements of a memory before the domains' states."""


@kernel
def _count_below(packed, first, n, value, included):
    """Number of the n ascending levels from `first` on that are below `value`, or not above it where `included`."""
    low, high = 0, n
    while low < high:
        middle = (low + high) // 2
        level = packed[first + middle]
        if level < value or (included and level == value):
            low = middle + 1
        else:
            high = middle
    return low


@kernel
def move_domains(u, packed, memory, make):
    """Compiled step of the law, see `hysteresis.law`."""
    n = int(packed[0])
    coupling = packed[1]
    field = memory[1]
    share = memory[2]
    rising = HEADER
    falling = HEADER + 2 * n
    weights = HEADER + 4 * n
    if u > memory[0]:
        k = _count_below(packed, rising, n, field, True)
        while k < n and packed[rising + k] <= u + coupling * (share - 0.5):
            domain = int(packed[rising + n + k])
            if memory[STATES + domain] == 0.0:
                share += packed[weights + domain]
                if make:
                    memory[STATES + domain] = 1.0
            k += 1
        share = 1.0 if k == n else share  # without what rounding has left
        field = u + coupling * (share - 0.5)
    elif u < memory[0]:
        k = _count_below(packed, falling, n, field, False) - 1
        while k >= 0 and packed[falling + k] >= u + coupling * (share - 0.5):
            domain = int(packed[falling + n + k])
            if memory[STATES + domain] == 1.0:
                share -= packed[weights + domain]
                if make:
                    memory[STATES + domain] = 0.0
            k -= 1
        share = 0.0 if k < 0 else share
        field = u + coupling * (share - 0.5)
    if make:
        memory[0] = u
        memory[1] = field
        memory[2] = share
    return packed[2] + (packed[3] - packed[2]) * share


@kernel
def sweep_domains(u, packed, memory, out):
    """`move_domains` along the inputs u (n,)."""
    for k in range(u.size):
        out[k] = move_domains(u[k], packed, memory, True)


@dataclass(frozen=True, eq=False)
class DomainEnsemble(Law):
    """Domains with thresholds of their own in a mean field, see the module.

    Parameters
    ----------
    alpha, beta : (n,) thresholds up and down [input unit], beta < alpha
    shares : (n,) of each domain in the whole, >= 0; they are scaled to a sum of 1; None for equal shares
    coupling : J [input unit]
    lower, upper : output with all domains down and all up [output unit]
    polynomial : coefficients of 1, u, u^2 ... of the memoryless part [output unit]

    Raises
    ------
    ValueError : shapes that differ, no domain, a threshold down that is not below the one up, negative shares.

    Examples
    --------
    >>> law = DomainEnsemble([1.0, 2.0], [0.0, 0.5])
    >>> law.run([0.5, 1.5, 2.5, 0.4, -1.0]).tolist()
    [0.0, 0.5, 1.0, 0.5, 0.0]
    """

    name = "domains"
    move = staticmethod(move_domains)
    sweep = staticmethod(sweep_domains)
    described: ClassVar = {
        "alpha": ("{u}", "thresholds up of the domains"),
        "beta": ("{u}", "thresholds down of the domains"),
        "shares": ("1", "shares of the domains"),
        "coupling": ("{u}", "mean-field coupling"),
        "lower": ("{y}", "output with all domains down"),
        "upper": ("{y}", "output with all domains up"),
        "polynomial": ("{y}", "coefficients of the powers of the input, lowest first,"),
    }

    alpha: Floats
    beta: Floats
    shares: Floats | None = None
    coupling: float = 0.0
    lower: float = 0.0
    upper: float = 1.0
    polynomial: ArrayLike = ()

    def __post_init__(self) -> None:
        alpha = finite_array(self.alpha, "alpha")
        if alpha.size == 0:
            raise ValueError("alpha: found none, need at least one domain")
        beta = finite_array(self.beta, "beta", size=alpha.size)
        if np.any(beta >= alpha):
            k = int(np.flatnonzero(beta >= alpha)[0])
            raise ValueError(
                f"beta: found {beta[k]:g} for alpha {alpha[k]:g} at index {k}, need beta below alpha"
            )
        given = np.ones(alpha.size) if self.shares is None else self.shares
        shares = nonnegative(finite_array(given, "shares", size=alpha.size), "shares")
        if not shares.sum() > 0:
            raise ValueError("shares: found only zeros, need at least one domain that counts")
        values: dict[str, Any] = {"alpha": alpha, "beta": beta, "shares": shares / shares.sum()}
        values["polynomial"] = finite_array(self.polynomial, "polynomial")
        for name in ("coupling", "lower", "upper"):
            values[name] = float(finite_array(getattr(self, name), name, ndim=0))
        for name, value in values.items():
            object.__setattr__(self, name, value)

    @cached_property
    def packed(self) -> Floats:
        """The parameters as `move` takes them."""
        up, down = (np.argsort(levels, kind="stable") for levels in (self.alpha, self.beta))
        header = np.array([self.alpha.size, self.coupling, self.lower, self.upper])
        return np.concatenate([header, self.alpha[up], up, self.beta[down], down, np.asarray(self.shares)])

    @property
    def memory_size(self) -> int:
        """Length of the memory: input, field, share, and the state of each domain."""
        return STATES + self.alpha.size

    @property
    def span(self) -> tuple[float, float]:
        """Output with all domains down and with all up."""
        return self.lower, self.upper

    def initial_memory(self, saturation: Saturation = "lower") -> Floats:
        """Return the memory with all domains down ("lower") or up ("upper")."""
        up = 0.5 * (1.0 + side_of(saturation))
        far = np.inf if up else -np.inf
        return np.concatenate([[far, far, up], np.full(self.alpha.size, up)])
