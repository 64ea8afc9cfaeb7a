"""The clamp has play."""

from vo2_models.effects.record import Effect, State, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="backlash",
    stage="structure",
    parameters=(
        constant_of("width", 0, "m", "half of the play", 0, 1e12),
        constant_of("start", 0, "1", "where the play begins, from one end, -1, to the other, 1", -1.5, 1.5),
    ),
    states=(State("centre", "m", "where the play stands"),),
    channels=(TIP_DEFLECTION,),
    linear=False,
    order=30,
    typical={
        "integrated": {"width": (0.4e-6, 1.6e-6), "start": (0.3, 1.0)},
        "peltier": {"width": (0.5e-6, 2e-6), "start": (0.3, 1.0)},
    },
    equation="D_measured = max(min(D_measured, D + width), D - width)",
    excitation="many reversals, also outside of the transition",
    source="play operator, e.g. Visintin, Differential Models of Hysteresis, 1994",
    statement=(
        "Between cantilever and clamp, or in the sensor's coupling, there is play: after each reversal the tip rests until the "
        "play is used up. It does so at all temperatures alike, which the loop of the film does not."
    ),
)


def settled(deflection, width, start):
    # a play rests wherever it was left
    return deflection - width * min(max(start, -1.0), 1.0)


def advance(deflection, centre, width):
    return min(max(centre, deflection - width), deflection + width)


def structure(centre):
    return centre
