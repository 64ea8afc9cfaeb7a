"""Heat loss that grows faster than the temperature difference."""

from vo2_models.effects.record import HEAT, Effect, constant_of

RISE = 60.0
"""Temperature rise [K] at which the additional loss is told: about the end of the transition."""

EFFECT = Effect(
    id="nonlinear_heat_loss",
    stage="thermal",
    parameters=(
        constant_of("share", 0, "1", "additional loss at a rise of 60 K, as a share of the linear one", 0, 3),
        constant_of("exponent", 2, "1", "exponent n of the additional loss", 1.05, 5),
    ),
    channels=HEAT,
    needs=("body",),
    typical={"integrated": {"share": (0.03, 0.18)}, "peltier": {"share": (0.03, 0.18)}},
    derived=("beta",),
    equation="tau dtheta/dt = k u - theta - share theta |theta / 60 K|^(n-1)",
    excitation="steady levels over the whole temperature range, on both plateaus",
    source="free convection (n about 1.25) and radiation (n up to 4): any text on heat transfer",
    statement=(
        "Convection and radiation carry away more than in proportion when the film is hot: the hot side stays "
        "cooler than a linear loss predicts and reacts a little faster."
    ),
)


def prepare(values, period, time_constant):
    """beta = share / 60^(n-1): told by its share, the loss hardly changes with the exponent."""
    return (values["share"] / RISE ** (values["exponent"] - 1.0),)


def loss(rise, exponent, beta):
    bend = beta * abs(rise) ** (exponent - 1.0)
    return bend, exponent * bend
