"""Compiled chain: driver, core, structure and sensors of one device, sample by sample.

One loop serves the batch and the stream: a stream is a batch of one sample at a time on the same state. What effects
add at each stage is in `device.generated`, made from their files.
"""

from __future__ import annotations

import math

from vo2_models.device import generated
from vo2_models.device.assembly import FLAGS
from vo2_models.device.borrow import borrow
from vo2_models.device.coefficients import CHANNELS, Sensor, first_flag
from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.coefficients import Sensor as N
from vo2_models.device.core import (
    ENSEMBLE,
    advance,
    initial_transitions,
    inner,
    keep_reversible,
    output_share,
    own_heat,
    seen_temperature,
    step_temperature,
    step_transitions,
)
from vo2_models.device.laws import polynomial, truth_deflection, truth_resistance
from vo2_models.device.state import CURRENT_LINE
from vo2_models.device.state import Slot as S
from vo2_models.numerics.kernel import kernel

__all__ = [
    "COLUMNS",
    "bring_to_rest",
    "finish_film",
    "late_correction",
    "run_chain",
    "see_film",
    "through_linear_structure",
    "through_sensor",
]

COLUMNS = 9
"""Columns of the output: the four sensor channels, then true deflection [m], film temperature [degC], true
resistance [ohm], and the two transition outputs."""
_SENSORS, _PER_CHANNEL, _COUNT = len(C), len(Sensor), len(CHANNELS)
_NOISE = len(S)
_RESISTANCE, _BENDING, _PHASE = (
    first_flag() + FLAGS.index(name) for name in ("resistance", "bending", "any:phase")
)
LN10 = math.log(10.0)
# the delay line is a ring whose length is a power of two
_LINE = CURRENT_LINE - 1


@inner
def _driver(c, x, command, time, period):
    """Source: its range, then what effects make of it."""
    i = min(max(command, c[C.RANGE_LOW]), c[C.RANGE_HIGH])
    i = generated.drive(c, x, i, x[S.CURRENT], time, period)
    x[S.CURRENT] = i
    return i


@inner
def _film_resistance(kind, c, x, poly_r):
    if kind == ENSEMBLE:
        return truth_resistance(c, x[S.FILM], x[S.OUT_R])
    return math.exp(-LN10 * (x[S.OUT_R] + x[S.REVERSIBLE_R] + polynomial(poly_r, x[S.FILM])))


@inner
def _film_deflection(kind, c, x, poly_d):
    value = x[S.OUT_D] + x[S.REVERSIBLE_D] + polynomial(poly_d, x[S.FILM])
    if kind == ENSEMBLE:
        value = truth_deflection(c, x[S.FILM], x[S.OUT_D])
    if c[_BENDING] != 0.0:
        value += generated.bending(c, x, x[S.FILM], output_share(kind, 1, x[S.OUT_D], c))
    return value


@inner
def _sense(c, x, channel, value, normal, time, period, sample, current):
    """One sensor: what effects do before the noise, noise, what its converter does; a normal number that is NaN is no reading."""
    at = _SENSORS + channel * _PER_CHANNEL
    out = generated.sensor(c, x, channel, value, time, period, sample, current)
    if normal == normal and (c[at + N.NOISE] != 0.0 or c[at + N.NOISE_RELATIVE] != 0.0):
        colour = c[at + N.COLOUR]
        x[_NOISE + channel] = colour * x[_NOISE + channel] + math.sqrt(1.0 - colour * colour) * normal
        out += x[_NOISE + channel] * (c[at + N.NOISE] + c[at + N.NOISE_RELATIVE] * abs(out))
    return generated.converter(c, x, channel, out, time)


@inner
def _settle_behind_film(c, x, resistance, deflection, stage):
    """Bring terminals, structure and sensors to rest behind a film at rest."""
    generated.settle_sensor(c, x, 1, generated.settle_terminals(c, x, resistance))
    generated.settle_sensor(c, x, 2, generated.settle_structure(c, x, deflection))
    generated.settle_sensor(c, x, 3, stage)


