"""Cooling slower or faster than heating."""

from vo2_models.effects.record import HEAT, Effect, constant_of

EFFECT = Effect(
    id="cooling_asymmetry",
    stage="thermal",
    parameters=(
        constant_of("ratio", 0, "1", "time constant of cooling over that of heating, minus 1", -0.7, 2),
    ),
    channels=HEAT,
    needs=("body",),
    typical={"integrated": {"ratio": (0.1, 0.4)}, "peltier": {"ratio": (0.1, 0.4)}},
    equation="tau = tau_heating where dT/dt > 0, tau_heating (1 + ratio) where dT/dt < 0",
    excitation="steps or a chirp up and down outside the transition",
    source="Table 8.1: 20.8 and 22.6 s on heating, 27.4 and 28.2 s on cooling",
    statement=(
        "The body approaches a lower temperature with another time constant than a higher one, as the measured"
        " steps of Table 8.1 do. Steady values stay the same; transients become lopsided, which shows as even "
        "harmonics."
    ),
)


def lag(surplus, ratio):
    return 1.0 + ratio if surplus < 0.0 else 1.0
