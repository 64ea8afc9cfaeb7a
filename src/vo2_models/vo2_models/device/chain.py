"""Compiled chain: driver, core, structure and sensors of one device, sample by sample.

One loop serves the batch and the stream: a stream is a batch of one sample at a time on the same state.
"""

from __future__ import annotations

import hashlib
import math
from pathlib import Path
from typing import Any

import numpy as np

from vo2_models.device.borrow import borrow
from vo2_models.device.coefficients import PER_CHANNEL
from vo2_models.device.coefficients import Coefficient as C
from vo2_models.device.coefficients import Sensor as N
from vo2_models.device.core import ENSEMBLE, advance, follow, follows, initial_transitions, output_share, warm
from vo2_models.device.laws import polynomial, truth_deflection, truth_resistance
from vo2_models.device.state import CURRENT_LINE, SENSOR_LINE
from vo2_models.device.state import Slot as S
from vo2_models.numerics.kernel import kernel

__all__ = ["COLUMNS", "run_chain"]

COLUMNS = 9
"""Columns of the output: the four sensor channels, then true deflection [m], film temperature [degC], true
resistance [ohm], and the two transition outputs."""
_SENSORS = len(C)
LN10 = math.log(10.0)
# delay lines are rings whose lengths are powers of two
_LINE = CURRENT_LINE - 1
_SENSOR_LINE = SENSOR_LINE - 1


@kernel
def _driver(c, x, command, period):
    """Source: its range, then saturation, dead zone and slew rate."""
    i = min(max(command, c[C.RANGE_LOW]), c[C.RANGE_HIGH])
    i = min(max(i, -c[C.SATURATION]), c[C.SATURATION])
    width = c[C.DEADZONE]
    if width > 0.0:
        i = math.copysign(max(abs(i) - width, 0.0), i)
    most = c[C.SLEW] * period
    i = min(max(i, x[S.CURRENT] - most), x[S.CURRENT] + most)
    x[S.CURRENT] = i
    return i


@kernel
def _film_resistance(kind, c, x, poly_r):
    if kind == ENSEMBLE:
        return truth_resistance(c, x[S.FILM], x[S.OUT_R])
    return math.exp(-LN10 * (x[S.OUT_R] + polynomial(poly_r, x[S.FILM])))


@kernel
def _film_deflection(kind, c, x, poly_d):
    value = x[S.OUT_D] + polynomial(poly_d, x[S.FILM])
    if kind == ENSEMBLE:
        value = truth_deflection(c, x[S.FILM], x[S.OUT_D])
    if c[C.HOT_EXPANSION] != 0.0:
        value -= c[C.HOT_EXPANSION] * output_share(kind, 1, x[S.OUT_D], c) * (x[S.FILM] - c[C.AMBIENT])
    return value


@kernel
def _terminal_resistance(c, x, film, current):
    """What the two terminals show: leakage beside the film, leads in series, and crosstalk of the heater."""
    value = film
    if c[C.LEAKAGE] != 0.0:
        value = value / (1.0 + c[C.LEAKAGE] * value)
    return value + c[C.SERIES] + c[C.CROSSTALK] * current


@kernel
def _structure(c, x, mode, deflection, period):
    """Creep and one lightly damped mode, both with unit gain at rest; `mode` (2, 4) is the mode's exact step."""
    value = deflection
    if c[C.CREEP] != 0.0:
        x[S.CREPT] += -math.expm1(-period / c[C.CREEP_TIME]) * (deflection - x[S.CREPT])
        value += c[C.CREEP] * (x[S.CREPT] - deflection) + c[C.CREEP_GAIN] * deflection
    if c[C.MODE_SHARE] != 0.0:
        z, r, last = x[S.MODE], x[S.MODE_RATE], x[S.MODE_INPUT]
        x[S.MODE] = mode[0, 0] * z + mode[0, 1] * r + mode[0, 2] * last + mode[0, 3] * value
        x[S.MODE_RATE] = mode[1, 0] * z + mode[1, 1] * r + mode[1, 2] * last + mode[1, 3] * value
        x[S.MODE_INPUT] = value
        value += c[C.MODE_SHARE] * (x[S.MODE] - value)
    return value


@kernel
def _relaxations(c, period):
    """Sample period in time constants of the heat; never so few that a difference of exponentials loses digits."""
    return max(period / c[C.TIME_CONSTANT], 1e-3)


@kernel
def _sense(c, channel, value, normal, time, period, sample, memory, line):
    """One sensor: lag, late clock, drifting gain, noise, quantisation, saturation.

    Lag and clock are exact for an input that moves from sample to sample as the heat does under a held current.
    """
    at = _SENSORS + channel * PER_CHANNEL
    out = value
    if c[at + N.LAG] > 0.0:
        heat, slow = _relaxations(c, period), period / c[at + N.LAG]
        gap = slow - heat
        left = math.exp(-slow)
        meanwhile = math.exp(-heat) * slow * (-math.expm1(-gap) / gap if abs(gap) > 1e-6 else 1.0)
        old = (meanwhile - math.exp(-heat) * (1.0 - left)) / -math.expm1(-heat)
        lagged = memory[channel, 0] * left + memory[channel, 2] * old + out * (1.0 - left - old)
        memory[channel, 0] = lagged
        memory[channel, 2] = out
        out = lagged
    if c[at + N.CLOCK] > 0.0:
        line[channel, sample & _SENSOR_LINE] = out
        late = c[at + N.CLOCK] / period
        whole = int(late)
        heat, part = _relaxations(c, period), late - whole
        share = math.exp(heat * (part - 1.0)) * math.expm1(-heat * part) / math.expm1(-heat)
        newer = line[channel, (sample - whole) & _SENSOR_LINE]
        older = line[channel, (sample - whole - 1) & _SENSOR_LINE]
        out = newer + share * (older - newer)
    out *= 1.0 + c[at + N.DRIFT] * time
    if c[at + N.NOISE] != 0.0 or c[at + N.NOISE_RELATIVE] != 0.0:
        colour = c[at + N.COLOUR]
        memory[channel, 1] = colour * memory[channel, 1] + math.sqrt(1.0 - colour * colour) * normal
        out += memory[channel, 1] * (c[at + N.NOISE] + c[at + N.NOISE_RELATIVE] * abs(out))
    if c[at + N.STEP] > 0.0:
        out = np.rint(out / c[at + N.STEP]) * c[at + N.STEP]
    return min(max(out, c[at + N.LOW]), c[at + N.HIGH])


