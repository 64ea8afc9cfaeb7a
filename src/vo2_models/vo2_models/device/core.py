"""Compiled core: temperature and the two transitions, advanced over a piece of constant current.

Thermal model, theta = T - T0 (7.1 with the terms that the effects add; every coefficient neutral leaves
tau dtheta/dt = k1 i + k2 i^2 - theta):

    tau (1 + L ds/dT) dtheta/dt = (k1 i + k2 i^2)(1 + alpha theta) + p i theta + laser + k_s R
                                  - (1 + gamma s)(theta + beta theta |theta|^(n-1))

The step is the exponential Rosenbrock-Euler step: exact for the linear equation with held input, second
order in the other terms. Latent heat is solved for, so that the enthalpy T + L s is kept exactly.
"""

from __future__ import annotations

import math

from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.ensemble import count_above, ensemble_peek, ensemble_step
from vo2_models.device.state import Slot as S
from vo2_models.hysteresis.play_bank import middle_plays, move_plays
from vo2_models.numerics.kernel import kernel

__all__ = [
    "ENSEMBLE",
    "PLAYS",
    "advance",
    "ambient",
    "follow",
    "follows",
    "initial_transitions",
    "leading",
    "output_share",
    "warm",
]

PLAYS, ENSEMBLE = 0, 1
HOLD = 0.1
"""Pace |dT/dt| t0 / T_f up to which a film is held: the after-effect grows ten times faster than the motion forgets it."""
LATENT_TOLERANCE = 1e-4
"""Enthalpy error [K] of one step at which the search for its temperature ends; it is carried into the next step."""


@kernel
def ambient(c, time):
    """Ambient temperature [degC] at the time [s]."""
    return c[C.AMBIENT] + time * (c[C.DRIFT_RATE] + time * c[C.DRIFT_CURVATURE])


@kernel
def _laser_on(c, time):
    return c[C.LASER_FROM] <= time < c[C.LASER_UNTIL]


@kernel
def output_share(kind, which, raw, c):
    """Share 0..1 of a transition's output that has switched, which stands for its phase fraction.

    The deflection's is the fraction, as curvature is proportional to it. The resistance's is that of a logarithmic mixing law.
    """
    if kind == ENSEMBLE:
        return raw
    low, high = (C.PLAY_LOW_D, C.PLAY_HIGH_D) if which == 1 else (C.PLAY_LOW_R, C.PLAY_HIGH_R)
    return (raw - c[low]) / (c[high] - c[low])


@kernel
def _move(kind, which, v, packed, play, levels, domains, metallic, x):
    if kind == PLAYS:
        return move_plays(v, packed, play, True)
    count = ensemble_step(v, x[S.PREVIOUS_R + which], which, levels, domains, metallic, x[S.COUNT_R + which])
    x[S.COUNT_R + which] = count
    x[S.PREVIOUS_R + which] = v
    return count / metallic.shape[1]


@kernel
def _peek(kind, lead, v, packed, play, levels, domains, metallic, x):
    """Output of the transition `lead` after a move to v that is not made."""
    if kind == PLAYS:
        return move_plays(v, packed, play, False)
    count = ensemble_peek(v, x[S.PREVIOUS_R + lead], lead, levels, domains, metallic, x[S.COUNT_R + lead])
    return count / metallic.shape[1]


@kernel
def leading(kind, c, packed_r, packed_d):
    """Which transition stands for the phase in heat: the structural one, if it is known, unless the effect says otherwise.

    The lattice carries the latent heat; but what follows the electrons follows the metallic transition.
    """
    metallic = c[C.METALLIC_LEADS] > 0.5
    if kind == ENSEMBLE:
        return 0 if metallic else 1
    return 0 if packed_d[0] == 0.0 or (metallic and packed_r[0] > 0.0) else 1


@kernel
def _followed(which, equilibrium, ramp, c, x):
    """Transition output after a step at whose end its equilibrium is `equilibrium`: tau_k ds/dt = s_eq - s.

    Exact for an equilibrium that moves linearly through the step; `ramp` = (tau_k / h) (1 - exp(-h / tau_k)).
    """
    if c[C.KINETICS] <= 0.0:
        return equilibrium
    before = x[S.EQUILIBRIUM_R + which]
    left = math.exp(-x[S.LAG_STEP] / c[C.KINETICS])
    return equilibrium - (equilibrium - before) * ramp + (x[S.RAW_R + which] - before) * left


