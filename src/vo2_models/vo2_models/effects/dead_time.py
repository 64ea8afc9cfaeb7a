"""Transport delay between current and heat."""

from __future__ import annotations

from collections.abc import Mapping

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import HEAT, Effect, Floats, constant_of


def _apply(c: Floats, values: Mapping[str, float], device: str, signal: str) -> None:
    c[Coefficient.DEAD_TIME] += values["delay"]


EFFECT = Effect(
    id="dead_time",
    stage="driver",
    parameters=(constant_of("delay", 0, "s", "delay added to the nominal dead time", 0, 1e3),),
    apply=_apply,
    channels=HEAT,
    typical={"integrated": {"delay": (0.5e-3, 4e-3)}, "peltier": {"delay": (0.3, 2.0)}},
    equation="tau dtheta/dt = k u(t - delay) - theta",
    excitation="steps or a chirp; the phase it adds grows in proportion to frequency",
    source="equation (8.1): 0.375 s on the Peltier stage",
    statement=(
        "The current acts only after a delay: an output buffer of the controller, or heat that has to travel. "
        "Every thermal signal comes later by the same time, whatever its size, inside and outside the "
        "transition."
    ),
)
