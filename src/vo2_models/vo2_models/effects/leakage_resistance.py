"""A leak in parallel with the film."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE

EFFECT = Effect(
    id="leakage_resistance",
    stage="terminals",
    parameters=(constant_of("conductance", 0, "S", "conductance added beside the film", 0, 1),),
    channels=(RESISTANCE,),
    needs=("resistance",),
    typical={"integrated": {"conductance": (2e-7, 1e-6)}, "peltier": {"conductance": (4e-7, 2e-6)}},
    order=10,
    equation="1 / R_measured = 1 / R + conductance",
    excitation="the insulating plateau",
    source="any text on two-terminal measurement",
    statement=(
        "Moisture, residues or the input of an instrument conduct beside the film. The large insulating "
        "resistance reads too low, the small metallic one hardly changes."
    ),
)


def terminals(value, conductance):
    return value / (1.0 + conductance * value)