@kernel
def _fraction_at(
    kind, lead, film, ramp, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):  # fmt: skip
    """Leading phase fraction after a move of the film to the temperature `film` that is not made."""
    v = film + lead * c[C.TRANSITION_OFFSET]
    if lead == 1:
        raw = _peek(kind, lead, v, packed_d, play_d, levels, domains, metallic, x)
    else:
        raw = _peek(kind, lead, v, packed_r, play_r, levels, domains, metallic, x)
    return output_share(kind, lead, _followed(lead, raw, ramp, c, x), c)


@kernel
def _among_neighbours(
    kind, which, film, ramp, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):  # fmt: skip
    """Temperature that a transition feels with its own output fed back: T + kappa (s - 1/2).

    A moving Preisach model feeds back the output of the same operator.
    """
    if kind == PLAYS and (packed_d[0] if which == 1 else packed_r[0]) == 0.0:
        return film
    felt = film + c[C.INCONGRUENCY] * (output_share(kind, which, x[S.OUT_R + which], c) - 0.5)
    for _ in range(4):
        v = felt + which * c[C.TRANSITION_OFFSET]
        packed, play = (packed_d, play_d) if which == 1 else (packed_r, play_r)
        raw = _peek(kind, which, v, packed, play, levels, domains, metallic, x)
        there = output_share(kind, which, _followed(which, raw, ramp, c, x), c)
        before = felt
        felt = film + c[C.INCONGRUENCY] * (there - 0.5)
        if felt == before:
            break
    return felt


@kernel
def initial_transitions(kind, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic):
    """Start from a long rest in the insulating phase at the ambient temperature; memory as given."""
    rest = ambient(c, 0.0)
    if _laser_on(c, -c[C.SAMPLE_PERIOD]):
        rest += c[C.LASER]
        x[S.SLOW] = c[C.LASER]
    x[S.FAST] = rest
    x[S.STAGE] = rest
    if _laser_on(c, -c[C.SAMPLE_PERIOD]):
        rest += c[C.LASER_FILM]
    x[S.FILM] = rest
    x[S.TURN] = rest
    x[S.ANCHOR] = rest
    x[S.BAND] = rest - c[C.REVERSIBLE_BAND]
    x[S.PREVIOUS_R] = -1e6
    x[S.PREVIOUS_D] = -1e6
    x[S.RAW_R] = _move(kind, 0, rest, packed_r, play_r, levels, domains, metallic, x)
    x[S.RAW_D] = _move(kind, 1, rest + c[C.TRANSITION_OFFSET], packed_d, play_d, levels, domains, metallic, x)
    x[S.EQUILIBRIUM_R] = x[S.RAW_R]
    x[S.EQUILIBRIUM_D] = x[S.RAW_D]
    x[S.OUT_R] = x[S.RAW_R]
    x[S.OUT_D] = x[S.RAW_D]
    lead = leading(kind, c, packed_r, packed_d)
    x[S.FRACTION] = output_share(kind, lead, x[S.OUT_R + lead], c)


@kernel
def _count_reversals(c, x, film):
    """Zigzag count of turning points whose excursion is large enough."""
    direction = x[S.DIRECTION]
    if direction == 0.0:
        if abs(film - x[S.TURN]) > c[C.TRAINING_EXCURSION]:
            x[S.DIRECTION] = 1.0 if film > x[S.TURN] else -1.0
            x[S.TURN] = film
    elif (film - x[S.TURN]) * direction > 0.0:
        x[S.TURN] = film
    elif abs(film - x[S.TURN]) > c[C.TRAINING_EXCURSION]:
        x[S.DIRECTION] = -direction
        x[S.TURN] = film
        x[S.REVERSALS] += 1.0


