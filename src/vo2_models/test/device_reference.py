"""The fitted simulation's equations once more, in plain Python with many small explicit steps.

Written from the equations in the effects' records, without the compiled core's shortcuts: no exact step, no
enthalpy root, no caching. It is slow and only as accurate as its step is short.
"""

from __future__ import annotations

import math


class Play:
    """w = max(tanh(a (T - m - h)) , w) while T rises, min(tanh(a (T - m + h)), w) while it falls."""

    def __init__(self, slope: float, centre: float, half_width: float) -> None:
        self.slope, self.centre, self.half_width = slope, centre, half_width
        self.w = -1.0

    def would_be(self, before: float, now: float) -> float:
        if now > before:
            return max(math.tanh(self.slope * (now - self.centre - self.half_width)), self.w)
        if now < before:
            return min(math.tanh(self.slope * (now - self.centre + self.half_width)), self.w)
        return self.w


class Film:
    """Plays of one weight each; `fraction` runs from 0 to 1."""

    def __init__(self, plays: list[tuple[float, float, float]]) -> None:
        self.plays = [Play(*p) for p in plays]
        self.last = -1e6

    def peek(self, temperature: float) -> float:
        total = sum(p.would_be(self.last, temperature) for p in self.plays)
        return 0.5 * (1.0 + total / len(self.plays))

    def move(self, temperature: float) -> float:
        for p in self.plays:
            p.w = p.would_be(self.last, temperature)
        self.last = temperature
        return self.peek(temperature)


def simulate(
    current: list[float],
    *,
    dt: float,
    plays: list[tuple[float, float, float]],
    tau: float,
    ambient: float,
    k1: float = 0.0,
    k2: float = 0.0,
    substeps: int = 200,
    latent: float = 0.0,
    cooling: float = 0.0,
    beta: float = 0.0,
    exponent: float = 2.0,
    phase_loss: float = 0.0,
    tcr: float = 0.0,
    pumping: float = 0.0,
    slow: tuple[float, float] = (0.0, 1.0),
    drift: tuple[float, float] = (0.0, 0.0),
    kinetics: float = 0.0,
    kappa: float = 0.0,
    laser: float = 0.0,
    delay: float = 0.0,
) -> tuple[list[float], list[float]]:
    """Return film temperature and phase fraction at the end of each sample."""
    film = Film(plays)
    t_fast, theta_slow = ambient + laser, laser
    s = film.move(ambient + laser)
    h = dt / substeps
    temperatures, fractions = [], []
    for k in range(len(current)):
        for j in range(substeps):
            time = (k - 1) * dt + (j + 0.5) * h
            # sample whose current acts now: the one whose interval held `time - delay`
            at = math.floor((time - delay) / dt + 1e-12) + 1
            i = current[at] if at >= 0 else 0.0
            surroundings = ambient + drift[0] * time + drift[1] * time * time
            theta = t_fast - surroundings
            joule = k1 * i + k2 * i * i
            drive = joule + laser
            loss = (1.0 + phase_loss * s) * (theta + beta * theta * abs(theta) ** (exponent - 1.0))
            surplus = drive + joule * tcr * theta + pumping * i * theta - loss
            heat = surplus * h / (tau * (1.0 + cooling) if surplus < 0.0 else tau)
            theta_slow += h / slow[1] * (drive - theta_slow)

            def temperature_of(
                fast: float, slow_now: float = theta_slow, around: float = surroundings
            ) -> float:
                return around + (1.0 - slow[0]) * (fast - around) + slow[0] * slow_now

            if latent:
                low, high = sorted((t_fast, t_fast + heat))
                for _ in range(30):
                    middle = 0.5 * (low + high)
                    if middle - t_fast + latent * (film.peek(temperature_of(middle)) - s) < heat:
                        low = middle
                    else:
                        high = middle
                t_fast = 0.5 * (low + high)
            else:
                t_fast += heat
            t_film = temperature_of(t_fast)
            seen = t_film
            for _ in range(8 if kappa else 0):
                seen = t_film + kappa * (film.peek(seen) - 0.5)
            equilibrium = film.move(seen)
            s = equilibrium if not kinetics else s + h / kinetics * (equilibrium - s)
        temperatures.append(t_film)
        fractions.append(s)
    return temperatures, fractions
