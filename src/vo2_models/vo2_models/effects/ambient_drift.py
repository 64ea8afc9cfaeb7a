"""The surroundings warm or cool during the recording."""

from vo2_models.effects.record import HEAT, Effect, constant_of

EFFECT = Effect(
    id="ambient_drift",
    stage="thermal",
    parameters=(
        constant_of("rate", 0, "K/s", "change of the ambient temperature per time", -10, 10),
        constant_of("curvature", 0, "K/s^2", "half its change of rate per time", -1, 1),
    ),
    channels=HEAT,
    needs=("body",),
    course="rate",
    typical={"integrated": {"rate": (0.1, 0.4)}, "peltier": {"rate": (0.5e-3, 3e-3)}},
    equation="T0(t) = T0 + rate t + curvature t^2",
    excitation="a recording with comparable parts early and late",
    source="mismatch table of the project",
    statement=(
        "The temperature of the mount or of the room moves slowly, and the film with it: the same current "
        "gives another temperature late in the recording than early. Time at rest counts as much as time in "
        "motion."
    ),
)


def ambient(time, course, rate, curvature):
    return time * (rate + time * curvature) + course
