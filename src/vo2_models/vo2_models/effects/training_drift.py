"""Every reversal shifts the transition a little."""

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import FILM, Effect, constant_of, setting

EFFECT = Effect(
    id="training_drift",
    stage="transition",
    parameters=(
        constant_of(
            "shift", 0, "K", "shift of the effective temperature per reversal of the temperature", -1, 1
        ),
    ),
    apply=setting(shift=Coefficient.TRAINING),
    channels=FILM,
    typical={"integrated": {"shift": (0.01, 0.05)}, "peltier": {"shift": (0.1, 0.5)}},
    equation="T_eff = T + shift N(t), N the number of reversals larger than 2 K",
    excitation=(
        "many cycles, with identical loops early and late; rest without cycling separates it from a drift of "
        "the ambient"
    ),
    source="mismatch table of the project; training of thermally cycled phase-transition films",
    statement=(
        "Each passage through the transition leaves defects that shift it. The loops wander with the number of"
        " cycles and stand still while the device rests, in resistance and deflection alike."
    ),
)