def _sources() -> str:
    """Digest of every file whose compiled code ends up inside `run_chain`."""
    here = Path(__file__).parent
    digest = hashlib.sha256()
    for name in ("borrow", "coefficients", "core", "ensemble", "laws", "../hysteresis/play_bank", "state"):
        digest.update((here / f"{name}.py").read_bytes())
    return digest.hexdigest()


def _compiled(version: str) -> Any:
    """Return the compiled loop.

    Numba's disk cache notices a change of this file only, although the loop contains the code of its neighbours; a
    variable of the enclosing function is part of the cache's key, so their digest is passed as one.
    """

    @kernel(nogil=True)
    def run_chain(
        kind, c, mode, packed_r, packed_d, poly_r, poly_d, levels, domains,
        x, play_r, play_d, metallic, line, sensors, sensor_lines,
        command, normals, out,
    ):  # fmt: skip
        """Run the chain over `command` (n,) [A] and fill `out` (n, COLUMNS); all memories are updated in place.

        `kind` : PLAYS or ENSEMBLE; `c` : coefficients; `mode` : (2, 4) exact step of the structural mode;
        `packed_*`, `poly_*` : play banks and polynomials; `levels`, `domains` : (2, 2, n) sorted populations;
        `normals` : (n, 4) standard normal numbers.
        """
        c, mode, poly_r, poly_d, x = borrow(c), borrow(mode), borrow(poly_r), borrow(poly_d), borrow(x)
        packed_r, packed_d, play_r, play_d = (
            borrow(packed_r),
            borrow(packed_d),
            borrow(play_r),
            borrow(play_d),
        )
        levels, domains, metallic, line = borrow(levels), borrow(domains), borrow(metallic), borrow(line)
        sensors, sensor_lines = borrow(sensors), borrow(sensor_lines)
        command, normals, out = borrow(command), borrow(normals), borrow(out)
        _ = version
        period = c[C.SAMPLE_PERIOD]
        parts = max(int(c[C.SUBSTEPS]), 1)
        if x[S.STARTED] == 0.0:
            x[S.STARTED] = 1.0
            initial_transitions(kind, c, x, packed_r, packed_d, play_r, play_d, levels, domains, metallic)
            x[S.RESISTANCE] = _film_resistance(kind, c, x, poly_r)
            rest = _film_deflection(kind, c, x, poly_d)
            x[S.CREPT] = rest
            x[S.MODE] = rest
            x[S.MODE_INPUT] = rest
            sensors[1, 0] = _terminal_resistance(c, x, x[S.RESISTANCE], 0.0)
            sensors[2, 0] = rest
            sensors[3, 0] = x[S.STAGE]
            for channel in range(4):
                sensors[channel, 2] = sensors[channel, 0]
                sensor_lines[channel, :] = sensors[channel, 0]
        whole = int(c[C.DEAD_TIME] / period)
        part = c[C.DEAD_TIME] - whole * period
        lazy = follows(kind, c)
        for k in range(command.size):
            sample = int(x[S.SAMPLE])
            time = sample * period
            current = _driver(c, x, command[k], period)
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
                    seen = warm(c, x, current_in, h, start + j * h)
                    # on its way up or down the film passes what it need not be asked about; a turn it remembers
                    if (before - play_r[0]) * (seen - before) < 0.0:
                        follow(c, x, before, packed_r, packed_d, play_r, play_d)
                    before = seen
                    continue
                advance(
                    kind, c, x, current_in, h, start + j * h, packed_r, packed_d, play_r, play_d, levels, domains,
                    metallic,
                )  # fmt: skip
                if c[C.SENSE] != 0.0 or c[C.SENSE_FILM] != 0.0:
                    x[S.RESISTANCE] = _film_resistance(kind, c, x, poly_r)
            if lazy:
                follow(c, x, before, packed_r, packed_d, play_r, play_d)
            film = _film_resistance(kind, c, x, poly_r)
            x[S.RESISTANCE] = film
            tip = _structure(c, x, mode, _film_deflection(kind, c, x, poly_d), period)
            out[k, 0] = current
            out[k, 1] = _terminal_resistance(c, x, film, current)
            out[k, 2] = tip
            out[k, 3] = x[S.STAGE]
            for channel in range(4):
                if c[_SENSORS + channel * PER_CHANNEL + N.IDEAL] != 0.0:
                    continue
                out[k, channel] = _sense(
                    c, channel, out[k, channel], normals[k, channel], time, period, sample, sensors, sensor_lines
                )  # fmt: skip
            out[k, 4] = tip
            out[k, 5] = x[S.FILM]
            out[k, 6] = film
            out[k, 7] = x[S.OUT_R]
            out[k, 8] = x[S.OUT_D]
            x[S.SAMPLE] += 1.0

    return run_chain


run_chain = _compiled(_sources())
"""The compiled loop; see its docstring."""
