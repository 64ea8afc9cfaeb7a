"""Compiled core: temperature and the two transitions, advanced over a piece of constant current.

Thermal model (7.1), theta = T - T0, with the terms that effects add by their hooks (every effect off leaves
tau dtheta/dt = k1 i + k2 i^2 - theta):

    tau lag (1 + latent ds/dT) dtheta/dt = k1 i + k2 i^2 + heating + pumping theta - (1 + conductance) theta (1 + loss)

A film that is its own heater adds P to the drive, in proportion to V^2 / R or I^2 R with its resistance of the step before; of
any rise a share can arrive through a second, slower lag.

The step is the exponential Rosenbrock-Euler step: exact for the linear equation with held input, second
order in the other terms. Latent heat is solved for, so that the enthalpy T + L s is kept exactly.
"""

from __future__ import annotations

import math

import numba

from vo2_models.device import generated
from vo2_models.device.assembly import FLAGS
from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.coefficients import first_flag
from vo2_models.device.ensemble import count_above, ensemble_peek, ensemble_step
from vo2_models.device.law_step import has_law, middle, move, reversible
from vo2_models.device.state import Slot as S

__all__ = [
    "ENSEMBLE",
    "PLAYS",
    "advance",
    "initial_transitions",
    "keep_reversible",
    "output_share",
    "own_heat",
    "seen_temperature",
    "step_temperature",
    "step_transitions",
]

PLAYS, ENSEMBLE = 0, 1
_FEEDBACK, _BESIDE, _MIDDLE, _CONDUCTANCE, _HEATED, _SHIFTED, _PHASE = (
    first_flag() + FLAGS.index(name)
    for name in ("feedback", "beside", "middle", "conductance", "any:heat", "any:film", "any:phase")
)
# only what the chain calls from outside is kept in the cache: this is part of it
inner = numba.njit(error_model="numpy")
inside = numba.njit(error_model="numpy", forceinline=True)
LATENT_TOLERANCE = 1e-4
"""Enthalpy error [K] of one step at which the search for its temperature ends; it is carried into the next step."""


@inside
def _background(c, x, time):
    """Ambient temperature [degC] at the time [s]."""
    return c[C.AMBIENT] + generated.ambient(c, x, time)


@inner
def output_share(kind, which, raw, c):
    """Share 0..1 of a transition's output that has switched, which stands for its phase fraction.

    The deflection's is the fraction, as curvature is proportional to it. The resistance's is that of a logarithmic mixing law.
    """
    if kind == ENSEMBLE:
        return raw
    low, high = (C.PLAY_LOW_D, C.PLAY_HIGH_D) if which == 1 else (C.PLAY_LOW_R, C.PLAY_HIGH_R)
    return (raw - c[low]) / (c[high] - c[low])


@inner
def _move(kind, which, v, packed, play, levels, domains, metallic, x):
    if kind == PLAYS:
        return move(v, packed, play, True)
    count = ensemble_step(v, x[S.PREVIOUS_R + which], which, levels, domains, metallic, x[S.COUNT_R + which])
    x[S.COUNT_R + which] = count
    x[S.PREVIOUS_R + which] = v
    return count / metallic.shape[1]


@inner
def _peek(kind, lead, v, packed, play, levels, domains, metallic, c, x):
    """Output of the transition `lead` after a move to v that is not made."""
    if kind == PLAYS:
        return move(v, packed, play, False) - (reversible(v, packed) if c[_PHASE] != 0.0 else 0.0)
    count = ensemble_peek(v, x[S.PREVIOUS_R + lead], lead, levels, domains, metallic, x[S.COUNT_R + lead])
    return count / metallic.shape[1]


@inner
def keep_reversible(x, packed_r, packed_d):
    """Keep what has no hysteresis at the film's temperature: effects that act on the phase alone leave it alone."""
    x[S.REVERSIBLE_R] = reversible(x[S.FILM], packed_r)
    x[S.REVERSIBLE_D] = reversible(x[S.FILM], packed_d)


