"""The drive heats more, or less, the longer it runs."""

from vo2_models.effects.record import ALL, CHOICE, Effect, constant_of

EFFECT = Effect(
    id="drive_gain_drift",
    stage="driver",
    parameters=(
        constant_of("rate", 0, "1/s", "relative change of the current per time", -1e6, 1e6),
        constant_of("curvature", 0, "1/s^2", "half its change of rate per time", -1e12, 1e12),
        constant_of(
            "logged",
            1,
            CHOICE,
            "1 where the logged current shows it (supply), 0 where not (ageing heater)",
            0,
            1,
        ),
    ),
    channels=ALL,
    course="rate",
    order=40,
    typical={"integrated": {"rate": (1e-3, 6e-3)}, "peltier": {"rate": (1e-5, 6e-5)}},
    equation="i = u (1 + rate t + curvature t^2)",
    excitation="identical loops at the start and the end of the recording",
    source="any text on instrumentation; electromigration of thin-film heaters",
    statement=(
        "Supply or heater change while they run: the same command heats more, or less, the later it comes, in proportion "
        "to what is commanded. A drifting room would shift all temperatures by the same."
    ),
)


def drive(current, time, course, rate, curvature, logged):
    return current * (1.0 + time * (rate + time * curvature) + course) if logged > 0.5 else current


def heating(joule, time, course, on_stage, rate, curvature, logged):
    if logged > 0.5:
        return 0.0
    # a Peltier stage pumps in proportion to the current, a heater warms with its square
    grown = 1.0 + time * (rate + time * curvature) + course
    return joule * ((grown if on_stage != 0.0 else grown * grown) - 1.0)
