"""Branches inside the loop are not flat."""

from vo2_models.effects.record import FILM, Effect, State, constant_of

EFFECT = Effect(
    id="non_hysteretic_branches",
    stage="transition",
    parameters=(
        constant_of(
            "slope", 0, "1/K", "reversible change of the fraction per kelvin at half transition", -0.05, 0.05
        ),
        constant_of("band", 1, "K", "half width of the band within which it is reversible", 0.05, 20),
        constant_of("share", 0, "1", "part of the fraction that follows the anhysteretic curve", -0.5, 0.9),
    ),
    channels=FILM,
    typical={
        "integrated": {"slope": (0.005, 0.02), "band": (1.0, 3.0)},
        "peltier": {"slope": (0.005, 0.02), "band": (1.0, 3.0)},
    },
    states=(State("centre", "degC", "centre of the reversible band"),),
    equation=(
        "s = s_h + 4 slope s_h (1 - s_h) (T - b) + share (s_a(T) - s_h), s_h hysteretic, s_a half way between the major "
        "branches, b the play of radius `band` on T"
    ),
    excitation="small minor loops or a dither on a branch",
    source="Gurvitch et al., J. Appl. Phys. 106, 2009 (VO2); the reversible share: Jiles and Atherton, 1986",
    statement=(
        "Small temperature excursions inside the major loop move the fraction reversibly along a slope: "
        "boundaries bend before they jump. Small minor loops have no area but a slope, where switching domains"
        " alone would leave a flat line. Either the slope is local, or a share of the material follows the curve half way "
        "between the branches all along."
    ),
)


def settled(film, band):
    return film - band


def advance(film, centre, band):
    return min(max(centre, film - band), film + band)


def beside(half_way, film, middle, centre, slope, share):
    return slope * (film - centre) * half_way + share * middle
