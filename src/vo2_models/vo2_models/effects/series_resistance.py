"""Leads and contacts in series with the film."""

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE

EFFECT = Effect(
    id="series_resistance",
    stage="terminals",
    parameters=(constant_of("resistance", 0, "ohm", "resistance added in series", 0, 1e12),),
    channels=(RESISTANCE,),
    needs=("resistance",),
    typical={"integrated": {"resistance": (300.0, 1500.0)}, "peltier": {"resistance": (40.0, 200.0)}},
    order=20,
    equation="R_measured = R + r",
    excitation="the metallic plateau",
    source="any text on two-terminal measurement",
    statement=(
        "A corroding contact or another cable adds a constant resistance. It is lost beside the large "
        "insulating resistance and conspicuous beside the small metallic one, without any delay or loop of its"
        " own."
    ),
)


def terminals(value, resistance):
    return value + resistance
