"""The metallic phase conducts heat differently."""

from vo2_models.effects.record import HEAT, PHASE, Effect, constant_of

EFFECT = Effect(
    id="phase_dependent_heat_loss",
    stage="thermal",
    parameters=(
        constant_of(
            "gamma", 0, "1", "relative change of the heat loss from insulating to metallic", -0.6, 1.5
        ),
        PHASE,
    ),
    channels=HEAT,
    needs=("one body",),
    typical={"integrated": {"gamma": (0.04, 0.15)}},
    equation="tau dtheta/dt = k u - (1 + gamma s) theta, s of the structural (phase 0) or metallic transition (phase 1)",
    excitation="both plateaus and the inside of the loop, at steady levels and at steps",
    source=(
        "thermal conductivity and infrared emissivity of VO2 change with the phase: Oh et al., Appl. Phys. "
        "Lett. 96, 2010; Kats et al., Phys. Rev. X 3, 2013"
    ),
    statement=(
        "Metallic VO2 conducts and radiates heat differently from insulating VO2. Gain and time constant "
        "change in the middle of the loop and follow the phase, not the temperature: at one and the same "
        "current the film has another temperature on the heating than on the cooling branch."
    ),
)


def conductance(fraction, gamma):
    return gamma * fraction
