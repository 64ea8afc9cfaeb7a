"""The structure gets stiffer the farther it bends."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="stiffening",
    stage="structure",
    parameters=(
        constant_of(
            "stiffness", 0, "1/m^2", "relative loss of deflection per squared deflection", -5e7, 1e12
        ),
    ),
    channels=(TIP_DEFLECTION,),
    linear=False,
    order=35,
    typical={"integrated": {"stiffness": (8e6, 4e7)}, "peltier": {"stiffness": (6e6, 3e7)}},
    equation="D_measured = D / (1 + c D^2)",
    excitation="the whole range of deflection",
    source="Duffing spring, any text on large deflections",
    statement=(
        "Residual stress, a clamp that rolls off or a large deflection make the cantilever stiffer as it bends: the same "
        "moment bends it less where it is bent already. Nothing is late, and the two branches change alike at a deflection."
    ),
)


def structure(deflection, stiffness):
    return deflection / (1.0 + stiffness * deflection * deflection)
