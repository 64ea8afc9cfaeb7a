"""A slow thermal path beside the fast one."""

import math

from vo2_models.effects.record import HEAT, Effect, State, constant_of

EFFECT = Effect(
    id="second_thermal_mode",
    stage="thermal",
    parameters=(
        constant_of(
            "share",
            0,
            "1",
            "part of the steady temperature rise that arrives through the slow path",
            -0.5,
            0.5,
        ),
        constant_of("time_constant", 1, "s", "time constant of the slow path", 1e-9, 1e9),
        constant_of("gain", 0, "1", "change of the steady gain that comes with it", -0.5, 0.5),
    ),
    channels=HEAT,
    needs=("body",),
    typical={
        "integrated": {"share": (0.02, 0.08), "time_constant": (0.03, 0.3)},
        "peltier": {"share": (0.02, 0.08), "time_constant": (80.0, 250.0)},
    },
    states=(State("slow", "K", "temperature rise of the slow body"),),
    equation="T = T0 + (1 + gain - share) theta_1 + share theta_2; tau_2 dtheta_2/dt = k1 i + k2 i^2 - theta_2",
    excitation="steps held for several times the slow time constant",
    source=(
        "mismatch table of the project; two-body thermal networks, e.g. the substrate behind the cantilever's "
        "anchor"
    ),
    statement=(
        "A part of the heat warms a second, slower body, the chip or the mount, which then warms the film. "
        "After a step the temperature runs on for a long time, and with it both resistance and deflection; "
        "creep would move the deflection alone."
    ),
)


def settled(drive):
    return drive


def advance(drive, h, slow, time_constant):
    return slow - math.expm1(-h / time_constant) * (drive - slow)


def body(slow, share, gain):
    return gain - share, share * slow
