"""A lightly damped mode of the structure."""

from vo2_models.device.mode import mode_step
from vo2_models.effects.record import Effect, State, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="cantilever_resonance",
    stage="structure",
    parameters=(
        constant_of("share", 0, "1", "part of the deflection that moves through the mode", 0, 1.5),
        constant_of("frequency", 1, "Hz", "undamped natural frequency", 1e-9, 1e9),
        constant_of("damping", 0.02, "1", "damping ratio", 1e-4, 1),
    ),
    channels=(TIP_DEFLECTION,),
    typical={
        "integrated": {"share": (0.7, 1.0), "frequency": (40.0, 300.0), "damping": (0.005, 0.05)},
        "peltier": {"share": (0.7, 1.0), "frequency": (0.3, 2.5), "damping": (0.005, 0.05)},
    },
    states=(
        State("mode", "m", "displacement of the mode"),
        State("speed", "m", "its rate per rad of the mode"),
        State("last", "m", "deflection of the sample before"),
    ),
    derived=("zz", "zr", "zl", "zn", "rz", "rr", "rl", "rn"),
    order=60,
    equation="z'' + 2 zeta w z' + w^2 z = w^2 D; D_measured = (1 - share) D + share z",
    excitation="steps or a chirp through the mode's frequency, sampled faster than twice that frequency",
    source=(
        "chapter 7.2.1: structural dynamics cannot be ignored entirely at the tested frequencies; any text on "
        "vibrating beams"
    ),
    statement=(
        "The structure does not follow the bending moment at once but rings at a natural frequency: after a "
        "step the deflection overshoots and oscillates, while resistance and temperature stay clean. It stands"
        " for any lightly damped mode below half the sampling rate: long, soft or mass-loaded cantilevers and "
        "modes of the package."
    ),
)


def prepare(values, period, time_constant):
    """Exact step of the mode over a period."""
    return mode_step(values["frequency"], values["damping"], period, time_constant=time_constant).ravel()


def settled(deflection):
    return deflection, 0.0, deflection


def advance(deflection, mode, speed, last, zz, zr, zl, zn, rz, rr, rl, rn):
    return (
        zz * mode + zr * speed + zl * last + zn * deflection,
        rz * mode + rr * speed + rl * last + rn * deflection,
        deflection,
    )


def structure(deflection, mode, share):
    return deflection + share * (mode - deflection)
