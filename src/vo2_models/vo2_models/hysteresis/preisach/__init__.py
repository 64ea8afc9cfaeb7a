"""The Preisach family: operator, inverses, identification, compression.

- `operator`, `grid`: the operator with piecewise-constant density, its cells;
  `kernels` holds the compiled step, for other compiled loops
- `inverse`: the exact inverse of a monotone operator
- `nonmonotonic`, `nonmonotonic_inverse`: chapter 5
- `signed_area`, `damped`, `everett_rows`, `least_squares`, `nnls`, `interior_point`, `smooth_fit`: identification, at any
  level, of densities that are not negative or of either sign
- `sparse_fit`: densities sparse under cosines, wavelets or differences, from few measurements of any input
- `compression`: coarser grids with least loss of information, chapter 2

Compressive sensing of outputs (chapter 4), the comparisons of chapters 2, 4 and 5 and with measured recordings are in
`vo2_studies.preisach`.

Nothing is loaded before it is used:

>>> import numpy as np
>>> from vo2_models.identification.excitation import damped_oscillation
>>> from vo2_models.hysteresis.preisach import PreisachInverse, PreisachOperator, fit_preisach
>>> walls = np.linspace(30.0, 80.0, 11)
>>> device = PreisachOperator(walls, np.full(55, 0.01), bias=2.0)
>>> temperature = damped_oscillation(walls)
>>> found = fit_preisach(temperature, device(temperature), walls)
>>> bool(np.max(np.abs(found.operator.density - device.density)) < 1e-12)
True
>>> drive, state = PreisachInverse(found.operator), found.operator.initial_memory()
>>> degc, reached = drive.update(2.0, state)
>>> round(degc, 3), reached
(65.355, True)
"""

from vo2_models.lazy import lazy_names

_HOME = {
    "Compression": "compression",
    "NonMonotonicInverse": "nonmonotonic_inverse",
    "NonMonotonicPreisach": "nonmonotonic",
    "PreisachFit": "least_squares",
    "PreisachInverse": "inverse",
    "PreisachOperator": "operator",
    "compress": "compression",
    "fit_nonmonotonic": "nonmonotonic",
    "fit_preisach": "least_squares",
    "fit_smooth": "smooth_fit",
    "fit_sparse": "sparse_fit",
    "signed_area_matrix": "signed_area",
}
__all__ = sorted(_HOME)
__getattr__, __dir__ = lazy_names(__name__, _HOME)
