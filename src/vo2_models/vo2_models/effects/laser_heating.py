"""The sensing laser warms the film."""

from vo2_models.device.coefficients import HUGE
from vo2_models.effects.record import FILM, Effect, constant_of

EFFECT = Effect(
    id="laser_heating",
    stage="thermal",
    parameters=(
        constant_of("rise", 0, "K", "temperature rise that the laser causes at rest", -20, 20),
        constant_of("start", -HUGE, "s", "when the laser is switched on", -HUGE, HUGE),
        constant_of("stop", HUGE, "s", "when it is switched off", -HUGE, HUGE),
    ),
    channels=FILM,
    fixed=("start", "stop"),
    needs=("body",),
    typical={"integrated": {"rise": (1.0, 4.0)}, "peltier": {"rise": (1.0, 4.0)}},
    order=30,
    equation="T_film = T + rise while the laser is on",
    excitation=(
        "the laser switched on and off during the recording; a steady laser is absorbed by the ambient "
        "temperature"
    ),
    source="section 5.1.2: a constant laser offset shifted the apparent transition temperature",
    statement=(
        "The laser that measures the deflection also heats the film. While it is on, everything happens at a "
        "lower stage temperature; where it is steady nothing distinguishes it from a warmer room. On the "
        "Peltier stage the film alone is warmed, its stage and stage sensor are not."
    ),
)


def heating(time, on_stage, rise, start, stop):
    return rise if start <= time < stop and on_stage == 0.0 else 0.0


def film(time, on_stage, rise, start, stop):
    # chapter 5: the laser warms the cantilever; the sensor of the stage underneath does not see it
    return rise if start <= time < stop and on_stage != 0.0 else 0.0