@inner
def _reversible_at(v, kept, packed, x):
    """What has no hysteresis at the temperature v [degC]; `kept` : at that of the film."""
    return kept if v == x[S.FILM] else reversible(v, packed)


@inside
def _followed(which, equilibrium, c, x):
    """Transition output after a step at whose end its equilibrium is `equilibrium`."""
    return generated.follow(c, x, equilibrium, x[S.EQUILIBRIUM_R + which], x[S.RAW_R + which], x[S.LAG_STEP])


@inner
def _fraction_at(
    kind, lead, film, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):  # fmt: skip
    """Leading phase fraction after a move of the film to the temperature `film` that is not made."""
    v = film + lead * generated.structural_shift(c, x)
    if lead == 1:
        raw = _peek(kind, lead, v, packed_d, play_d, levels, domains, metallic, c, x)
    else:
        raw = _peek(kind, lead, v, packed_r, play_r, levels, domains, metallic, c, x)
    return output_share(kind, lead, _followed(lead, raw, c, x), c)


@inner
def _among_neighbours(
    kind, which, film, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):  # fmt: skip
    """Temperature that a transition feels with its own output fed back.

    A moving Preisach model feeds back the output of the same operator.
    """
    if kind == PLAYS and not (has_law(packed_d) if which == 1 else has_law(packed_r)):
        return film
    felt = film + generated.feedback(c, x, output_share(kind, which, x[S.OUT_R + which], c))
    for _ in range(4):
        v = felt + which * generated.structural_shift(c, x)
        packed, play = (packed_d, play_d) if which == 1 else (packed_r, play_r)
        raw = _peek(kind, which, v, packed, play, levels, domains, metallic, c, x)
        there = output_share(kind, which, _followed(which, raw, c, x), c)
        before = felt
        felt = film + generated.feedback(c, x, there)
        if felt == before:
            break
    return felt


@inside
def own_heat(c, x, current):
    """Steady rise [K] by the electrical power in the film, at the resistance that it had last."""
    if c[C.POWER_GAIN] == 0.0:
        return 0.0
    power = current * current
    return c[C.POWER_GAIN] * (power / x[S.RESISTANCE] if c[C.VOLTAGE] != 0.0 else power * x[S.RESISTANCE])


@inside
def _body(c, x):
    """Change of the body's temperature per kelvin of rise, and kelvins added to it: the slower lag and what effects add."""
    slope, rest = generated.body(c, x)
    return slope - c[C.SLOW_SHARE], rest + c[C.SLOW_SHARE] * x[S.SLOW]


@inner
def initial_transitions(kind, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic):
    """Start from a long rest without current, insulating; memory as given."""
    x[S.HAS_R] = 1.0 if kind == ENSEMBLE or has_law(packed_r) else 0.0
    x[S.HAS_D] = 1.0 if kind == ENSEMBLE or has_law(packed_d) else 0.0
    before = -c[C.SAMPLE_PERIOD]
    drive = generated.heating(c, x, 0.0, 0.0, 0.0, before)
    generated.settle_driver(c, x, 0.0)
    generated.settle_thermal(c, x, drive)
    x[S.SLOW] = drive
    rest = _background(c, x, 0.0) + drive
    x[S.FAST] = rest
    x[S.STAGE] = rest
    rest += generated.film(c, x, 0.0, before)
    x[S.FILM] = rest
    generated.settle_transition(c, x, rest)
    x[S.PREVIOUS_R] = -1e6
    x[S.PREVIOUS_D] = -1e6
    x[S.RAW_R] = _move(kind, 0, rest, packed_r, play_r, levels, domains, metallic, x)
    there = rest + generated.structural_shift(c, x)
    x[S.RAW_D] = _move(kind, 1, there, packed_d, play_d, levels, domains, metallic, x)
    if c[_PHASE] != 0.0:
        keep_reversible(x, packed_r, packed_d)
        x[S.RAW_R] -= x[S.REVERSIBLE_R]
        x[S.RAW_D] -= _reversible_at(there, x[S.REVERSIBLE_D], packed_d, x)
    x[S.EQUILIBRIUM_R] = x[S.RAW_R]
    x[S.EQUILIBRIUM_D] = x[S.RAW_D]
    x[S.OUT_R] = x[S.RAW_R]
    x[S.OUT_D] = x[S.RAW_D]
    for which in range(2):
        x[S.FRACTION_R + which] = output_share(kind, which, x[S.OUT_R + which], c)


