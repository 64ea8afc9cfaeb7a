"""Every reversal shifts the transition a little."""

from vo2_models.effects.record import FILM, Effect, State, constant_of

EXCURSION = 2.0
"""Turns smaller than this [K] do not count."""

EFFECT = Effect(
    id="training_drift",
    stage="transition",
    parameters=(
        constant_of(
            "shift", 0, "K", "shift of the effective temperature per reversal of the temperature", -1, 1
        ),
    ),
    channels=FILM,
    typical={"integrated": {"shift": (0.01, 0.05)}, "peltier": {"shift": (0.1, 0.5)}},
    states=(
        State("turn", "degC", "extreme since the last reversal"),
        State("direction", "1", "+1 heating, -1 cooling, 0 not yet known"),
        State("reversals", "1", "reversals counted"),
    ),
    equation="T_eff = T + shift N(t), N the number of reversals larger than 2 K",
    excitation=(
        "many cycles, with identical loops early and late; rest without cycling separates it from a drift of "
        "the ambient"
    ),
    source="mismatch table of the project; training of thermally cycled phase-transition films",
    statement=(
        "Each passage through the transition leaves defects that shift it. The loops wander with the number of"
        " cycles and stand still while the device rests, in resistance and deflection alike."
    ),
)


def settled(film):
    return film, 0.0, 0.0


def advance(film, turn, direction, reversals):
    """Zigzag count of turning points whose excursion is large enough."""
    if direction == 0.0:
        if abs(film - turn) > EXCURSION:
            direction = 1.0 if film > turn else -1.0
            turn = film
    elif (film - turn) * direction > 0.0:
        turn = film
    elif abs(film - turn) > EXCURSION:
        direction = -direction
        turn = film
        reversals += 1.0
    return turn, direction, reversals


def shift(reversals, shift):
    return shift * reversals
