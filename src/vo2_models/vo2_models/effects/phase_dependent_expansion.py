"""Expansion differs between the phases."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="phase_dependent_expansion",
    stage="structure",
    parameters=(
        constant_of(
            "slope",
            0,
            "m/K",
            "deflection lost per kelvin by the metallic beyond the insulating phase",
            -1e12,
            1e12,
        ),
    ),
    channels=(TIP_DEFLECTION,),
    typical={"integrated": {"slope": (0.06e-6, 0.2e-6)}, "peltier": {"slope": (0.06e-6, 0.2e-6)}},
    equation="D = D_0 - slope s (T - T0)",
    excitation="the plateaus on both sides of the transition",
    source="equations (5.4)-(5.7): the expansion coefficients of M1 and R phase differ",
    statement=(
        "Metallic VO2 expands by another amount per kelvin than insulating VO2, so the deflection's slope on "
        "the hot plateau differs from that on the cold one, and follows the phase through the hysteresis "
        "between them. Resistance is untouched."
    ),
)


def bending(film, fraction, ambient_of_device, slope):
    return -(slope * fraction * (film - ambient_of_device))
