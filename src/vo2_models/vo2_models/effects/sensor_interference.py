"""A sensor picks up something periodic, such as the mains or a vibration."""

import math

import numpy as np

from vo2_models.effects.record import Effect, constant_of
from vo2_models.recording import RESISTANCE, STAGE_TEMPERATURE, TIP_DEFLECTION

CYCLES = 30
"""Least cycles in a recording: slower is a drift or a room."""
BINS = 100
"""Bins of a spectrum whose median is the level about a line."""
LINE = 40.0
"""Power over that level from which it is a line: noise reaches it in one bin of exp(40)."""
ABOVE = 3.0
"""Times the strongest frequency of the simulated values: below, what a law misses of the drive swings."""
WIDE = 1.6
"""Bins about a multiple of the drive's strongest frequency that may be its own."""
PERIODS = 8.0
"""Cycles of the drive in a recording from which multiples of its frequency stand apart."""
TOP = 0.75
"""Distance of a line from the bin that shows it most, in bins."""
SHORTEST, FEWEST, MOST = 8.0, 8, 64
"""Least cycles of a block, least samples in it, and most blocks."""
AGREES = 0.5
"""Distance from the whole recording's line, over its amplitude, that blocks of one kind may have together."""
KIND = 3
"""Blocks that a kind must have to be asked."""
STILL = 0.02
"""Share of the range by which the simulated value moves within a block that counts as at rest."""

EFFECT = Effect(
    id="sensor_interference",
    stage="sensor",
    parameters=(
        constant_of("amplitude", 0, "channel unit", "amplitude of what is added", 0, 1e12),
        constant_of("frequency", 50, "Hz", "its frequency", 1e-9, 1e9),
        constant_of("phase_angle", 0, "rad", "its phase at the start of the recording", -7, 7),
    ),
    channels=(RESISTANCE, TIP_DEFLECTION, STAGE_TEMPERATURE),
    signal=True,
    linear=False,
    order=46,
    typical={
        "integrated:film_resistance": {
            "amplitude": (6e2, 3e3), "frequency": (40.0, 300.0), "phase_angle": (0.5, 3.0)
        },
        "integrated:tip_deflection": {
            "amplitude": (0.2e-6, 1e-6), "frequency": (40.0, 300.0), "phase_angle": (0.5, 3.0)
        },
        "peltier:film_resistance": {
            "amplitude": (3e2, 1.5e3), "frequency": (0.4, 2.5), "phase_angle": (0.5, 3.0)
        },
        "peltier:tip_deflection": {
            "amplitude": (0.2e-6, 1e-6), "frequency": (0.4, 2.5), "phase_angle": (0.5, 3.0)
        },
        "peltier:stage_temperature": {
            "amplitude": (0.1, 0.5), "frequency": (0.4, 2.5), "phase_angle": (0.5, 3.0)
        },
    },
    equation="y = y_true + a sin(2 pi f t + phase)",
    excitation="any; the longer the recording, the smaller a line that stands out of the noise",
    source="any text on data acquisition",
    statement=(
        "Something periodic is added to one channel, the mains for instance, a fan or a vibration of the mounting: by the same "
        "amount wherever the device is and whichever way it moves. A frequency above half the sampling rate shows folded "
        "below it. Amplitude and frequency are of the sensor, the phase of this recording only."
    ),
)  # fmt: skip


