"""What self-sensing adds to a fitted model: the direct schemes, the mode, and the error bounds of every scheme."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vo2_models.parameters import Value
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION, Recording
from vo2_models.self_sensing.bounds import fit_bound
from vo2_models.self_sensing.composite_fit import PLAYS, composite_parameters
from vo2_models.self_sensing.direct_egpi import DirectEGPISelfSensing
from vo2_models.self_sensing.direct_preisach import DirectPreisachSelfSensing
from vo2_models.self_sensing.dynamic import mode_parameters
from vo2_models.self_sensing.polynomial import PolynomialSelfSensing
from vo2_models.self_sensing.records import BOUND_KNOTS, KINDS, SECTION
from vo2_models.self_sensing.scheme import self_sensing

__all__ = ["characterise"]

_BINS = 24


def characterise(
    recording: Recording,
    parameters: Mapping[str, Value],
    *,
    degree: int = 8,
    plays: int = 6,
    level: int = 40,
    composite_plays: int = PLAYS,
) -> dict[str, Value]:
    """Return `model.self_sensing.*` parameters from the recording a model was fitted on.

    Parameters
    ----------
    recording : identification recording with `film_resistance` [ohm] and `tip_deflection` [m]
    parameters : flat `model.*` parameters of the fitted laws
    degree : of the polynomial (section 7.3.1 uses 8, section 8.2 uses 9)
    plays : of the direct EGPI model (section 7.3.1 uses 6)
    level : of the direct Preisach model (section 7.3.1 uses 10)
    composite_plays : of each law of the composite scheme (section 7.3.1 uses 6)

    Raises
    ------
    ValueError : a recording without one of the channels, or with fewer usable samples than the fit needs.
    """
    for name in (RESISTANCE, TIP_DEFLECTION):
        if name not in recording:
            raise ValueError(
                f"recording: found no channel {name}; self-sensing is identified from both channels"
            )
    resistance, deflection = recording[RESISTANCE], recording[TIP_DEFLECTION]
    usable = np.isfinite(resistance) & np.isfinite(deflection) & (resistance > 0)
    whole = bool(np.all(usable))
    resistance, deflection = resistance[usable], deflection[usable]
    found = {
        **PolynomialSelfSensing.fit(resistance, deflection, degree).to_parameters(),
        **DirectEGPISelfSensing.fit(resistance, deflection, plays).to_parameters(),
        **DirectPreisachSelfSensing.fit(resistance, deflection, level).to_parameters(),
    }
    found |= composite_parameters(recording, parameters, composite_plays)
    found |= mode_parameters(
        recording.time_s if whole else None, resistance, deflection, {**parameters, **found}
    )
    known = {**parameters, **found}
    log_resistance = np.log10(resistance)
    knots = np.linspace(log_resistance.min(), log_resistance.max(), _BINS)
    found[BOUND_KNOTS] = knots.tolist()
    for kind in KINDS:
        estimate, _ = self_sensing(kind, known, judged=False).estimate(resistance)
        error = np.asarray(estimate.deflection) - deflection
        found[f"{SECTION}.bounds.{kind}"] = fit_bound(log_resistance, error, knots).tolist()
    return found
