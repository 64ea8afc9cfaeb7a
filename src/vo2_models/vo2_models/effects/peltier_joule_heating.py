"""Joule heat and back-conduction of the Peltier element."""

from vo2_models.effects.record import HEAT, Effect, constant_of

EFFECT = Effect(
    id="peltier_joule_heating",
    stage="thermal",
    parameters=(
        constant_of("rho", 0, "K/A^2", "temperature rise per squared current", -50, 50),
        constant_of(
            "pumping", 0, "1/A", "change of the pumped heat with the temperature difference", -0.5, 0.5
        ),
    ),
    channels=HEAT,
    needs=("pump",),
    typical={"peltier": {"rho": (1.5, 6.0), "pumping": (0.01, 0.05)}},
    order=10,
    equation="tau dtheta/dt = K i + rho i^2 + pumping i theta - theta",
    excitation="currents of both signs at equal magnitude",
    source="heat balance of a thermoelectric element, any text on Peltier devices",
    statement=(
        "A Peltier element pumps heat in proportion to the current, but its own resistance always heats, and "
        "the heat it pumps depends on the temperature across it. The gain differs between the two signs of the"
        " current and bends with its magnitude."
    ),
)


def heating(current, rho):
    return rho * current * current


def pumping(current, pumping):
    return pumping * current