@inner
def _decay(x, rate, tau, h):
    """Rise in a step of h [s] per kelvin of surplus; two are kept, as a dead time splits each sample in two steps."""
    if rate != x[S.LAG_RATE] or tau != x[S.LAG_TIME]:
        x[S.LAG_RATE] = rate
        x[S.LAG_TIME] = tau
        x[S.LAG_STEP] = 0.0
        x[S.LAG_OTHER_STEP] = 0.0
    if h != x[S.LAG_STEP]:
        step, decay = x[S.LAG_STEP], x[S.LAG_DECAY]
        x[S.LAG_STEP], x[S.LAG_DECAY] = x[S.LAG_OTHER_STEP], x[S.LAG_OTHER_DECAY]
        x[S.LAG_OTHER_STEP], x[S.LAG_OTHER_DECAY] = step, decay
        if h != x[S.LAG_STEP]:
            x[S.LAG_STEP] = h
            x[S.LAG_DECAY] = -math.expm1(-rate * h / tau) / rate if abs(rate) > 1e-6 else h / tau
    return x[S.LAG_DECAY]


@inside
def _heat(c, x, current, h, time, background):
    """Heat taken up in the step, as temperature rise [K] without latent heat; slow bodies move along."""
    theta = x[S.FAST] - background
    if c[_HEATED] == 0.0:
        drive = c[C.LINEAR_GAIN] * current + c[C.SQUARE_GAIN] * current * current
        return (drive - theta) * _decay(x, 1.0, c[C.TIME_CONSTANT], h)
    return _heat_with_effects(c, x, current, h, time, theta)


@inside
def _heat_with_effects(c, x, current, h, time, theta):
    """As `_heat`, with what effects add; theta [K] above the ambient temperature."""
    joule = c[C.LINEAR_GAIN] * current + c[C.SQUARE_GAIN] * current * current
    pump = generated.pumping(c, x, current, joule)
    drive = joule + own_heat(c, x, current) + generated.heating(c, x, current, joule, x[S.RESISTANCE], time)
    # with the fraction in the middle of the step, if it goes on as in the step before
    conductance = 1.0 + generated.conductance(c, x)
    bend, steep = generated.loss(c, x, theta)
    surplus = drive + pump * theta - conductance * theta * (1.0 + bend)
    rate = conductance * (1.0 + steep) - pump
    latent = generated.latent(c, x)
    if latent != 0.0 and surplus * x[S.LAST_HEAT] > 0.0:
        # on the same branch as in the step before, latent heat slows the relaxation by what it did there
        rate /= 1.0 + latent * x[S.SLOPE]
    tau = c[C.TIME_CONSTANT] * generated.lag(c, x, surplus)
    decay = _decay(x, rate, tau, h)
    if c[C.SLOW_SHARE] != 0.0:
        x[S.SLOW] -= math.expm1(-h / c[C.SLOW_TIME]) * (drive - x[S.SLOW])
    heat = surplus * decay
    # what flows on from the body does so behind its lag: with the rise in the middle of the step
    generated.advance_thermal(c, x, drive, theta + 0.5 * heat, h, time)
    return heat


