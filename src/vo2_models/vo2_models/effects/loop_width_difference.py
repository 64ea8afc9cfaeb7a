"""The structural transition's loop is wider or narrower than the metallic one's."""

import math

from vo2_models.effects.record import Effect, State, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="loop_width_difference",
    stage="transition",
    parameters=(
        constant_of(
            "difference",
            0,
            "K",
            "change of the structural loop's width; below 0 deflection leads resistance",
            -7,
            7,
        ),
    ),
    states=(State("centre", "degC", "centre of a play of half that width"),),
    channels=(TIP_DEFLECTION,),
    typical={"integrated": {"difference": (0.4, 1.5)}, "peltier": {"difference": (0.4, 1.5)}},
    equation=(
        "s_structural = S[T + sign(w) (P(T) - T)], P the play of half width |w| / 2: the heating branch moves by w / 2, the "
        "cooling branch by -w / 2"
    ),
    excitation="any major loop with both deflection and resistance",
    source="sections 8.1.2 and 8.2: test piece and cantilever, and the energies of the two transitions, differ",
    statement=(
        "Resistance and deflection do not lag by the same: the structural transition has another width of loop than the "
        "metallic one, or the film whose resistance is read is not the one that bends. A shift of one transition against the "
        "other would move both branches the same way; this moves them apart."
    ),
)


def settled(film, difference):
    return film + 0.5 * abs(difference)  # cooled down to where it rests


def advance(film, centre, difference):
    return min(max(centre, film - 0.5 * abs(difference)), film + 0.5 * abs(difference))


def structural_shift(film, centre, difference):
    # a wider loop sees the play itself; a narrower one is as far ahead of the film as the play is behind it
    return math.copysign(1.0, difference) * (centre - film)
