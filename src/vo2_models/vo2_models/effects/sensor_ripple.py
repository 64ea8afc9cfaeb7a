"""Interference in an optical sensor: a ripple that goes with the value."""

import math

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import TIP_DEFLECTION

EFFECT = Effect(
    id="sensor_ripple",
    stage="sensor",
    parameters=(
        constant_of("amplitude", 0, "channel unit", "amplitude of the ripple", 0, 1e12),
        constant_of("pitch", 1e-5, "channel unit", "change of the value from crest to crest", 1e-12, 1e12),
        constant_of("phase_angle", 0, "rad", "phase of the ripple at the value 0", -7, 7),
    ),
    channels=(TIP_DEFLECTION,),
    signal=True,
    linear=False,
    order=5,
    typical={
        "integrated": {"amplitude": (0.3e-6, 1.2e-6), "pitch": (6e-6, 20e-6), "phase_angle": (0.5, 3.0)},
        "peltier": {"amplitude": (0.4e-6, 1.5e-6), "pitch": (7e-6, 25e-6), "phase_angle": (0.5, 3.0)},
    },
    equation="y = y_true + a sin(2 pi y_true / pitch + phase)",
    excitation="slow ramps over many crests",
    source="parasitic interference of an optical lever, e.g. Kolodny et al., Rev. Sci. Instrum. 65, 1994",
    statement=(
        "Light that is reflected twice interferes with itself: what the sensor shows swings about the truth as the tip moves "
        "on by fractions of a fixed length. It goes with the deflection itself, on both branches alike."
    ),
)


def sensor(value, amplitude, pitch, phase_angle):
    return value + amplitude * math.sin(2.0 * math.pi * value / pitch + phase_angle)
