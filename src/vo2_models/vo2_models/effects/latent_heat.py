"""Latent heat of the transition."""

from vo2_models.effects.record import HEAT, PHASE, Effect, constant_of

EFFECT = Effect(
    id="latent_heat",
    stage="thermal",
    parameters=(
        constant_of(
            "latent", 0.0, "K", "latent heat of the whole film over the heat capacity of the body", 0, 60
        ),
        PHASE,
    ),
    channels=HEAT,
    needs=("one body",),
    typical={"integrated": {"latent": (5.0, 25.0)}},
    equation="tau (1 + L ds/dT) dT/dt = T_inf(i) - T, s of the structural (phase 0) or the metallic transition (phase 1)",
    excitation="crossings of the transition faster than a few time constants, at more than one rate",
    source=(
        "mismatch table; first-order transition of VO2, about 51 J/g against 0.7 J/(g K) for the film alone "
        "(Berglund and Guggenheim, Phys. Rev. 185, 1969), diluted by the passive layers"
    ),
    statement=(
        "Turning insulator into metal takes up heat and gives it back on cooling. While the film "
        "crosses its transition the same power moves the temperature less, so fast crossings show a plateau and "
        "come late; at rest nothing changes. The parameter is the temperature rise that the same heat would cause "
        "outside the transition."
    ),
)


def latent(latent):
    return latent