@kernel
def _relax(c, x, film, h):
    """Advance the after-effect y by a step: dy/dt = (d / t0) exp(-d y) - (y / T_f) |dT/dt|.

    At rest y = d ln(1 + t / t0). A film that moves forgets it: what switches next is decided by the temperature again.
    d is the way of the last motion, +1 or -1; one that would take ten times t0 to forget y is a hold and does not
    change it. Exact but for the order: half of the forgetting, the growth, the other half.
    """
    travel = film - x[S.ANCHOR]
    x[S.ANCHOR] = film
    if abs(travel) * c[C.RELAXATION_TIME] > HOLD * c[C.RELAXATION_TRAVEL] * h:
        x[S.WAY] = 1.0 if travel > 0.0 else -1.0
    half = math.exp(-0.5 * abs(travel) / c[C.RELAXATION_TRAVEL])
    kept = x[S.WAY] * x[S.RELAXED] * half
    x[S.RELAXED] = x[S.WAY] * (kept + math.log1p(h / c[C.RELAXATION_TIME] * math.exp(-kept))) * half


@kernel
def _heat(c, x, current, h, time, background):
    """Heat taken up in the step, as temperature rise [K] without latent heat; the slow mode moves along."""
    theta = x[S.FAST] - background
    joule = c[C.LINEAR_GAIN] * current + c[C.SQUARE_GAIN] * current * current
    pump = joule * c[C.HEATER_TCR] + c[C.PUMPING] * current
    drive = joule + c[C.SENSE] * x[S.RESISTANCE]
    if _laser_on(c, time):
        drive += c[C.LASER]
    # the fraction in the middle of the step, if it goes on as in the step before
    conductance = 1.0 + c[C.PHASE_LOSS] * (x[S.FRACTION] + 0.5 * x[S.LAST_CHANGE])
    bend = 0.0
    if c[C.LOSS] != 0.0:
        bend = c[C.LOSS] * abs(theta) ** (c[C.LOSS_EXPONENT] - 1.0)
    surplus = drive + pump * theta - conductance * theta * (1.0 + bend)
    rate = conductance * (1.0 + c[C.LOSS_EXPONENT] * bend) - pump
    if c[C.LATENT] != 0.0 and surplus * x[S.LAST_HEAT] > 0.0:
        # on the same branch as in the step before, latent heat slows the relaxation by what it did there
        rate /= 1.0 + c[C.LATENT] * x[S.SLOPE]
    tau = c[C.TIME_CONSTANT]
    if surplus < 0.0:
        tau *= 1.0 + c[C.COOLING_RATIO]
    if rate != x[S.LAG_RATE] or tau != x[S.LAG_TIME] or h != x[S.LAG_STEP]:
        x[S.LAG_RATE] = rate
        x[S.LAG_TIME] = tau
        x[S.LAG_STEP] = h
        x[S.LAG_DECAY] = -math.expm1(-rate * h / tau) / rate if abs(rate) > 1e-6 else h / tau
    if c[C.SLOW_SHARE] != 0.0:
        x[S.SLOW] += -math.expm1(-h / c[C.SLOW_TIME]) * (drive - x[S.SLOW])
    return surplus * x[S.LAG_DECAY]


@kernel
def _solve_latent(
    kind, lead, c, x, heat, ramp, slope, rest, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):
    """Temperature of the fast mode at which the heat is spent on temperature and phase on this branch.

    The film is at slope * fast + rest. Root of fast + L s(fast) between no and full temperature change
    (Illinois); what is left over is carried into the next step.
    """
    s = x[S.FRACTION]
    low = x[S.FAST]
    f_low = -heat
    fast = low + heat
    there = _fraction_at(
        kind,
        lead,
        slope * fast + rest,
        ramp,
        c,
        x,
        packed_r,
        packed_d,
        play_r,
        play_d,
        levels,
        domains,
        metallic,
    )
    high = fast
    f_high = c[C.LATENT] * (there - s)
    if f_high * heat <= 0.0:
        return fast
    for _ in range(4):
        fast = high - f_high * (high - low) / (f_high - f_low)
        there = _fraction_at(
            kind, lead, slope * fast + rest, ramp, c, x, packed_r, packed_d, play_r, play_d, levels, domains,
            metallic,
        )  # fmt: skip
        value = fast - x[S.FAST] - heat + c[C.LATENT] * (there - s)
        if abs(value) < LATENT_TOLERANCE:
            break
        if value * f_high < 0.0:
            low = high
            f_low = f_high
        else:
            f_low *= 0.5
        high = fast
        f_high = value
    return fast


