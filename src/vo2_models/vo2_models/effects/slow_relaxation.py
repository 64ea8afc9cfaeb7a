"""The phase drifts on while the temperature is held."""

from vo2_models.device.coefficients import Coefficient
from vo2_models.effects.record import FILM, Effect, constant_of, setting

EFFECT = Effect(
    id="slow_relaxation",
    stage="transition",
    parameters=(
        constant_of(
            "amplitude", 0, "1", "drift of the fraction at half transition, per e-fold of time", -0.2, 0.2
        ),
        constant_of("onset", 1, "s", "time after which the drift begins", 1e-5, 1e5),
        constant_of("travel", 0.5, "K", "motion after which 63 % of the drift is forgotten", 0.02, 20),
    ),
    apply=setting(
        amplitude=Coefficient.RELAXATION,
        onset=Coefficient.RELAXATION_TIME,
        travel=Coefficient.RELAXATION_TRAVEL,
    ),
    channels=FILM,
    typical={
        "integrated": {"amplitude": (5e-3, 0.02), "onset": (2e-3, 0.01)},
        "peltier": {"amplitude": (5e-3, 0.02), "onset": (1.0, 5.0)},
    },
    equation=(
        "s + 4 A s (1 - s) y; dy/dt = (d / t0) exp(-d y) - (y / T_f) |dT/dt|, d the way of the last motion: "
        "y = d ln(1 + t / t0) while T is held"
    ),
    excitation="holds inside and outside the loop",
    source=(
        "logarithmic after-effect of a distribution of barriers (Neel; Street and Woolley); resistance "
        "relaxations of VO2 devices, Galloni et al., PNAS 121, 2024"
    ),
    statement=(
        "While the temperature is held inside the loop, domains whose barrier is almost overcome still switch,"
        " ever more slowly: resistance and deflection drift together with the logarithm of time. Outside the "
        "loop nothing is left to switch and nothing drifts; creep would drift there too, in deflection alone."
    ),
)
