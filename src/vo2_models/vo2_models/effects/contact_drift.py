"""A contact gets worse, or better, while it is measured."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE

EFFECT = Effect(
    id="contact_drift",
    stage="terminals",
    parameters=(
        constant_of("rate", 0, "ohm/s", "growth of the resistance in series", -1e12, 1e12),
        constant_of("curvature", 0, "ohm/s^2", "half its change of rate per time", -1e12, 1e12),
    ),
    channels=(RESISTANCE,),
    course="rate",
    same_values=("sensor_zero_drift",),
    order=25,
    needs=("resistance",),
    typical={"integrated": {"rate": (40.0, 200.0)}, "peltier": {"rate": (0.05, 0.3)}},
    equation="R_measured = R + rate t + curvature t^2",
    excitation="the metallic plateau at the start and at the end of the recording",
    source="any text on two-terminal measurement",
    statement=(
        "A probe creeps, a pad oxidises: what is in series with the film grows with the time. On the metallic plateau it "
        "shows, beside the insulating resistance it is lost; a drifting gain would change both by the same share. A meter whose "
        "zero drifts gives the same values."
    ),
)


def terminals(value, time, rate, curvature):
    return value + time * (rate + time * curvature)
