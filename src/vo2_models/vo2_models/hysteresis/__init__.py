"""Hysteresis laws behind one protocol (`law.Law`), their inverses, identification and compression.

Laws          by name in `LAWS`: `PlayBank`, `CPI`, `GPI`, `EGPI`, `PreisachOperator`, `NonMonotonicPreisach`,
              `BoucWen`, `LimitingLoop`, `DomainEnsemble`; of a model file by `law_from_parameters`
Plays         envelopes `TanhEnvelopes`, `LinearEnvelopes`, `TabulatedEnvelopes`; memoryless parts `Zero`, `Linear`,
              `Polynomial`, `Sine`, `Cosine`, `Tanh`, `MemorylessSum`
Inverses      `law.inverse(input_range)`; `RobustInverse` (any play model, every reachable output), `AnalyticInverse`,
              `inverse_cpi`, `FixedPointInverse` with `convergence_condition`, `LawInverse` (any law, by bisection)
From data     `fit_law`, `rank_laws` (any law, judged on held-out excursions); `fit_play_model`; `preisach`;
              `identify_play_weights` (compressive sensing)
Smaller       `compress`, `partition` (entropy-optimal)
Compiled use  `type(law).move(u, law.packed, memory, make)`, one signature for every law

A law is frozen; its memory is a float64 array that the caller owns, copies and saves. Names are loaded on first use, so
that importing the package does not load the compiler.

>>> from vo2_models.hysteresis import GPI, TanhEnvelopes
>>> model = GPI(radii=[0.0, 0.5], weights=[1.0, 2.0], envelopes=TanhEnvelopes(1.0, -0.5, 1.0, 0.5))
>>> output, state = model.simulate([-3.0, 3.0, -3.0])
>>> [round(float(y), 3) for y in output]
[-1.998, 1.96, -1.96]
"""

from vo2_models.lazy import lazy_names

_HOME = {
    "LAWS": "laws",
    "law_from_parameters": "laws",
    "Inversion": "law",
    "Law": "law",
    "LawInverse": "law",
    "BoucWen": "bouc_wen",
    "DomainEnsemble": "domains",
    "LimitingLoop": "limiting_loop",
    "NonMonotonicPreisach": "preisach.nonmonotonic",
    "PlayBank": "play_bank",
    "PreisachOperator": "preisach.operator",
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
    "LawFit": "law_fit",
    "fit_law": "law_fit",
    "rank_laws": "law_fit",
    "PlayFit": "fitting_gpi",
    "fit_play_model": "fitting_gpi",
}
__all__ = sorted(_HOME)
__getattr__, __dir__ = lazy_names(__name__, _HOME)
