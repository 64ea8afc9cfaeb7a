"""The heater current couples into the resistance reading."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE

EFFECT = Effect(
    id="current_crosstalk",
    stage="terminals",
    parameters=(constant_of("coupling", 0, "ohm/A", "apparent resistance per heater current", -1e8, 1e8),),
    channels=(RESISTANCE,),
    needs=("resistance",),
    typical={"integrated": {"coupling": (4e4, 3e5)}, "peltier": {"coupling": (30.0, 200.0)}},
    order=30,
    equation="R_measured = R + chi i",
    excitation="current steps: it shows before the temperature moves",
    source="mismatch table of the project",
    statement=(
        "Shared ground or coupling between the heater's traces and the resistance contacts adds a voltage in "
        "step with the heater current. The reading jumps at every current edge, before the temperature has had"
        " time to move."
    ),
)


def terminals(value, current, coupling):
    return value + coupling * current
