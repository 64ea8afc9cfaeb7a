"""The protocol of a concealed hysteresis law: three compiled functions of parameters and an explicit memory.

    settle(law, level) -> memory           as after a rise from the coldest temperature to `level` [degC]
    advance(law, memory, level, step)      move the input to `level` within `step` [s]; return the new fraction
    absorb(law, memory, temperature, shift, heat, latent, step) -> temperature, heat
                                           add `heat` [K] to a body at `temperature` whose film sees that + `shift` and
                                           takes up `latent` [K] per transformed fraction; return what is left over

and of one plain function, `widen(law, width) -> law`.

A law is a `NamedTuple` of arrays; its memory is a float array that starts with the transformed fraction. Every family
file announces its law by `implement`; numba picks the functions by the law's type, so that one compiled core serves
all families and each is one file.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numba.extending import overload
from numpy.typing import NDArray
from vo2_models.numerics.kernel import kernel, source_digest

__all__ = [
    "Film",
    "Statistics",
    "absorb",
    "advance",
    "draw_both",
    "implement",
    "logistic_volumes",
    "major_loop",
    "pushed",
    "settle",
    "trace",
    "widen",
    "widen_thresholds",
    "widened",
]

Array = NDArray[np.floating]
_SETTLE: dict[object, Callable] = {}
_ADVANCE: dict[object, Callable] = {}
_ABSORB: dict[object, Callable] = {}
_WIDEN: dict[object, Callable] = {}


class Statistics(NamedTuple):
    """What a film is drawn to have: moments over the material and its pace.

    heating_mean, heating_sd : threshold on heating [degC, K]
    width_mean, width_sd : loop width [K]
    offset_mean, offset_sd : structural minus metallic threshold [K]
    time_constant : of the heated body [s]; sets which rates are slow
    """

    heating_mean: float
    heating_sd: float
    width_mean: float
    width_sd: float
    offset_mean: float
    offset_sd: float
    time_constant: float


class Film(NamedTuple):
    """One film: the metallic and the structural transition.

    Attributes
    ----------
    metal, structure : laws of one family
    feedback : each sees the temperature + feedback (fraction - 1/2) [K]
    """

    metal: Any
    structure: Any
    feedback: float = 0.0


def implement(
    law: type, *, settle: Callable, advance: Callable, widen: Callable, absorb: Callable | None = None
) -> None:
    """Announce the plain functions of `law`; without `absorb` the law is smooth and a root search serves."""
    _SETTLE[law], _ADVANCE[law], _WIDEN[law] = settle, advance, widen
    _ABSORB[law] = absorb or _absorb_smooth


def widen(law: Any, width: float) -> Any:
    """Return `law` with its loop wider by `width` [K] about the same middle."""
    return _WIDEN[type(law)](law, width)


def widened(up: Array, down: Array, width: float) -> tuple[Array, Array]:
    """Return thresholds of heating and cooling (n,) [degC] further apart by `width` [K] about the same middles, in order."""
    middle, wide = (up + down) / 2, np.maximum(up - down + width, 0.1)
    return middle + wide / 2, middle - wide / 2


def widen_thresholds(law: Any, width: float) -> Any:
    """`widen` of a law whose parameters are `up` and `down`, thresholds of each part (n,) [degC]."""
    up, down = widened(law.up, law.down, width)
    return law._replace(up=up, down=down)


@kernel
def pushed(q, level, up, down, soft):
    """State q [1] of a part after it is pushed up to a ramp about `up` from below, down to one about `down` from above.

    Ramps reach from 0 to 1 within `soft` [K] on both sides of a threshold [degC].
    """
    least = min(max((level - up) / (2.0 * soft) + 0.5, 0.0), 1.0)
    most = min(max((level - down) / (2.0 * soft) + 0.5, 0.0), 1.0)
    return min(max(q, least), most)


def settle(law, level):
    """Compiled code only; see the module."""
    raise NotImplementedError


def advance(law, memory, level, step):
    """Compiled code only; see the module."""
    raise NotImplementedError


def absorb(law, memory, temperature, shift, heat, latent, step):
    """Compiled code only; see the module."""
    raise NotImplementedError


@overload(settle)
def _settle(law, level):
    return _SETTLE.get(getattr(law, "instance_class", object))


@overload(advance)
def _advance(law, memory, level, step):
    return _ADVANCE.get(getattr(law, "instance_class", object))


@overload(absorb)
def _absorb(law, memory, temperature, shift, heat, latent, step):
    return _ABSORB.get(getattr(law, "instance_class", object))


def _absorb_smooth(law, memory, temperature, shift, heat, latent, step):
    """Solve x + latent (s(T + x) - s) = heat for the rise x by bisection; s is monotonic between turns."""
    before = memory[0]
    low, high = 0.0, 1.0
    for _ in range(14):
        share = (low + high) / 2
        trial = memory.copy()
        fraction = advance(law, trial, temperature + shift + share * heat, step)
        excess = share * heat + latent * (fraction - before) - heat
        if excess * heat > 0:
            high = share
        else:
            low = share
    rise = (low + high) / 2 * heat
    fraction = advance(law, memory, temperature + shift + rise, step)
    return temperature + rise, 0.0


@kernel(digest=source_digest(*map(str, sorted(Path(__file__).parent.glob("*.py")))))
def trace(law, temperature, feedback, step):
    """Return the fraction (n,) along temperatures (n,) [degC] `step` [s] apart, from the coldest on.

    The feedback is brought to rest at each temperature.
    """
    memory = settle(law, temperature[0] - 100.0)
    out = np.empty(temperature.size)
    for k in range(temperature.size):
        fraction = memory[0]
        for _ in range(50):
            before = fraction
            fraction = advance(law, memory, temperature[k] + feedback * (before - 0.5), step)
            if abs(fraction - before) < 1e-9 or feedback == 0.0:
                break
        out[k] = fraction
    return out


def logistic_volumes(
    rng: np.random.Generator, film: Statistics, misfit: float, mean: float, spread: float, *, count: int
) -> tuple[Array, Array, Array, Array]:
    """Draw shares, temperatures of heating [degC], loop widths [K] and logistic scales [K], (count,) each.

    Together they heat through `mean` with the standard deviation `spread`; the loops scatter by `misfit` besides.
    """
    share = rng.dirichlet(np.full(count, 6.0))
    places = np.clip(rng.standard_normal(count), -1.5, 1.5)
    up = mean + 0.35 * spread * (places - np.sum(share * places))
    inner = np.sqrt(max(spread**2 - np.sum(share * (up - mean) ** 2), 0.3 * spread**2))
    width = film.width_mean * (1 + misfit * rng.standard_normal(count))
    width += 0.3 * film.width_sd * np.clip(rng.standard_normal(count), -1.5, 1.5)
    scatter = np.clip(1 + misfit * rng.standard_normal(count), 0.5, 1.5)
    return share, up, np.maximum(width, 1.0), np.sqrt(3) / np.pi * inner * scatter


def draw_both(rng: np.random.Generator, film: Statistics, law: Callable[[float, float], Any]) -> Film:
    """Draw the metallic and the structural transition by `law(mean, spread)` [degC, K]."""
    metal = law(film.heating_mean, film.heating_sd)
    offset = film.offset_mean + 0.3 * film.offset_sd * rng.standard_normal()
    return Film(metal, law(film.heating_mean + offset, float(np.hypot(film.heating_sd, film.offset_sd))))


def major_loop(film: Film, temperature_degC: Array) -> tuple[Array, Array, Array, Array]:
    """Return the quasi-static major loop at rising temperatures (n,): metal up, metal down, structure up and down.

    The loop turns 60 K above the last temperature; each of its steps takes an hour.
    """
    beyond = np.arange(float(temperature_degC[-1]), float(temperature_degC[-1]) + 60.0, 0.1)[1:]
    path = np.concatenate([temperature_degC, beyond, beyond[::-1], temperature_degC[::-1]])
    n = temperature_degC.size
    found: list[Array] = []
    for law in (film.metal, film.structure):
        fraction = trace(law, path, film.feedback, 3600.0)
        found += [fraction[:n], fraction[-n:][::-1]]
    return found[0], found[1], found[2], found[3]
