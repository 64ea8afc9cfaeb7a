"""One sensor answers with a lag."""

from vo2_models.device.coefficients import Sensor
from vo2_models.effects.record import Effect, constant_of, setting
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

EFFECT = Effect(
    id="sensor_lag",
    stage="sensor",
    parameters=(constant_of("time_constant", 0, "s", "time constant of the sensor", 0, 1e4),),
    apply=setting(time_constant=Sensor.LAG),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    typical={"integrated": {"time_constant": (0.7e-3, 4e-3)}, "peltier": {"time_constant": (0.7, 4.0)}},
    equation="tau dy/dt = y_true - y",
    excitation="steps or a chirp with another channel to compare",
    source="any text on instrumentation",
    statement=(
        "One channel passes through a low-pass filter: an averaging meter, a slow probe. Its edges are rounded"
        " and late while the other channels are as before."
    ),
)
