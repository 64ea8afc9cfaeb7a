"""Composite and direct Preisach self-sensing together: a weighted mean of two estimates that err differently.

The composite scheme sees the resistance through two laws of temperature, direct Preisach through one operator of the
resistance itself. Both are fitted on the same recording, but what it leaves open they fill in from different sides:
their errors correlate by a half only, so the mean errs less than either.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from vo2_models.parameters import Value
from vo2_models.self_sensing.bounds import bound_table, table_at
from vo2_models.self_sensing.composite import CompositeSelfSensing
from vo2_models.self_sensing.direct_preisach import DirectPreisachSelfSensing
from vo2_models.self_sensing.scheme import SelfSensing

__all__ = ["CombinedSelfSensing"]

Floats = NDArray[np.float64]

_SHARE = 0.6
"""Of the composite estimate. With equal errors of correlation 1/2 any share from 0.3 to 0.7 is within 3 % of the best; on
random levels the composite scheme errs less, so it has the larger part. Looked at on simulated devices 900000 to 900006."""


@dataclass(frozen=True, eq=False)
class CombinedSelfSensing(SelfSensing):
    """Weighted mean of the composite and of the direct Preisach estimate; temperature and surrogate of the former.

    D = 0.6 D_composite + 0.4 D_preisach, deflections in metres; no source, a mean of the schemes of sections 7.2 and 7.3.1.

    Parameters
    ----------
    composite, preisach : the two schemes
    table : [knots..., bounds...] over log10 R, bounds in metres, from `bounds`

    Raises
    ------
    ValueError : from `from_parameters`, for a model that lacks what one of the two needs.
    """

    kind = "combined"

    composite: CompositeSelfSensing
    preisach: DirectPreisachSelfSensing
    table: Floats = field(default_factory=lambda: np.array([0.0, np.nan]), repr=False)
    _split: int = field(init=False, repr=False)

    def __post_init__(self) -> None:
        object.__setattr__(self, "_split", self.composite.initial_state().size)

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> CombinedSelfSensing:
        parts = (
            CompositeSelfSensing.from_parameters(parameters),
            DirectPreisachSelfSensing.from_parameters(parameters),
        )
        return cls(*parts, bound_table(cls.kind, parameters))

    def initial_state(self) -> Floats:
        return np.concatenate([part.initial_state() for part in (self.composite, self.preisach)])

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        one, temperature, surrogate, _ = self.composite.step(resistance, state[: self._split])
        other = self.preisach.step(resistance, state[self._split :])[0]
        bound = table_at(self.table, np.log10(resistance))
        return _SHARE * one + (1.0 - _SHARE) * other, temperature, surrogate, bound