@kernel
def _film_extra(c, x, time):
    """How far the film is above its stage [K]."""
    extra = c[C.SENSE_FILM] * x[S.RESISTANCE]
    if _laser_on(c, time):
        extra += c[C.LASER_FILM]
    return extra


@kernel
def _bring(c, x, fast, background, film_extra):
    """Bring the film to where the fast mode is at `fast`; return what the transitions see of it [degC]."""
    # stage rise = (1 - share + gain) fast rise + share slow; the film sits a little above its stage
    share = c[C.SLOW_SHARE]
    x[S.FAST] = fast
    x[S.STAGE] = fast + (c[C.SLOW_GAIN] - share) * (fast - background) + share * x[S.SLOW]
    film = x[S.STAGE] + film_extra
    x[S.FILM] = film
    if c[C.TRAINING] != 0.0:
        _count_reversals(c, x, film)
    return film + c[C.TRAINING] * x[S.REVERSALS]


@kernel
def follows(kind, c):
    """Whether the transitions only follow the film: nothing but their last input and the turns on the way decides."""
    return kind == PLAYS and (
        c[C.LATENT] == 0.0
        and c[C.PHASE_LOSS] == 0.0
        and c[C.SENSE] == 0.0
        and c[C.SENSE_FILM] == 0.0
        and c[C.INCONGRUENCY] == 0.0
        and c[C.KINETICS] == 0.0
        and c[C.RELAXATION] == 0.0
        and c[C.REVERSIBLE] == 0.0
        and c[C.REVERSIBLE_SHARE] == 0.0
    )


@kernel
def warm(c, x, current, h, time):
    """Advance the temperature alone by h [s]; return what the transitions see of it [degC]. Where `follows` holds."""
    background = ambient(c, time)
    fast = x[S.FAST] + _heat(c, x, current, h, time, background)
    return _bring(c, x, fast, background, _film_extra(c, x, time))


@kernel
def follow(c, x, effective, packed_r, packed_d, play_r, play_d):
    """Bring the transitions to an input [degC]. Where `follows` holds."""
    x[S.RAW_R] = move_plays(effective, packed_r, play_r, True)
    x[S.RAW_D] = move_plays(effective + c[C.TRANSITION_OFFSET], packed_d, play_d, True)
    x[S.EQUILIBRIUM_R] = x[S.RAW_R]
    x[S.EQUILIBRIUM_D] = x[S.RAW_D]
    x[S.OUT_R] = x[S.RAW_R]
    x[S.OUT_D] = x[S.RAW_D]


