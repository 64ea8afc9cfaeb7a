"""The loop gets wider the faster it is traversed."""

from vo2_models.effects.record import FILM, Effect, State, constant_of

EFFECT = Effect(
    id="rate_dependent_width",
    stage="transition",
    parameters=(
        constant_of("excess", 0, "K", "half width added at one kelvin per time constant of the body", 0, 7),
        constant_of("exponent", 0.2, "1", "power of the rate with which it grows; 1 is a lag", 0.05, 1),
    ),
    channels=FILM,
    typical={
        "integrated": {"excess": (0.3, 1.0), "exponent": (0.15, 0.4)},
        "peltier": {"excess": (0.3, 1.0), "exponent": (0.15, 0.4)},
    },
    states=(State("seen", "degC", "temperature that the transition has followed to"),),
    equation=(
        "both transitions see x; dx/dt = r sign(T - x) (|T - x| / excess)^(1 / exponent), r = 1 K per time constant of the "
        "body: at a steady rate T - x = excess (dT/dt / r)^exponent"
    ),
    excitation="the same loops at rates that differ by decades, and holds inside the loop",
    source=(
        "thermally activated switching: Sharrock, J. Appl. Phys. 76, 6413, 1994 (coercivity and rate); the overstress law: "
        "Perzyna, Adv. Appl. Mech. 9, 243, 1966"
    ),
    statement=(
        "Domains need an overdrive to switch in the time they are given: the faster the temperature moves, the farther it "
        "runs ahead of them, by a power of the rate that is less than one. Loops widen by nearly the same over each decade "
        "of rate, and at a hold the transition goes on for a while, ever more slowly."
    ),
)


def settled(film):
    return film


def advance(film, h, seen, excess, exponent, time_constant_of_body):
    # implicit Euler, whose steady lag is exact for any step; left + pace left^power = |behind| by Newton from above,
    # where the function is convex and the iteration cannot leave the root behind
    behind = abs(film - seen)
    if behind == 0.0 or excess <= 0.0:
        return film
    power = 1.0 / exponent
    pace = h / time_constant_of_body
    left = min(behind, excess * (behind / pace) ** exponent)
    for _ in range(30):
        flow = pace * (left / excess) ** power
        step = (left + flow - behind) / (1.0 + power * flow / left)
        left -= step
        if step < 1e-12 * left:
            break
    return film - left if film > seen else film + left


def shift(film, seen):
    return seen - film
