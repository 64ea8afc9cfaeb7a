"""The current that senses the resistance heats the film."""

from vo2_models.effects.record import FILM, Effect, constant_of

EFFECT = Effect(
    id="sense_self_heating",
    stage="thermal",
    parameters=(
        constant_of(
            "coefficient",
            0,
            "K/ohm",
            "thermal resistance times squared sense current",
            0,
            1e-3,
        ),
    ),
    channels=FILM,
    needs=("body", "resistance"),
    typical={"integrated": {"coefficient": (4e-6, 15e-6)}, "peltier": {"coefficient": (8e-6, 30e-6)}},
    order=20,
    equation="T rises by k I_s^2 R",
    excitation="the cold side and the onset of the transition; a second sense current separates it from other terms",
    source="mismatch table of the project; Joule heating of thermistors",
    statement=(
        "Reading the resistance takes a current, and the current heats the film in proportion to its "
        "resistance: most where the film is cold and insulating. Where resistance falls the heat falls too, so"
        " the transition is stretched."
    ),
)


def heating(resistance, on_stage, coefficient):
    return coefficient * resistance if on_stage == 0.0 else 0.0


def film(resistance, on_stage, coefficient):
    # on a stage that is much heavier than the film only the film itself gets warmer
    return coefficient * resistance if on_stage != 0.0 else 0.0
