"""Domains feel the phase around them."""

from vo2_models.effects.record import FILM, Effect, constant_of

EFFECT = Effect(
    id="minor_loop_incongruency",
    stage="transition",
    parameters=(
        constant_of(
            "kappa", 0, "K", "shift of the effective temperature from all insulating to all metallic", -6, 6
        ),
    ),
    channels=FILM,
    typical={"integrated": {"kappa": (1.0, 3.0)}, "peltier": {"kappa": (1.0, 3.0)}},
    equation="T_eff = T + kappa (s - 1/2), s the switched share of the same transition's output",
    excitation="first-order reversal curves or minor loops at several fractions",
    source=(
        "moving Preisach model: Della Torre, IEEE Trans. Audio Electroacoust. 14, 1966; mismatch table of the "
        "project"
    ),
    statement=(
        "Neighbouring grains pull each other along through strain or current paths. The major loop merely "
        "becomes steeper or flatter, but minor loops between the same temperatures no longer have the same "
        "shape at every fraction, which no superposition of independent domains can do."
    ),
)


def feedback(share, kappa):
    return kappa * (share - 0.5)
