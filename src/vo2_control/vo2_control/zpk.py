"""A linear law that was designed elsewhere, by zeros, poles and gain: such as the robust controller (8.10) as it is printed."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray
from vo2_models.parameters import Parameter, Value

from vo2_control.controller import LinearLaw

__all__ = ["ZPK_PARAMETERS", "law_from_zpk", "zpk_from_parameters"]

_PAIR = "parts, as many as real parts or none; one above 0 stands for the pair of both signs."
ZPK_PARAMETERS: tuple[Parameter, ...] = (
    Parameter("zpk.gain", 0.0, "A/um", "Gain of K(s) = gain (s - z1) ... / ((s - p1) ...), from error to current."),
    Parameter("zpk.zeros_rad_s", [], "rad/s", "Real parts of the zeros.", kind="float_array"),
    Parameter("zpk.zeros_imaginary_rad_s", [], "rad/s", f"Zeros: imaginary {_PAIR}", 0.0, kind="float_array"),
    Parameter("zpk.poles_rad_s", [], "rad/s", "Real parts of the poles.", None, 0.0, kind="float_array"),
    Parameter("zpk.poles_imaginary_rad_s", [], "rad/s", f"Poles: imaginary {_PAIR}", 0.0, kind="float_array"),
)  # fmt: skip
_SLOWER = 1e-3
"""Of the slowest root: so slow that every root but those at zero is a constant factor."""


def zpk_from_parameters(
    values: Mapping[str, Value],
) -> tuple[NDArray[np.complex128], NDArray[np.complex128], float]:
    """Return zeros (m,) and poles (n,) [rad/s] and the gain [A/um] of a law, pairs written out.

    Parameters
    ----------
    values : names of `ZPK_PARAMETERS`

    Raises
    ------
    ValueError : the parameter, what was found, what is needed.
    """
    checked = {p.name: p.check(values.get(p.name, p.default)) for p in ZPK_PARAMETERS}
    zeros, poles = (_roots(checked, kind) for kind in ("zeros", "poles"))
    gain = float(checked["zpk.gain"])  # type: ignore[arg-type]
    if gain == 0.0:
        raise ValueError("zpk.gain: found 0 A/um, need another one: such a law commands nothing")
    if zeros.size > poles.size:
        raise ValueError(
            f"zpk.zeros_rad_s: found {zeros.size} zeros, need at most {poles.size}, as many as there are poles"
        )
    return zeros, poles, gain


def _roots(values: Mapping[str, Value], kind: str) -> NDArray[np.complex128]:
    real, imaginary = (
        np.asarray(values[f"zpk.{kind}_{part}"], dtype=np.float64) for part in ("rad_s", "imaginary_rad_s")
    )
    if imaginary.size not in (0, real.size):
        raise ValueError(
            f"zpk.{kind}_imaginary_rad_s: found {imaginary.size} values, need none or {real.size}, one for each real part"
        )
    if imaginary.size == 0:
        imaginary = np.zeros(real.size)
    roots = real + 1j * imaginary
    return np.concatenate([roots, np.conj(roots[imaginary > 0.0])])


def law_from_zpk(values: Mapping[str, Value], sample_period_s: float, *, expected_sign: int = 0) -> LinearLaw:
    """Return the law of K(s) in `values` by Tustin's rule, from metres to ampere.

    Parameters
    ----------
    values : names of `ZPK_PARAMETERS`
    sample_period_s : [s]
    expected_sign : of the slow deflection over current of the device; 0 to accept any

    Raises
    ------
    ValueError : parameters that make no law, or one that drives this device away from its reference.
    """
    # a second to load: only for who has such a law
    import control

    from vo2_control.discretise import discrete_law

    zeros, poles, gain = zpk_from_parameters(values)
    moduli = np.abs(np.concatenate([zeros, poles]))
    slow = _SLOWER * float(np.min(moduli[moduli > 0.0], initial=1.0))
    sign = np.sign(gain * np.real(np.prod(slow - zeros) / np.prod(slow - poles)))
    if expected_sign and sign != expected_sign:
        raise ValueError(
            f"zpk.gain: found {gain:g} A/um, which answers a slow error with a current of the sign {sign:+.0f}, need "
            f"{expected_sign:+d} on this device: it would drive it away from its reference"
        )
    return discrete_law(control.ss(control.zpk(zeros, poles, gain)), sample_period_s)
