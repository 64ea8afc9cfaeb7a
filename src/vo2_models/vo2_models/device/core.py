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

from numba import njit

from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.ensemble import ensemble_peek, ensemble_step
from vo2_models.device.state import Slot as S
from vo2_models.hysteresis.kernels import egpi_step

__all__ = ["ENSEMBLE", "PLAYS", "advance", "ambient", "fraction_of", "initial_transitions", "leading"]

PLAYS, ENSEMBLE = 0, 1
LATENT_TOLERANCE = 1e-4
"""Enthalpy error [K] of one step at which the search for its temperature ends; it is carried into the next step."""
HOLD_BAND = 0.3
"""A temperature within this distance [K] of where it came to rest counts as held."""
ERASE = 2.0
"""Travel [K] over which a relaxed fraction is forgotten to 1/e."""


@njit(cache=True, error_model="numpy")
def ambient(c, time):
    """Ambient temperature [degC] at the time [s]."""
    value = c[C.AMBIENT] + c[C.DRIFT_RATE] * time
    if c[C.DRIFT_AMPLITUDE] != 0.0:
        value += c[C.DRIFT_AMPLITUDE] * math.sin(2.0 * math.pi * time / c[C.DRIFT_PERIOD])
    return value


@njit(cache=True, error_model="numpy")
def fraction_of(kind, which, raw, c):
    """Phase fraction 0..1 that a transition output stands for.

    Play bank of the resistance: the log conductance is turned into the metallic fraction by the symmetric
    effective-medium law in two dimensions; of the deflection: curvature is proportional to the fraction.
    """
    if kind == ENSEMBLE:
        return raw
    if which == 1:
        return (raw - c[C.PLAY_LOW_D]) / (c[C.PLAY_HIGH_D] - c[C.PLAY_LOW_D])
    conductivity = 10.0 ** (raw - c[C.PLAY_LOW_R])
    contrast = 10.0 ** (c[C.PLAY_HIGH_R] - c[C.PLAY_LOW_R])
    above = (conductivity - 1.0) / (conductivity + 1.0)
    below = (contrast - conductivity) / (contrast + conductivity)
    return above / (above + below)


@njit(cache=True, error_model="numpy")
def _move(kind, which, v, packed, play, levels, domains, metallic, x):
    if kind == PLAYS:
        return egpi_step(v, packed, play)
    count = ensemble_step(
        v, x[S.PREVIOUS_R + which], levels[which], domains[which], metallic[which], int(x[S.COUNT_R + which])
    )
    x[S.COUNT_R + which] = count
    x[S.PREVIOUS_R + which] = v
    return count / metallic.shape[1]


@njit(cache=True, error_model="numpy")
def _peek(kind, lead, v, packed, play, scratch, levels, domains, metallic, x):
    """Output of the transition `lead` after a move to v that is not made."""
    if kind == PLAYS:
        view = scratch[: play.size]
        view[:] = play
        return egpi_step(v, packed, view)
    count = ensemble_peek(
        v, x[S.PREVIOUS_R + lead], levels[lead], domains[lead], metallic[lead], int(x[S.COUNT_R + lead])
    )
    return count / metallic.shape[1]


@njit(cache=True, error_model="numpy")
def leading(kind, packed_d):
    """Which transition stands for the phase in heat and feedback: the structural one where it is known.

    The lattice carries the latent heat, and deflection is proportional to its fraction whatever law mixes
    the resistances.
    """
    return 1 if kind == ENSEMBLE or packed_d[0] > 0.0 else 0


@njit(cache=True, error_model="numpy")
def _fraction_at(kind, lead, film, follow, c, x, packed, play, scratch, levels, domains, metallic):
    """Leading phase fraction after a move of the film to the temperature `film` that is not made."""
    v = film + lead * c[C.TRANSITION_OFFSET]
    raw = _peek(kind, lead, v, packed, play, scratch, levels, domains, metallic, x)
    raw = x[S.RAW_R + lead] + follow * (raw - x[S.RAW_R + lead])
    return fraction_of(kind, lead, raw, c)


