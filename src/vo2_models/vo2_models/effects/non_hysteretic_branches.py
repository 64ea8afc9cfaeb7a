"""Branches inside the loop are not flat."""

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import FILM, Effect, constant_of, setting

EFFECT = Effect(
    id="non_hysteretic_branches",
    stage="transition",
    parameters=(
        constant_of(
            "slope", 0, "1/K", "reversible change of the fraction per kelvin at half transition", -0.05, 0.05
        ),
        constant_of("band", 1, "K", "half width of the band within which it is reversible", 0.05, 20),
    ),
    apply=setting(slope=Coefficient.REVERSIBLE, band=Coefficient.REVERSIBLE_BAND),
    channels=FILM,
    typical={
        "integrated": {"slope": (0.005, 0.02), "band": (1.0, 3.0)},
        "peltier": {"slope": (0.005, 0.02), "band": (1.0, 3.0)},
    },
    equation="s = s_hysteretic + 4 slope s (1 - s) (T - b), b the play of radius `band` on T",
    excitation="small minor loops or a dither on a branch",
    source="non-hysteretic branches of VO2: Gurvitch et al., J. Appl. Phys. 106, 2009",
    statement=(
        "Small temperature excursions inside the major loop move the fraction reversibly along a slope: "
        "boundaries bend before they jump. Small minor loops have no area but a slope, where switching domains"
        " alone would leave a flat line."
    ),
)
