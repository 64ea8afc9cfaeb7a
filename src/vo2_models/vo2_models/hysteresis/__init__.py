"""Hysteresis operators of the play (Prandtl-Ishlinskii) family, their inverses, identification and compression.

Models        `Play`, `CPI`, `GPI`, `EGPI`; envelopes `TanhEnvelopes`, `LinearEnvelopes`, `TabulatedEnvelopes`; memoryless
              parts `Zero`, `Linear`, `Polynomial`, `Sine`, `Cosine`, `Tanh`, `MemorylessSum`
Inverses      `RobustInverse` (any model, every reachable output), `AnalyticInverse`, `inverse_cpi`, `FixedPointInverse`
              with `convergence_condition`
From data     `fit_play_model`; `identify_play_weights` (compressive sensing)
Smaller       `compress`, `partition` (entropy-optimal)
Compiled use  `kernels.egpi_step(v, model.packed, state)` and `inverse_kernels.invert_step(u, inverse.packed, state)` on
              plain arrays, for other compiled loops

A model is frozen; its memory is a float64 array that the caller owns, copies and saves: present input, then
the outputs of the plays; one row per device where there are many. Names are loaded on first use, so that importing
the package does not load the compiler.

>>> from vo2_models.hysteresis import GPI, TanhEnvelopes
>>> model = GPI(radii=[0.0, 0.5], weights=[1.0, 2.0], envelopes=TanhEnvelopes(1.0, -0.5, 1.0, 0.5))
>>> output, state = model.simulate([-3.0, 3.0, -3.0])
>>> [round(float(y), 3) for y in output]
[-1.998, 1.96, -1.96]
"""

from importlib import import_module
from typing import Any

_HOME = {
    "LinearEnvelopes": "envelopes",
    "TabulatedEnvelopes": "envelopes",
    "TanhEnvelopes": "envelopes",
    "Cosine": "memoryless",
    "Linear": "memoryless",
    "MemorylessSum": "memoryless",
    "Polynomial": "memoryless",
    "Sine": "memoryless",
    "Tanh": "memoryless",
    "Zero": "memoryless",
    "Play": "play",
    "CPI": "prandtl_ishlinskii",
    "EGPI": "prandtl_ishlinskii",
    "GPI": "prandtl_ishlinskii",
    "OrderWarning": "prandtl_ishlinskii",
    "AnalyticInverse": "inverse_analytic",
    "inverse_cpi": "inverse_analytic",
    "inverse_cpi_state": "inverse_analytic",
    "FixedPointInverse": "inverse_fixed_point",
    "convergence_condition": "inverse_fixed_point",
    "RobustInverse": "inverse_robust",
    "compress": "compression_gpi",
    "merge": "compression_gpi",
    "partition": "compression_gpi",
    "identify_play_weights": "compressive_sensing_gpi",
    "PlayFit": "fitting_gpi",
    "fit_play_model": "fitting_gpi",
}
__all__ = sorted(_HOME)


def __getattr__(name: str) -> Any:
    """Load a public name on first use (PEP 562)."""
    if name in _HOME:
        return getattr(import_module(f"{__name__}.{_HOME[name]}"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    return list(__all__)