@kernel(nogil=True)
def run_chain(
    kind, c, packed_r, packed_d, poly_r, poly_d, levels, domains,
    x, play_r, play_d, metallic, line, command, normals, course, out,
):  # fmt: skip
    """Run the chain over `command` (n,) [A] and fill `out` (n, COLUMNS); all memories are updated in place.

    `kind` : PLAYS or ENSEMBLE; `c` : coefficients as `Simulation.prepared` gives them; `packed_*`, `poly_*` : laws as
    `device.law_step` takes them, and polynomials;
    `levels`, `domains` : (2, 2, n) sorted populations; `normals` : (n, 4) standard normal numbers;
    `course` : (n,) what is added to the amplitude of the effect that may have any course in time, or (0,).
    """
    c, poly_r, poly_d, x = borrow(c), borrow(poly_r), borrow(poly_d), borrow(x)
    packed_r, packed_d, play_r, play_d = borrow(packed_r), borrow(packed_d), borrow(play_r), borrow(play_d)
    levels, domains, metallic, line = borrow(levels), borrow(domains), borrow(metallic), borrow(line)
    command, normals, course, out = borrow(command), borrow(normals), borrow(course), borrow(out)
    period = c[C.SAMPLE_PERIOD]
    parts = max(int(c[C.SUBSTEPS]), 1)
    if course.size > 0:
        x[S.COURSE] = course[0]
    if x[S.STARTED] == 0.0:
        x[S.STARTED] = 1.0
        initial_transitions(kind, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic)
        x[S.RESISTANCE] = _film_resistance(kind, c, x, poly_r)
        _settle_behind_film(c, x, x[S.RESISTANCE], _film_deflection(kind, c, x, poly_d), x[S.STAGE])
    whole = int(c[C.DEAD_TIME] / period)
    part = c[C.DEAD_TIME] - whole * period
    lazy = c[C.FOLLOWS] != 0.0
    for k in range(command.size):
        sample = int(x[S.SAMPLE])
        time = c[C.CLOCK] * (sample * period)
        if course.size > 0:
            x[S.COURSE] = course[k]
        current = _driver(c, x, command[k], time, period)
        line[sample & _LINE] = current
        # the held input changes inside the interval where the dead time is no whole number of samples
        current_in = line[(sample - whole - 1) & _LINE]
        h = part / parts
        start = time - period
        before = play_r[0]
        for j in range(0 if part > 0.0 else parts, 2 * parts):
            if j == parts:
                current_in = line[(sample - whole) & _LINE]
                h = (period - part) / parts
                start = time - period + part - parts * h
            if lazy:
                seen = step_temperature(c, x, current_in, h, start + j * h)
                # on its way up or down the film passes what it need not be asked about; a turn it remembers
                if (before - play_r[0]) * (seen - before) < 0.0:
                    step_transitions(c, x, before, packed_r, packed_d, play_r, play_d)
                before = seen
                continue
            advance(
                kind, c, x, current_in, h, start + j * h, packed_r, packed_d, play_r, play_d, levels, domains, metallic
            )  # fmt: skip
            if c[_RESISTANCE] != 0.0:
                x[S.RESISTANCE] = _film_resistance(kind, c, x, poly_r)
        if lazy:
            step_transitions(c, x, before, packed_r, packed_d, play_r, play_d)
        film = _film_resistance(kind, c, x, poly_r)
        x[S.RESISTANCE] = film
        tip = generated.structure(c, x, _film_deflection(kind, c, x, poly_d), period)
        out[k, 0] = current
        out[k, 1] = generated.terminals(c, x, film, current, time, x[S.FILM])
        out[k, 2] = tip
        out[k, 3] = x[S.STAGE]
        for channel in range(_COUNT):
            if c[_SENSORS + channel * _PER_CHANNEL + N.IDEAL] == 0.0:
                out[k, channel] = _sense(
                    c, x, channel, out[k, channel], normals[k, channel], time, period, sample, current
                )
        out[k, 4] = tip
        out[k, 5] = x[S.FILM]
        out[k, 6] = film
        out[k, 7] = x[S.OUT_R]
        out[k, 8] = x[S.OUT_D]
        x[S.SAMPLE] += 1.0


@kernel
def bring_to_rest(kind, c, x, poly_r, poly_d, current, heat):
    """Bring slow bodies (`heat` true), or what is behind the film, to where they come in the end under a held current [A]."""
    if heat:
        joule = c[C.LINEAR_GAIN] * current + c[C.SQUARE_GAIN] * current * current
        drive = joule + own_heat(c, x, current)
        drive += generated.heating(c, x, current, joule, x[S.RESISTANCE], -c[C.SAMPLE_PERIOD])
        generated.settle_thermal(c, x, drive)
        x[S.SLOW] = drive
    else:
        _settle_behind_film(
            c, x, _film_resistance(kind, c, x, poly_r), _film_deflection(kind, c, x, poly_d), x[S.STAGE]
        )