def line(left, size, value, period):
    """The line that stands out of the spectrum, has one phase from block to block, and is none of the simulated value's."""
    good = np.isfinite(left)
    time = np.arange(left.size) * period
    if np.count_nonzero(good) < 2 * BINS:
        return None
    z = np.where(good, left, 0.0) / size
    window = np.hanning(z.size)
    height = _over_level(window * z)
    # what a law misses of the drive's own frequencies swings as they do, or at multiples of them
    simulated = np.abs(np.fft.rfft(window * (value - np.mean(value)) / size))
    height[simulated > np.abs(np.fft.rfft(window * z))] = 0.0
    first = _peak(window * (value - np.mean(value)), time, 2 + int(np.argmax(simulated[2:])))
    if first >= PERIODS:
        off = (np.arange(height.size) / first + 0.5) % 1.0 - 0.5
        height[np.abs(off) * first <= WIDE] = 0.0
    height[: max(CYCLES, int(ABOVE * first))] = 0.0
    place = int(np.argmax(height))
    if height[place] < LINE:
        return None
    cycles = _peak(window * z, time, place)
    if abs(cycles - place) > TOP:
        return None  # the side of a line of the drive
    frequency = cycles / (z.size * period)
    blocks = np.array_split(np.arange(z.size), int(np.clip(cycles / SHORTEST, 2 * KIND, MOST)))
    turn = np.exp(2j * np.pi * frequency * time)
    found = []
    for block in blocks:
        at = block[good[block]]
        if at.size < FEWEST:
            continue
        scale = 1.0 / size[at]
        columns = np.column_stack(
            [scale * turn[at].imag, scale * turn[at].real, np.ones(at.size), time[at] - time[at[0]]]
        )
        weights = np.linalg.lstsq(columns, z[at], rcond=None)[0]
        way = value[block[-1]] - value[block[0]]
        found.append((complex(weights[0], weights[1]), at.size, way, time[block[0]], np.mean(time[at])))
    if len(found) < 2 * KIND:
        return None
    each, count, way, start, middle = (np.array(column) for column in zip(*found, strict=True))
    # its frequency again, from block to block: the window has weighed the ends of the recording down
    ahead = np.angle(each * np.conj(np.average(each, weights=count)))
    rate = np.polyfit(middle, ahead, 1, w=np.sqrt(count))[0]
    frequency += rate / (2.0 * np.pi)
    each = each * np.exp(-1j * rate * middle)
    whole = np.average(each, weights=count)
    still = STILL * np.ptp(value)
    kinds = [np.abs(way) <= still, way > still, way < -still]
    kinds += [start * 4.0 // (time[-1] + period) == quarter for quarter in range(4)]
    told = [np.average(each[kind], weights=count[kind]) for kind in kinds if np.count_nonzero(kind) >= KIND]
    if any(
        abs(one - whole) > AGREES * abs(whole)
        for one in (*told, np.median(each.real) + 1j * np.median(each.imag))
    ):
        return None
    off = each - whole
    deviation = float(np.sqrt(np.average(off.real**2 + off.imag**2, weights=count) / 2.0 / (len(found) - 1)))
    angle = deviation / abs(whole)
    length = z.size * period
    return (
        {
            "amplitude": float(abs(whole)),
            "frequency": float(frequency),
            "phase_angle": float(np.angle(whole)),
        },
        # of a line's phase at its middle, its frequency, and both together at its start
        {
            "amplitude": deviation,
            "frequency": angle * math.sqrt(3.0) / (math.pi * length),
            "phase_angle": 2.0 * angle,
        },
    )


def _over_level(z):
    """Power of each bin of a spectrum over what is usual about it."""
    power = np.abs(np.fft.rfft(z)) ** 2
    whole = power[: power.size // BINS * BINS].reshape(-1, BINS)
    level = np.median(whole, axis=1) / math.log(2.0)
    level = np.interp(np.arange(power.size), (np.arange(level.size) + 0.5) * BINS, level)
    return power / np.maximum(level, 1e-300)


def _peak(z, time, place):
    """Cycles of the highest power about a bin, in the length of the recording."""
    length = time.size * time[1]
    for step in (0.25, 0.05, 0.01):
        tried = place + step * np.arange(-4, 5)
        power = [abs(np.sum(z * np.exp(-2j * np.pi * one / length * time))) for one in tried]
        place = tried[int(np.argmax(power))]
    return place


def sensor(value, time, amplitude, frequency, phase_angle):
    return value + amplitude * math.sin(2.0 * math.pi * frequency * time + phase_angle)
