"""Warm contacts add a voltage to the one that resistance is told from."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE

EFFECT = Effect(
    id="thermovoltage",
    stage="terminals",
    parameters=(
        constant_of(
            "coefficient", 0, "ohm/K", "apparent resistance per temperature rise of the film", -1e5, 1e5
        ),
    ),
    channels=(RESISTANCE,),
    order=40,
    needs=("resistance",),
    typical={"integrated": {"coefficient": (8.0, 40.0)}, "peltier": {"coefficient": (1.0, 5.0)}},
    equation="R_measured = R + c (T - T0), c the Seebeck coefficient over the sense current",
    excitation="the metallic plateau at several temperatures, up and down",
    source="Seebeck effect, any text on low-level measurement",
    statement=(
        "A temperature difference along the leads is a voltage in the sense circuit. It follows the film's temperature and "
        "not the current, and stands out where resistance is small. Turning the sense current over would cancel it."
    ),
)


def terminals(value, film, ambient_of_device, coefficient):
    return value + coefficient * (film - ambient_of_device)