# --- what a diagnosis asks of a film that has been simulated: the same functions on its columns --------------------


@kernel(nogil=True)
def see_film(kind, c, x, present, out, seen):
    """Fill `seen` (n, 2) [degC]: what each transition sees of the film in `out` (n, COLUMNS), `present` (2,) says of which."""
    c, x, out, seen = borrow(c), borrow(x), borrow(out), borrow(seen)
    x[S.HAS_R], x[S.HAS_D] = present[0], present[1]
    generated.settle_transition(c, x, out[0, 5])
    for k in range(out.shape[0]):
        seen[k, 0], seen[k, 1] = seen_temperature(
            kind, c, x, out[k, 5], out[k, 7], out[k, 8], c[C.SAMPLE_PERIOD]
        )


@kernel(nogil=True)
def late_correction(c, x, values):
    """Replace what is added to a transition's equilibrium, values (n,), by what is added to its output."""
    before = output = values[0]
    for k in range(values.size):
        output = generated.follow(c, x, values[k], before, output, c[C.SAMPLE_PERIOD])
        before = values[k]
        values[k] = output


@kernel(nogil=True)
def through_linear_structure(c, x, series):
    """Replace each deflection (k, n) [m] by what the linear effects of the structure make of it."""
    for j in range(series.shape[0]):
        generated.settle_structure(c, x, series[j, 0])
        for k in range(series.shape[1]):
            series[j, k] = generated.linear_structure(c, x, series[j, k], c[C.SAMPLE_PERIOD])


@kernel(nogil=True)
def through_sensor(c, x, channel, series):
    """Replace each series (k, n) of a channel, in its unit, by what the sensor's effects make of it."""
    period = c[C.SAMPLE_PERIOD]
    for j in range(series.shape[0]):
        generated.settle_sensor(c, x, channel, series[j, 0])
        for k in range(series.shape[1]):
            time = c[C.CLOCK] * (k * period)
            series[j, k] = generated.sensor(c, x, channel, series[j, k], time, period, k, 0.0)


@kernel(nogil=True)
def finish_film(kind, c, x, packed_r, packed_d, poly_d, rest, at_rest, film, out, every, result):
    """Terminals, structure and sensors of both film channels, once more, on a corrected film.

    `rest` (COLUMNS,) : the film at rest; `at_rest` (2,), `film` (n, 2) : what is added to log10 R and to the deflection
    [m]; of `every` samples the last is written to `result` (n // every, COLUMNS).
    """
    c, poly_d, film = borrow(c), borrow(poly_d), borrow(film)
    packed_r, packed_d = borrow(packed_r), borrow(packed_d)
    out, result, x = borrow(out), borrow(result), borrow(x)
    period = c[C.SAMPLE_PERIOD]
    x[S.FILM] = rest[5]
    if c[_PHASE] != 0.0:
        keep_reversible(x, packed_r, packed_d)
    x[S.OUT_D] = rest[8] + at_rest[1]
    _settle_behind_film(c, x, rest[6] * 10.0 ** at_rest[0], _film_deflection(kind, c, x, poly_d), rest[3])
    for k in range(out.shape[0]):
        time = c[C.CLOCK] * (k * period)
        x[S.FILM] = out[k, 5]
        if c[_PHASE] != 0.0:
            keep_reversible(x, packed_r, packed_d)
        x[S.OUT_D] = out[k, 8] + film[k, 1]
        resistance = out[k, 6] * math.exp(LN10 * min(max(film[k, 0], -30.0), 30.0))
        tip = generated.structure(c, x, _film_deflection(kind, c, x, poly_d), period)
        terminal = generated.terminals(c, x, resistance, out[k, 0], time, x[S.FILM])
        if c[_SENSORS + _PER_CHANNEL + N.IDEAL] == 0.0:
            terminal = _sense(c, x, 1, terminal, 0.0, time, period, k, out[k, 0])
        if c[_SENSORS + 2 * _PER_CHANNEL + N.IDEAL] == 0.0:
            tip = _sense(c, x, 2, tip, 0.0, time, period, k, out[k, 0])
        if (k + 1) % every == 0:
            result[k // every, 1] = terminal
            result[k // every, 2] = tip