@kernel
def advance(kind, c, x, current, h, time, packed_r, packed_d, play_r, play_d, levels, domains, metallic):
    """Advance temperature and transitions by h [s] under a held current [A]; `time` [s] at the start."""
    lead = leading(kind, c, packed_r, packed_d)
    s = x[S.FRACTION]
    background = ambient(c, time)
    heat = _heat(c, x, current, h, time, background) + x[S.CARRY]
    film_extra = _film_extra(c, x, time)
    ramp = 0.0
    if c[C.KINETICS] > 0.0:
        ramp = -math.expm1(-h / c[C.KINETICS]) * c[C.KINETICS] / h
    before = x[S.FAST]
    fast = before + heat
    if c[C.LATENT] != 0.0:
        kept = 1.0 - c[C.SLOW_SHARE] + c[C.SLOW_GAIN]
        rest = c[C.SLOW_SHARE] * x[S.SLOW] + (1.0 - kept) * background + film_extra
        rest += c[C.TRAINING] * x[S.REVERSALS]
        fast = _solve_latent(
            kind, lead, c, x, heat, ramp, kept, rest, packed_r, packed_d, play_r, play_d, levels, domains,
            metallic,
        )  # fmt: skip
    effective = _bring(c, x, fast, background, film_extra)
    # --- transitions
    effective_d = effective
    if c[C.INCONGRUENCY] != 0.0:
        seen = effective
        effective = _among_neighbours(
            kind, 0, seen, ramp, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
        )
        effective_d = _among_neighbours(
            kind, 1, seen, ramp, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
        )
    raw_r = _move(kind, 0, effective, packed_r, play_r, levels, domains, metallic, x)
    raw_d = _move(
        kind, 1, effective_d + c[C.TRANSITION_OFFSET], packed_d, play_d, levels, domains, metallic, x
    )
    followed_r = _followed(0, raw_r, ramp, c, x)
    followed_d = _followed(1, raw_d, ramp, c, x)
    x[S.EQUILIBRIUM_R] = raw_r
    x[S.EQUILIBRIUM_D] = raw_d
    x[S.RAW_R] = followed_r
    x[S.RAW_D] = followed_d
    x[S.OUT_R] = followed_r
    x[S.OUT_D] = followed_d
    if c[C.RELAXATION] != 0.0 or c[C.REVERSIBLE] != 0.0 or c[C.REVERSIBLE_SHARE] != 0.0:
        _add_reversible(kind, c, x, x[S.FILM], effective, effective_d, h, packed_r, packed_d, levels)
    if c[C.FEEDBACK] != 0.0:
        x[S.FRACTION] = output_share(kind, lead, x[S.OUT_R + lead], c)
        x[S.LAST_CHANGE] = x[S.FRACTION] - s
    if c[C.LATENT] != 0.0:
        x[S.LAST_HEAT] = heat
        x[S.SLOPE] = max((x[S.FRACTION] - s) / (fast - before), 0.0) if abs(fast - before) > 1e-6 else 0.0
        x[S.CARRY] = heat - (fast - before) - c[C.LATENT] * (x[S.FRACTION] - s)


@kernel
def _span(kind, which, c):
    """Lowest output of a transition, and how much it grows from there to the highest."""
    if kind == ENSEMBLE:
        return 0.0, 1.0
    if which == 0:
        return c[C.PLAY_LOW_R], c[C.PLAY_HIGH_R] - c[C.PLAY_LOW_R]
    return c[C.PLAY_LOW_D], c[C.PLAY_HIGH_D] - c[C.PLAY_LOW_D]


@kernel
def _anhysteretic(kind, which, v, packed, levels):
    """Output half way between the two major branches at the temperature v."""
    if kind == ENSEMBLE:
        return 0.5 * (count_above(levels, which, 0, v) + count_above(levels, which, 1, v)) / levels.shape[2]
    return middle_plays(v, packed)


@kernel
def _add_reversible(kind, c, x, film, effective, effective_d, h, packed_r, packed_d, levels):
    """What each transition does beside switching: drift at holds, and reversible change inside the loop."""
    if c[C.RELAXATION] != 0.0:
        _relax(c, x, film, h)
    if c[C.REVERSIBLE] != 0.0:
        width = c[C.REVERSIBLE_BAND]
        x[S.BAND] = min(max(x[S.BAND], film - width), film + width)
    for which in range(2):
        packed = packed_r if which == 0 else packed_d
        low, span = _span(kind, which, c)
        if span == 0.0:
            continue
        raw = x[S.RAW_R + which]
        inside = min(max((raw - low) / span, 0.0), 1.0)
        half_way = 4.0 * inside * (1.0 - inside)
        added = 0.0
        if c[C.RELAXATION] != 0.0:
            added += c[C.RELAXATION] * half_way * x[S.RELAXED]
        if c[C.REVERSIBLE] != 0.0:
            added += c[C.REVERSIBLE] * (film - x[S.BAND]) * half_way
        if c[C.REVERSIBLE_SHARE] != 0.0:
            v = effective if which == 0 else effective_d + c[C.TRANSITION_OFFSET]
            added += c[C.REVERSIBLE_SHARE] * (_anhysteretic(kind, which, v, packed, levels) - raw) / span
        out = x[S.OUT_R + which] + added * span
        x[S.OUT_R + which] = min(max(out, 0.0), 1.0) if kind == ENSEMBLE else out
