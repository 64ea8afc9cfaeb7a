"""The source delivers less than in proportion where much is asked for."""

from vo2_models.effects.record import ALL, Effect, constant_of

EFFECT = Effect(
    id="source_compression",
    stage="driver",
    parameters=(
        constant_of(
            "compression", 0, "1/A^2", "inverse square of the current at which half is delivered", 0, 1e6
        ),
        constant_of("exponent", 2, "1", "exponent n of the loss", 1.05, 8),
    ),
    channels=ALL,
    order=5,
    typical={"integrated": {"compression": (500.0, 2500.0)}, "peltier": {"compression": (0.03, 0.15)}},
    equation="i = u / (1 + (c u^2)^(n/2))",
    excitation="levels over the whole range; the logged current tells it from a loss of heat",
    source="any text on amplifiers",
    statement=(
        "The output stage has less and less in hand: the current stays behind the command, little at small and more at large "
        "currents, at once and without memory, the steeper the larger n. A clipped source would be exact below its limit."
    ),
)


def drive(current, compression, exponent):
    loss = compression * current * current
    if exponent != 2.0:
        loss = loss ** (0.5 * exponent)
    return current / (1.0 + loss)