@njit(cache=True, error_model="numpy")
def initial_transitions(kind, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic):
    """Start from a long rest in the insulating phase at the ambient temperature; memory as given."""
    rest = ambient(c, 0.0)
    x[S.BACKGROUND] = rest
    if c[C.LASER_FROM] < 0.0:
        rest += c[C.LASER]
    x[S.FAST] = rest
    x[S.SLOW] = c[C.LASER] if c[C.LASER_FROM] < 0.0 else 0.0
    x[S.STAGE] = rest
    if c[C.LASER_FROM] < 0.0:
        rest += c[C.LASER_FILM]
    x[S.FILM] = rest
    x[S.TURN] = rest
    x[S.ANCHOR] = rest
    x[S.BAND] = rest - c[C.REVERSIBLE_BAND]
    x[S.PREVIOUS_R] = -1e6
    x[S.PREVIOUS_D] = -1e6
    x[S.RAW_R] = _move(kind, 0, rest, packed_r, play_r, levels, domains, metallic, x)
    x[S.RAW_D] = _move(kind, 1, rest + c[C.TRANSITION_OFFSET], packed_d, play_d, levels, domains, metallic, x)
    x[S.OUT_R] = x[S.RAW_R]
    x[S.OUT_D] = x[S.RAW_D]
    lead = leading(kind, packed_d)
    x[S.FRACTION] = fraction_of(kind, lead, x[S.OUT_R + lead], c)


@njit(cache=True, error_model="numpy")
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


@njit(cache=True, error_model="numpy")
def _relax(c, x, film, h):
    """Logarithmic after-effect: the fraction drifts on while the temperature is held, and is erased by travel."""
    s = min(max(x[S.FRACTION], 0.0), 1.0)
    travel = film - x[S.ANCHOR]
    if abs(travel) > HOLD_BAND:
        x[S.DRIFT] *= math.exp(-abs(travel) / ERASE)
        x[S.HOLD_SIGN] = 1.0 if travel > 0.0 else -1.0
        x[S.ANCHOR] = film
        x[S.HELD] = 0.0
    else:
        before = x[S.HELD]
        x[S.HELD] = before + h
        growth = math.log((c[C.RELAXATION_TIME] + before + h) / (c[C.RELAXATION_TIME] + before))
        x[S.DRIFT] += x[S.HOLD_SIGN] * c[C.RELAXATION] * 4.0 * s * (1.0 - s) * growth


