"""One channel's samples are older than their stamp."""

from vo2_models.device.coefficients import Sensor
from vo2_models.effects.record import Effect, constant_of, setting
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="clock_offset",
    stage="sensor",
    parameters=(constant_of("delay", 0, "s", "age of the channel's value at its stamp", 0, 1e3),),
    apply=setting(delay=Sensor.CLOCK),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={"integrated": {"delay": (0.5e-3, 3e-3)}, "peltier": {"delay": (0.4, 3.0)}},
    equation="y(t) = y_true(t - delay)",
    excitation="steps or a chirp with another channel to compare",
    source="any text on data acquisition",
    statement=(
        "One channel is stamped late: another clock, a buffer, a converter that is read in turn. The whole "
        "signal is shifted in time without being rounded."
    ),
)
