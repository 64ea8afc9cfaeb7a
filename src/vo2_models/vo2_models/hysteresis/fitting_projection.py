"""Variable projection: residual and Jacobian of a play model with its linear coefficients eliminated.

For given envelopes the output is linear in the weights (not negative), the bias and the memoryless coefficients; they
are solved for in every step, and least squares sees only the nonlinear parameters. The Jacobian is Kaufman's, -P d(Phi c)
with P the projection off the active columns and the derivatives of `fitting_kernels`: no finite differences.

Order preservation is built into the parameters. On the normalised input z in [-1, 1] the envelope arguments are

    x_R = c_R + s_R z,    x_L = c_L + s_L z,    c_L = c_R - kappa + e + sqrt((s_L - s_R)^2 + eps^2),    e >= 0,

so x_R - x_L <= kappa at both ends and hence between them; with kappa = 2 artanh r this is gamma_R - gamma_L <= 2 r
wherever the input goes. A bound on one parameter is all the solver needs to know.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import qr
from scipy.optimize import nnls

from vo2_models.hysteresis import fitting_kernels
from vo2_models.hysteresis.fitting_memoryless import Basis

__all__ = ["Linear", "Parametrisation", "Projection"]

FloatArray = NDArray[np.float64]

SMOOTHING = 1e-3
"""eps: keeps the order constraint differentiable where the two slopes are equal; costs a gap of about 1e-3 in x."""
LARGEST_RADIUS = 0.98
"""Radius beyond which the order constraint is kept as strict as here; artanh diverges at 1."""
STILL = 1e-6
"""Movement (rms, in units of the envelopes) below which a play counts as standing still."""
SLOPES = (0.05, 200.0)
"""Envelope slopes allowed on z in [-1, 1]: from a twentieth of the range to nearly a relay."""


@dataclass(frozen=True)
class Parametrisation:
    """How the solver's vector maps to envelopes.

    The vector holds c_R, log s_R, log s_L, e for each of M pairs, then the memoryless theta.
    """

    radii: FloatArray
    pairs: int
    basis: Basis

    @property
    def size(self) -> int:
        return 4 * self.pairs + len(self.basis.starts[0])

    @property
    def slack(self) -> FloatArray:
        """kappa of each pair (M,)."""
        return 2 * np.arctanh(np.minimum(self.radii[: self.pairs], LARGEST_RADIUS))

    def pack(self, arguments: FloatArray, theta: FloatArray) -> FloatArray:
        """Vector for envelope arguments (4, M) = s_R, c_R, s_L, c_L, moved to the nearest order-preserving ones."""
        s_r, c_r, s_l, c_l = (
            np.maximum(arguments[0], 0.1),
            arguments[1],
            np.maximum(arguments[2], 0.1),
            arguments[3],
        )
        e = np.maximum(c_l - c_r + self.slack - np.hypot(s_l - s_r, SMOOTHING), 1e-3)
        return np.concatenate([c_r, np.log(s_r), np.log(s_l), e, theta])

    def unpack(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Envelope arguments (4, N), theta."""
        m, n = self.pairs, self.radii.size
        c_r, s_r, s_l, e = x[:m], np.exp(x[m : 2 * m]), np.exp(x[2 * m : 3 * m]), x[3 * m : 4 * m]
        c_l = c_r - self.slack + e + np.hypot(s_l - s_r, SMOOTHING)
        arguments = np.empty((4, n))
        arguments[:] = np.stack([s_r, c_r, s_l, c_l])
        return arguments, x[4 * m :]

    def columns(self) -> NDArray[np.int64]:
        """Where derivatives with respect to s_R, c_R, s_L and c_L of each play go (4, N)."""
        m, n = self.pairs, self.radii.size
        columns = np.empty((4, n), dtype=np.int64)
        for parameter in range(4):
            columns[parameter] = parameter * m + (np.arange(n) if m == n else 0)
        return columns

    def chain(self, natural: FloatArray, x: FloatArray) -> FloatArray:
        """Columns d/dx from columns d/d(s_R, c_R, s_L, c_L), (n, 4 M)."""
        m = self.pairs
        d_sr, d_cr, d_sl, d_cl = (natural[:, k * m : (k + 1) * m] for k in range(4))
        s_r, s_l = np.exp(x[m : 2 * m]), np.exp(x[2 * m : 3 * m])
        lean = (s_l - s_r) / np.hypot(s_l - s_r, SMOOTHING)
        return np.concatenate(
            [d_cr + d_cl, s_r * (d_sr - lean * d_cl), s_l * (d_sl + lean * d_cl), d_cl], axis=1
        )

    def bounds(self) -> tuple[FloatArray, FloatArray]:
        m = self.pairs
        low_slope, high_slope = np.log(SLOPES)
        low, high = self.basis.bounds
        lower = [[-np.inf] * m, [low_slope] * 2 * m, [0.0] * m, low]
        upper = [[np.inf] * m, [high_slope] * 2 * m, [np.inf] * m, high]
        return np.concatenate(lower), np.concatenate(upper)