@njit(cache=True, error_model="numpy")
def advance(
    kind, c, x, current, h, packed_r, packed_d, play_r, play_d, scratch, levels, domains, metallic, time
):
    """Advance temperature and transitions by h [s] under a held current [A]; `time` [s] at the start."""
    laser = c[C.LASER] if time >= c[C.LASER_FROM] else 0.0
    background = ambient(c, time)
    x[S.BACKGROUND] = background
    theta = x[S.FAST] - background
    s = x[S.FRACTION]
    # --- heat
    joule = c[C.LINEAR_GAIN] * current + c[C.SQUARE_GAIN] * current * current
    pump = joule * c[C.HEATER_TCR] + c[C.PUMPING] * current
    extra = laser + c[C.SENSE] * x[S.RESISTANCE]
    conductance = 1.0 + c[C.PHASE_LOSS] * s
    loss = theta
    stiffness = 1.0
    if c[C.LOSS] != 0.0:
        bend = c[C.LOSS] * abs(theta) ** (c[C.LOSS_EXPONENT] - 1.0)
        loss = theta * (1.0 + bend)
        stiffness = 1.0 + c[C.LOSS_EXPONENT] * bend
    drive = joule + extra
    surplus = drive + pump * theta - conductance * loss
    rate = conductance * stiffness - pump
    tau = c[C.TIME_CONSTANT]
    if surplus < 0.0:
        tau *= 1.0 + c[C.COOLING_RATIO]
    if rate != x[S.LAG_RATE] or tau != x[S.LAG_TIME] or h != x[S.LAG_STEP]:
        x[S.LAG_RATE] = rate
        x[S.LAG_TIME] = tau
        x[S.LAG_STEP] = h
        x[S.LAG_DECAY] = -math.expm1(-rate * h / tau) / rate if rate > 1e-6 else h / tau
    heat = surplus * x[S.LAG_DECAY] + x[S.CARRY]
    # --- slow thermal mode, side by side with the fast one
    if c[C.SLOW_SHARE] != 0.0:
        x[S.SLOW] += -math.expm1(-h / c[C.SLOW_TIME]) * (drive - x[S.SLOW])
    # --- temperature of the film above its stage
    film_extra = c[C.SENSE_FILM] * x[S.RESISTANCE]
    if time >= c[C.LASER_FROM]:
        film_extra += c[C.LASER_FILM]
    shift = c[C.TRAINING] * x[S.REVERSALS]
    follow = 1.0
    if c[C.KINETICS] > 0.0:
        follow = -math.expm1(-h / c[C.KINETICS])
    fast = x[S.FAST] + heat
    lead = leading(kind, packed_d)
    bank = packed_d if lead == 1 else packed_r
    play = play_d if lead == 1 else play_r
    if c[C.LATENT] != 0.0 and heat != 0.0:
        # enthalpy balance on this branch, root between no and full temperature change (Illinois)
        rest = c[C.SLOW_SHARE] * (x[S.SLOW] + background) + film_extra + shift
        slope = 1.0 - c[C.SLOW_SHARE]
        low, f_low = x[S.FAST], -heat
        high = fast
        f_high = c[C.LATENT] * (
            _fraction_at(
                kind, lead, slope * high + rest, follow, c, x, bank, play, scratch, levels, domains, metallic
            )
            - s
        )
        if f_high * heat > 0.0:
            for _ in range(4):
                fast = high - f_high * (high - low) / (f_high - f_low)
                there = _fraction_at(
                    kind,
                    lead,
                    slope * fast + rest,
                    follow,
                    c,
                    x,
                    bank,
                    play,
                    scratch,
                    levels,
                    domains,
                    metallic,
                )
                value = fast - x[S.FAST] - heat + c[C.LATENT] * (there - s)
                if abs(value) < LATENT_TOLERANCE:
                    break
                if value * f_high < 0.0:
                    low, f_low = high, f_high
                else:
                    f_low *= 0.5
                high, f_high = fast, value
    before = x[S.FAST]
    x[S.FAST] = fast
    stage = fast + c[C.SLOW_SHARE] * (x[S.SLOW] - (fast - background))
    film = stage + film_extra
    x[S.STAGE] = stage
    x[S.FILM] = film
    # --- transitions
    if c[C.TRAINING] != 0.0:
        _count_reversals(c, x, film)
        shift = c[C.TRAINING] * x[S.REVERSALS]
    effective = film + shift
    if c[C.INCONGRUENCY] != 0.0:
        guess = effective + c[C.INCONGRUENCY] * (s - 0.5)
        for _ in range(4):
            there = _fraction_at(
                kind, lead, guess, follow, c, x, bank, play, scratch, levels, domains, metallic
            )
            guess = effective + c[C.INCONGRUENCY] * (there - 0.5)
        effective = guess
    raw_r = _move(kind, 0, effective, packed_r, play_r, levels, domains, metallic, x)
    raw_d = _move(kind, 1, effective + c[C.TRANSITION_OFFSET], packed_d, play_d, levels, domains, metallic, x)
    if follow < 1.0:
        raw_r = x[S.RAW_R] + follow * (raw_r - x[S.RAW_R])
        raw_d = x[S.RAW_D] + follow * (raw_d - x[S.RAW_D])
    x[S.RAW_R] = raw_r
    x[S.RAW_D] = raw_d
    span_r = 1.0
    span_d = 1.0
    if kind == PLAYS:
        span_r = c[C.PLAY_HIGH_R] - c[C.PLAY_LOW_R]
        span_d = c[C.PLAY_HIGH_D] - c[C.PLAY_LOW_D]
    added = 0.0
    if c[C.RELAXATION] != 0.0:
        _relax(c, x, film, h)
        added += x[S.DRIFT]
    if c[C.REVERSIBLE] != 0.0:
        width = c[C.REVERSIBLE_BAND]
        x[S.BAND] = min(max(x[S.BAND], film - width), film + width)
        inside = min(max(fraction_of(kind, lead, x[S.RAW_R + lead], c), 0.0), 1.0)
        added += c[C.REVERSIBLE] * (film - x[S.BAND]) * 4.0 * inside * (1.0 - inside)
    x[S.OUT_R] = raw_r + span_r * added
    x[S.OUT_D] = raw_d + span_d * added
    if kind == ENSEMBLE and added != 0.0:
        x[S.OUT_R] = min(max(x[S.OUT_R], 0.0), 1.0)
        x[S.OUT_D] = min(max(x[S.OUT_D], 0.0), 1.0)
    if c[C.FEEDBACK] != 0.0:
        x[S.FRACTION] = fraction_of(kind, lead, x[S.OUT_R + lead], c)
    if c[C.LATENT] != 0.0:
        x[S.CARRY] = heat - (fast - before) - c[C.LATENT] * (x[S.FRACTION] - s)
