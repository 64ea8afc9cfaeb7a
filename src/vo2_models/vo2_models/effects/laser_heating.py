"""The sensing laser warms the film."""

from __future__ import annotations

from collections.abc import Mapping

from vo2_models.device.coefficients import HUGE, Coefficient
from vo2_models.effects.record import FILM, Effect, Floats, constant_of


def _apply(c: Floats, values: Mapping[str, float], device: str, signal: str) -> None:
    # chapter 5: the laser warms the cantilever; the sensor of the Peltier stage underneath does not see it
    c[Coefficient.LASER_FILM if device == "peltier" else Coefficient.LASER] = values["rise"]
    c[Coefficient.LASER_FROM] = values["start"]
    c[Coefficient.LASER_UNTIL] = values["stop"]


EFFECT = Effect(
    id="laser_heating",
    stage="thermal",
    parameters=(
        constant_of("rise", 0, "K", "temperature rise that the laser causes at rest", -20, 20),
        constant_of("start", -HUGE, "s", "when the laser is switched on", -HUGE, HUGE),
        constant_of("stop", HUGE, "s", "when it is switched off", -HUGE, HUGE),
    ),
    apply=_apply,
    channels=FILM,
    fixed=("start", "stop"),
    typical={"integrated": {"rise": (1.0, 4.0)}, "peltier": {"rise": (1.0, 4.0)}},
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