@inside
def _solve_latent(
    kind, lead, latent, c, x, heat, slope, rest, packed_r, packed_d, play_r, play_d, levels, domains, metallic
):
    """Temperature of the fast mode at which the heat is spent on temperature and phase on this branch.

    The film is at slope * fast + rest. Root of fast + L s(fast) between no and full temperature change
    (Illinois); what is left over is carried into the next step.
    """
    s = x[S.FRACTION_R + lead]
    low = x[S.FAST]
    f_low = -heat
    fast = low + heat
    there = _fraction_at(
        kind,
        lead,
        slope * fast + rest,
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
    f_high = latent * (there - s)
    if f_high * heat <= 0.0:
        return fast
    for _ in range(4):
        fast = high - f_high * (high - low) / (f_high - f_low)
        there = _fraction_at(
            kind, lead, slope * fast + rest, c, x, packed_r, packed_d, play_r, play_d, levels, domains,
            metallic,
        )  # fmt: skip
        value = fast - x[S.FAST] - heat + latent * (there - s)
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


@inside
def _update_film(c, x, fast, background, film_extra, h):
    """Bring the film to where the thermal model is at `fast`; return what the transitions see of it [degC]."""
    x[S.FAST] = fast
    if c[_SHIFTED] == 0.0:
        x[S.STAGE] = fast
        x[S.FILM] = fast
        return fast
    return _update_film_with_effects(c, x, fast, background, film_extra, h)


@inside
def _update_film_with_effects(c, x, fast, background, film_extra, h):
    """As `_update_film`, with what effects add."""
    slope, rest = _body(c, x)
    x[S.STAGE] = fast + slope * (fast - background) + rest
    film = x[S.STAGE] + film_extra
    x[S.FILM] = film
    generated.advance_transition(c, x, film, h)
    return film + generated.shift(c, x)


@inner
def step_temperature(c, x, current, h, time):
    """Advance the temperature alone by h [s]; return what the transitions see of it [degC]. Where `FOLLOWS` is set."""
    background = _background(c, x, time)
    fast = x[S.FAST] + _heat(c, x, current, h, time, background)
    return _update_film(c, x, fast, background, generated.film(c, x, x[S.RESISTANCE], time), h)


@inner
def step_transitions(c, x, effective, packed_r, packed_d, play_r, play_d):
    """Bring the transitions to an input [degC]. Where `FOLLOWS` is set."""
    there = effective + generated.structural_shift(c, x)
    x[S.RAW_R] = move(effective, packed_r, play_r, True)
    x[S.RAW_D] = move(there, packed_d, play_d, True)
    if c[_PHASE] != 0.0:
        keep_reversible(x, packed_r, packed_d)
        x[S.RAW_R] -= _reversible_at(effective, x[S.REVERSIBLE_R], packed_r, x)
        x[S.RAW_D] -= _reversible_at(there, x[S.REVERSIBLE_D], packed_d, x)
    x[S.EQUILIBRIUM_R] = x[S.RAW_R]
    x[S.EQUILIBRIUM_D] = x[S.RAW_D]
    x[S.OUT_R] = x[S.RAW_R]
    x[S.OUT_D] = x[S.RAW_D]


@inside
def advance(kind, c, x, current, h, time, packed_r, packed_d, play_r, play_d, levels, domains, metallic):
    """Advance temperature and transitions by h [s] under a held current [A]; `time` [s] at the start."""
    background = _background(c, x, time)
    heat = _heat(c, x, current, h, time, background) + x[S.CARRY]
    film_extra = generated.film(c, x, x[S.RESISTANCE], time)
    before = x[S.FAST]
    fast = before + heat
    latent = generated.latent(c, x)
    lead = generated.lead_of_latent(c, x)
    if latent != 0.0:
        slope, rest = _body(c, x)
        rest += -slope * background + film_extra + generated.shift(c, x)
        fast = _solve_latent(
            kind, lead, latent, c, x, heat, 1.0 + slope, rest, packed_r, packed_d, play_r, play_d, levels, domains,
            metallic,
        )  # fmt: skip
    effective = _update_film(c, x, fast, background, film_extra, h)
    # --- transitions
    effective_d = effective
    if c[_FEEDBACK] != 0.0:
        seen = effective
        effective = _among_neighbours(
            kind, 0, seen, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
        )
        effective_d = _among_neighbours(
            kind, 1, seen, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic
        )
    effective_d += generated.structural_shift(c, x)
    raw_r = _move(kind, 0, effective, packed_r, play_r, levels, domains, metallic, x)
    raw_d = _move(kind, 1, effective_d, packed_d, play_d, levels, domains, metallic, x)
    if c[_PHASE] != 0.0:
        keep_reversible(x, packed_r, packed_d)
        raw_r -= _reversible_at(effective, x[S.REVERSIBLE_R], packed_r, x)
        raw_d -= _reversible_at(effective_d, x[S.REVERSIBLE_D], packed_d, x)
    followed_r = _followed(0, raw_r, c, x)
    followed_d = _followed(1, raw_d, c, x)
    x[S.EQUILIBRIUM_R] = raw_r
    x[S.EQUILIBRIUM_D] = raw_d
    x[S.RAW_R] = followed_r
    x[S.RAW_D] = followed_d
    x[S.OUT_R] = followed_r
    x[S.OUT_D] = followed_d
    if c[_BESIDE] != 0.0:
        _add_beside(kind, c, x, effective, effective_d, packed_r, packed_d, levels)
    if c[C.FEEDBACK] != 0.0:
        s = x[S.FRACTION_R + lead]
        for which in range(2):
            if which == lead or c[_CONDUCTANCE] != 0.0:
                old = x[S.FRACTION_R + which]
                x[S.FRACTION_R + which] = output_share(kind, which, x[S.OUT_R + which], c)
                x[S.LAST_CHANGE_R + which] = x[S.FRACTION_R + which] - old
        if latent != 0.0:
            x[S.LAST_HEAT] = heat
            change = x[S.FRACTION_R + lead] - s
            x[S.SLOPE] = max(change / (fast - before), 0.0) if abs(fast - before) > 1e-6 else 0.0
            x[S.CARRY] = heat - (fast - before) - latent * change


@inner
def _span(kind, which, c):
    """Lowest output of a transition, and how much it grows from there to the highest."""
    if kind == ENSEMBLE:
        return 0.0, 1.0
    if which == 0:
        return c[C.PLAY_LOW_R], c[C.PLAY_HIGH_R] - c[C.PLAY_LOW_R]
    return c[C.PLAY_LOW_D], c[C.PLAY_HIGH_D] - c[C.PLAY_LOW_D]


@inner
def _anhysteretic(kind, which, v, packed, c, levels):
    """Output half way between the two major branches at the temperature v."""
    if kind == ENSEMBLE:
        return 0.5 * (count_above(levels, which, 0, v) + count_above(levels, which, 1, v)) / levels.shape[2]
    return middle(v, packed) - (reversible(v, packed) if c[_PHASE] != 0.0 else 0.0)


@inner
def _add_beside(kind, c, x, effective, effective_d, packed_r, packed_d, levels):
    """What each transition does beside switching."""
    for which in range(2):
        packed = packed_r if which == 0 else packed_d
        low, span = _span(kind, which, c)
        if span == 0.0:
            continue
        raw = x[S.RAW_R + which]
        inside = min(max((raw - low) / span, 0.0), 1.0)
        middle = 0.0
        if c[_MIDDLE] != 0.0:
            v = effective if which == 0 else effective_d
            middle = (_anhysteretic(kind, which, v, packed, c, levels) - raw) / span
        added = generated.beside(c, x, 4.0 * inside * (1.0 - inside), x[S.FILM], middle)
        out = x[S.OUT_R + which] + added * span
        x[S.OUT_R + which] = min(max(out, 0.0), 1.0) if kind == ENSEMBLE else out


@inner
def seen_temperature(kind, c, x, film, out_r, out_d, h):
    """What each transition sees of a film [degC] whose outputs are known: with shifts and its own output fed back."""
    x[S.FILM] = film
    generated.advance_transition(c, x, film, h)
    both = film + generated.shift(c, x)
    seen_r, seen_d = both, both + generated.structural_shift(c, x)
    if c[_FEEDBACK] != 0.0:
        if x[S.HAS_R] != 0.0:
            seen_r += generated.feedback(c, x, output_share(kind, 0, out_r, c))
        if x[S.HAS_D] != 0.0:
            seen_d += generated.feedback(c, x, output_share(kind, 1, out_d, c))
    return seen_r, seen_d
