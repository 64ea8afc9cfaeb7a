"""What every self-sensing scheme offers, and how one is built from a model file."""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from importlib import import_module
from typing import ClassVar, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from vo2_models.device.description import preset
from vo2_models.parameters import Value
from vo2_models.self_sensing.records import KINDS, PARAMETERS
from vo2_models.validation import finite_array

__all__ = ["KINDS", "PARAMETERS", "Estimate", "SelfSensing", "no_law", "self_sensing"]

Floats = NDArray[np.float64]

_CLASSES = {
    "composite": "composite.CompositeSelfSensing",
    "combined": "combined.CombinedSelfSensing",
    "egpi": "direct_egpi.DirectEGPISelfSensing",
    "preisach": "direct_preisach.DirectPreisachSelfSensing",
    "polynomial": "polynomial.PolynomialSelfSensing",
    "dynamic": "dynamic.DynamicSelfSensing",
}


class Estimate(NamedTuple):
    """One estimate, or arrays of them.

    Attributes
    ----------
    deflection : tip deflection [m]
    temperature : film temperature [degC]; NaN for a scheme that does not infer it
    surrogate : temperature surrogate [A], the current that holds this temperature; NaN likewise
    bound : error bound of the deflection [m]: in 95 % of the passes by this resistance, as far as those of the
        identification recording tell, all errors stay below
    """

    deflection: float | Floats
    temperature: float | Floats
    surrogate: float | Floats
    bound: float | Floats


class SelfSensing:
    """A scheme that turns resistances into deflections, sample by sample, on explicit memory.

    Attributes
    ----------
    doubt : why its estimates cannot be used, in words; empty where nothing speaks against them
    """

    kind: ClassVar[str]
    doubt: str = ""

    @classmethod
    def from_parameters(cls, parameters: Mapping[str, Value]) -> SelfSensing:
        """Build the scheme from flat `model.*` parameters.

        Raises
        ------
        ValueError : the model lacks what the scheme needs; the message says what and how to get it.
        """
        raise NotImplementedError

    def initial_state(self) -> Floats:
        """Return the memory of a device that comes from the cold: lower saturation."""
        raise NotImplementedError

    def step(self, resistance: float, state: Floats) -> tuple[float, float, float, float]:
        """Advance one sample; (deflection, temperature, surrogate, bound), NaN for an input that is no number."""
        raise NotImplementedError

    def update(self, resistance: float, state: Floats) -> Estimate:
        """Return the estimate for one resistance [ohm]; `state` is updated in place.

        Raises
        ------
        ValueError : a resistance that is not finite and above 0.
        """
        if not 0.0 < resistance < np.inf:
            raise ValueError(f"resistance: found {resistance!r} ohm, need a finite value above 0")
        return Estimate(*self.step(float(resistance), state))

    def estimate(self, resistance: ArrayLike, state: Floats | None = None) -> tuple[Estimate, Floats]:
        """Run over resistances (n,) [ohm]; return the estimates as arrays (n,) and the final memory.

        `state` is the memory before the first sample, None for lower saturation; it is not changed. A `doubt` is told as a
        `UserWarning`.
        """
        if self.doubt:
            warnings.warn(self.doubt, UserWarning, stacklevel=2)
        values = finite_array(resistance, "resistance")
        if np.any(values <= 0):
            k = int(np.flatnonzero(values <= 0)[0])
            raise ValueError(f"resistance: found {values[k]:g} ohm at index {k}, need values above 0")
        final = self.initial_state() if state is None else np.array(state, dtype=np.float64)
        rows = np.empty((values.size, 4))
        for k, value in enumerate(values.tolist()):
            rows[k] = self.step(value, final)
        return Estimate(*np.ascontiguousarray(rows.T)), final


def self_sensing(kind: str, parameters: Mapping[str, Value], *, judged: bool = True) -> SelfSensing:
    """Return the scheme `kind` with the flat `model.*` parameters.

    Parameters
    ----------
    judged : whether to find out if its estimates can be used

    Raises
    ------
    ValueError : an unknown kind, or a model that lacks what the scheme needs.
    """
    scheme = _built(kind, parameters)
    if judged:
        from vo2_models.self_sensing.uniqueness import doubt_of

        object.__setattr__(scheme, "doubt", doubt_of(scheme, parameters))
    return scheme


def no_law(section: str, parameters: Mapping[str, Value]) -> ValueError:
    """Return the error of a scheme whose own law a model lacks.

    Parameters
    ----------
    section : of the law
    parameters : flat `model.*` parameters, with the device
    """
    try:
        of_body = preset(str(parameters.get("model.device", ""))).has_body
    except ValueError:
        of_body = True
    if of_body:
        remedy = "load a model file that `fit` or `identifier` wrote from a recording with resistance and deflection"
    else:
        remedy = "`fit` writes one only for a device with a heated body; use scheme composite with a model of `fit --law plays`"
    return ValueError(f"{section}: found no law; {remedy}")


def _built(kind: str, parameters: Mapping[str, Value]) -> SelfSensing:
    if kind not in _CLASSES:
        raise ValueError(f"kind: found {kind!r}, need one of {', '.join(KINDS)}")
    if kind == "composite" and "model.resistance.law" in parameters:
        from vo2_models.self_sensing.law_composite import LawComposite

        if LawComposite.serves(parameters):
            return LawComposite.from_parameters(parameters)
    module, name = _CLASSES[kind].split(".")
    scheme: type[SelfSensing] = getattr(import_module(f"vo2_models.self_sensing.{module}"), name)
    return scheme.from_parameters(parameters)
