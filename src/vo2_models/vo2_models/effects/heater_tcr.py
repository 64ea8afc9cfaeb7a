"""The heater's resistance grows with its temperature."""

from vo2_models.effects.record import HEAT, Effect, constant_of

EFFECT = Effect(
    id="heater_tcr",
    stage="thermal",
    parameters=(
        constant_of("alpha", 0, "1/K", "temperature coefficient of the heater's resistance", -0.008, 0.008),
    ),
    channels=HEAT,
    needs=("heater",),
    typical={"integrated": {"alpha": (0.3e-3, 2e-3)}},
    equation="tau dtheta/dt = k2 i^2 (1 + alpha theta) - theta",
    excitation=(
        "steady levels over the whole temperature range; the heater's voltage separates it from a nonlinear "
        "loss"
    ),
    source="chapter 7.1.1: Ti/Au heater; 3.4e-3 1/K for bulk gold, about half in thin films",
    statement=(
        "Joule heat is current squared times the heater's resistance, and a metal's resistance rises with "
        "temperature: the same current heats more when the device is hot. The gain grows with temperature."
    ),
)


def pumping(joule, alpha):
    return joule * alpha
