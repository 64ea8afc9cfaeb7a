"""A single play operator, classical (B.1)-(B.2) or generalised (B.5)-(B.6), as an object of its own."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.hysteresis.envelopes import Envelopes, LinearEnvelopes
from vo2_models.hysteresis.layout import Numbers
from vo2_models.hysteresis.memoryless import Memoryless, Zero
from vo2_models.hysteresis.prandtl_ishlinskii import Disorder, PlayModel

__all__ = ["Play"]


@dataclass(frozen=True, eq=False)
class Play(PlayModel):
    """One play of the given radius; rising w = max(gamma_R(v) - r, w), falling w = min(gamma_L(v) + r, w).

    The identity as envelopes (the default) makes it the classical play. State: [present input, w].

    Parameters
    ----------
    radius : r >= 0 in the unit of the envelopes
    envelopes : gamma_R and gamma_L
    input_range, on_disorder : as for `GPI`

    Examples
    --------
    >>> play = Play(0.5)
    >>> output, state = play.simulate([0.0, 2.0, 1.5, 0.0], play.initial_state(v=0.0, memory=[0.0]))
    >>> output.tolist()
    [0.0, 1.5, 1.5, 0.5]
    """

    radius: float
    envelopes: Envelopes = field(default_factory=LinearEnvelopes)
    input_range: tuple[float, float] | None = None
    on_disorder: Disorder = "refuse"
    bias: float = field(default=0.0, init=False)
    memoryless: Memoryless = field(default_factory=Zero, init=False)
    radii: Numbers = field(init=False, repr=False)
    weights: Numbers = field(init=False, repr=False)
    _packed: NDArray[np.float64] = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "radii", [self.radius])
        object.__setattr__(self, "weights", [1.0])
        self._check()
