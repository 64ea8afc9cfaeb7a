"""Structural and metallic transition drift apart."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="transition_offset",
    stage="transition",
    parameters=(
        constant_of(
            "offset", 0, "K", "change of the temperature that the structural transition sees", -15, 15
        ),
    ),
    channels=(TIP_DEFLECTION,),
    typical={"integrated": {"offset": (0.8, 3.0)}, "peltier": {"offset": (0.8, 3.0)}},
    equation="s_structural = S[T + offset]",
    excitation="any major loop with both deflection and resistance",
    source="sections 7.1.3 and 8.2: different energies of the metal-insulator and the structural transition",
    statement=(
        "Resistance follows the metal-insulator transition, deflection the structural one, and the two need "
        "not happen at the same temperature. When their distance changes, the loop of deflection over "
        "resistance opens although both single loops keep their shape."
    ),
)


def structural_shift(offset):
    return offset
