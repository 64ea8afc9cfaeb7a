"""The structure gets stiffer the farther it bends."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="stiffening",
    stage="structure",
    parameters=(
        constant_of(
            "stiffness", 0, "1/m^2", "relative loss of deflection per squared deflection", -1e18, 1e24
        ),
        constant_of(
            "rest_bend",
            0,
            "1/m",
            "relative loss per deflection: the structure is bent at rest",
            -1e12,
            1e12,
        ),
    ),
    channels=(TIP_DEFLECTION,),
    linear=False,
    order=35,
    typical={
        "integrated": {"stiffness": (8e6, 4e7), "rest_bend": (4e2, 2e3)},
        "peltier": {"stiffness": (6e6, 3e7), "rest_bend": (4e2, 2e3)},
    },
    equation="D_measured = D / (1 + b D + c D^2)",
    excitation="the whole range of deflection",
    source=(
        "Duffing spring about a deflection of rest, whose square term is b; Kovacic and Brennan, The Duffing Equation, 2011"
    ),
    statement=(
        "Residual stress, a clamp that rolls off or a large deflection make the cantilever stiffer as it bends: the same "
        "moment bends it less where it is bent already. Nothing is late, and the two branches change alike at a deflection. A "
        "sensor whose gain falls with its reading gives the same values: check it against one that is known to be linear."
    ),
)


def structure(deflection, stiffness, rest_bend):
    return deflection / (1.0 + rest_bend * deflection + stiffness * deflection * deflection)
