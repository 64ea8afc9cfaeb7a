"""Heat loss that grows faster than the temperature difference."""

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import HEAT, Effect, constant_of, setting

EFFECT = Effect(
    id="nonlinear_heat_loss",
    stage="thermal",
    parameters=(
        constant_of("beta", 0, "K^(1-n)", "coefficient of the additional loss", -0.05, 0.05),
        constant_of("exponent", 2, "1", "exponent n of the additional loss", 1.05, 5),
    ),
    apply=setting(beta=Coefficient.LOSS, exponent=Coefficient.LOSS_EXPONENT),
    channels=HEAT,
    typical={"integrated": {"beta": (0.5e-3, 3e-3)}, "peltier": {"beta": (0.5e-3, 3e-3)}},
    equation="tau dtheta/dt = k u - theta - beta theta |theta|^(n-1)",
    excitation="steady levels over the whole temperature range, on both plateaus",
    source="free convection (n about 1.25) and radiation (n up to 4): any text on heat transfer",
    statement=(
        "Convection and radiation carry away more than in proportion when the film is hot: the hot side stays "
        "cooler than a linear loss predicts and reacts a little faster."
    ),
)