@dataclass(frozen=True)
class Linear:
    """Solution of the linear part for one x: weights (N,), bias, memoryless coefficients, and what led to it."""

    weights: FloatArray
    bias: float
    coefficients: FloatArray
    residual: FloatArray
    orthonormal: FloatArray
    """Basis of the active columns (n, K), for the projection."""


class Projection:
    """Residual and Jacobian as functions of the nonlinear vector alone, for one record in normalised units.

    `path` (m,) drives the plays; the fit is judged on its samples `kept` (m,), the inputs `z` with outputs `y` (n,).
    """

    def __init__(
        self,
        path: FloatArray,
        y: FloatArray,
        lower: bool,
        parameters: Parametrisation,
        kept: NDArray[np.bool_],
    ) -> None:
        self.path, self.record, self.kept = path, y, kept
        self.lower, self.parameters = lower, parameters
        self.z, self.y = path[kept], y[kept]
        self._last: tuple[bytes, Linear] | None = None

    def regressors(self, x: FloatArray) -> FloatArray:
        """Outputs of the plays (n, N)."""
        arguments, _ = self.parameters.unpack(x)
        radii = self.parameters.radii
        outputs = np.empty((self.path.size, radii.size))
        fitting_kernels.regressors(self.path, arguments, radii, self.lower, outputs)
        return outputs[self.kept]

    def linear(self, x: FloatArray) -> Linear:
        """Best weights >= 0, bias and memoryless coefficients for x."""
        key = x.tobytes()
        if self._last is not None and self._last[0] == key:
            return self._last[1]
        plays = self.regressors(x)
        _, theta = self.parameters.unpack(x)
        extra = self.parameters.basis.columns(self.z, theta)
        one = np.ones((self.z.size, 1))
        if self.parameters.basis.nonnegative:
            free, signed = one, np.concatenate([plays, extra], axis=1)
        else:
            free, signed = np.concatenate([one, extra], axis=1), plays
        q_free, r_free = qr(free, mode="economic")
        inside = signed - q_free @ (q_free.T @ signed)
        # a play that stands still in the record cannot be told from the bias: rounding must not give it a weight
        inside[:, np.linalg.norm(inside, axis=0) < STILL * np.sqrt(self.z.size)] = 0.0
        rest = self.y - q_free @ (q_free.T @ self.y)
        q, r = qr(inside, mode="economic")
        amounts = nnls(r, q.T @ rest)[0]
        active = amounts > 0
        residual = rest - inside @ amounts
        q_active = qr(inside[:, active], mode="economic")[0] if np.any(active) else inside[:, :0]
        fixed = np.linalg.lstsq(r_free, q_free.T @ (self.y - signed @ amounts), rcond=None)[0]
        n = plays.shape[1]
        coefficients = amounts[n:] if self.parameters.basis.nonnegative else fixed[1:]
        basis = np.concatenate([q_free, q_active], axis=1)
        found = Linear(amounts[:n], float(fixed[0]), coefficients, residual, basis)
        self._last = (key, found)
        return found

    def residual(self, x: FloatArray) -> FloatArray:
        """y minus the model (n,)."""
        return self.linear(x).residual

    def natural(self, x: FloatArray) -> FloatArray:
        """d(model)/d(s_R, c_R, s_L, c_L of each pair, theta) at fixed linear coefficients."""
        found = self.linear(x)
        arguments, theta = self.parameters.unpack(x)
        radii = self.parameters.radii
        out = np.zeros((self.path.size, self.parameters.size))
        fitting_kernels.derivatives(
            self.path, arguments, radii, self.lower, found.weights, self.parameters.columns(), out
        )
        out = out[self.kept]
        if theta.size:
            out[:, -theta.size :] = self.parameters.basis.derivatives(self.z, theta, found.coefficients)
        return out

    def jacobian(self, x: FloatArray) -> FloatArray:
        """Kaufman's approximation of d(residual)/dx."""
        natural = self.natural(x)
        nonlinear = 4 * self.parameters.pairs
        columns = np.concatenate(
            [self.parameters.chain(natural[:, :nonlinear], x), natural[:, nonlinear:]], axis=1
        )
        basis = self.linear(x).orthonormal
        return basis @ (basis.T @ columns) - columns
