"""What constants leave of an effect, known from the concealed device: `python -m vo2_studies.challenge.identifiable`.

Where an effect was there all along the nominal device is fitted to recordings that it is in, and takes up what it can. That is
asked of the concealed device itself: without the effect, its constants and the places of its loops are fitted to what it does
with it, noise left out, over the calibration and the recording together. Of what came since the calibration only the constants
that another day moves are fitted, to the recording. What is left, in noise powers, is what somebody could find who knew the law
exactly, at most: the fit may end early. A fitted law, whose loops are free and which misses the device by some noise powers,
finds less.

Both sides are simulated with one step a sample. Families whose grains can be moved to other thresholds serve.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import least_squares
from vo2_models.command_line import duration, refuse
from vo2_models.io import InputError, OutputFolder

from vo2_studies.challenge.constants import CONSTANTS
from vo2_studies.challenge.devices import Device
from vo2_studies.challenge.draw import draw_case, runs_of
from vo2_studies.challenge.excess import excess_by_channel, residuals
from vo2_studies.challenge.families.law import widen
from vo2_studies.challenge.judging import COUNTED_EXCESS
from vo2_studies.challenge.plan import CasePlan, Choice
from vo2_studies.challenge.rig import Noise, Plan, Truth, simulate
from vo2_studies.challenge.runner import INTERRUPTED, Paths, Settings, load_json, save_json

__all__ = ["Size", "left_after_refit", "main"]

Array = NDArray[np.floating]
STEPS, SETTLED = 20, 0.01
"""Of the refit: steps tried at most, and the relative gain with which it ends."""
KINDS = {"always": "there all along", "one": "since the calibration", "outside": "outside the catalogue"}


@dataclass(frozen=True)
class _Move:
    """A constant that is fitted: its step for differences, and (device, by) -> device with it moved."""

    step: float
    move: Callable[[Device, float], Device]


@dataclass(frozen=True)
class Size:
    """Power of an effect in noise powers, of the channel and run with the most of it, before the refit and after."""

    before: float
    left: float


def _added(field: str) -> Callable[[Device, float], Device]:
    return lambda device, by: replace(device, **{field: getattr(device, field) + by})


def _delayed(device: Device, by: float) -> Device:
    return replace(device, dead_time=max(device.dead_time + by * device.preset.sample_period, 0.0))


def _of_law(which: str, change: Callable) -> Callable[[Device, float], Device]:
    def move(device: Device, by: float) -> Device:
        film = device.film
        return replace(device, film=film._replace(**{which: change(getattr(film, which), by)}))

    return move


def _shifted(law, by: float):
    return law._replace(up=law.up + by, down=law.down + by)


def _spread(law, by: float):
    """The middles of the grains further apart about their mean by a share; widths stay."""
    middle, half = 0.5 * (law.up + law.down), 0.5 * (law.up - law.down)
    middle = middle.mean() + (1.0 + by) * (middle - middle.mean())
    return law._replace(up=middle + half, down=middle - half)


def _moves(device: Device, *, anew: bool) -> tuple[_Move, ...]:
    """What is fitted: constants; of a device fitted `anew` the ends of both responses, and place, width, spread of each loop."""
    constants = tuple(_Move(0.25 * constant.size[0], constant.move) for constant in CONSTANTS)
    if not anew:
        return constants
    laws = tuple(
        _Move(step, _of_law(which, change))
        for which in ("metal", "structure")
        for change, step in ((_shifted, 0.2), (widen, 0.2), (_spread, 0.03))
    )
    deflection = 1e-3 * abs(device.strain) / (device.hot_temperature - device.cold_temperature)
    ends = {"activation": 0.01, "log_hot": 0.01, "metal_slope": 2e-4}
    ends |= {"expansion_cold": deflection, "expansion_hot": deflection}
    return (
        *constants,
        _Move(1.0, _delayed),
        *laws,
        *(_Move(step, _added(field)) for field, step in ends.items()),
    )


def _run(device: Device, command: Array, plan: Plan) -> Truth:
    """One run; a dead time between two samples is that of commands between theirs."""
    period = device.preset.sample_period
    whole, share = divmod((device.dead_time + plan.dead_time) / period, 1.0)
    between = (1.0 - share) * command + share * np.concatenate([[0.0], command[:-1]])
    return simulate(replace(device, dead_time=whole * period), between, replace(plan, dead_time=0.0))


def left_after_refit(
    device: Device, effects: Plan, commands: Sequence[Array], noise: Noise, *, anew: bool = True
) -> Size:
    """Fit `device` without effects to what it does with them.

    Parameters
    ----------
    device : concealed device, whose laws have thresholds `up` and `down`
    effects : what is in all runs
    commands : of each run (n,) [A]
    noise : of the channels
    anew : fit its loops too, or only the constants that another day moves

    Returns
    -------
    size of the effects, with the device as it is and refitted

    Raises
    ------
    ValueError : a law without thresholds
    """
    if not all(hasattr(law, "up") and not hasattr(law, "up_grain") for law in device.film[:2]):
        raise ValueError("family: found one whose law has no thresholds, need another, such as avalanches")
    device = replace(device, preset=replace(device.preset, substeps=1))
    with_it = [_run(device, command, effects) for command in commands]
    moves = _moves(device, anew=anew)

    def refitted(x: Array) -> list[Truth]:
        other = device
        for each, by in zip(moves, x, strict=True):
            other = each.move(other, by * each.step) if by else other
        return [_run(other, command, Plan()) for command in commands]

    def distances(x: Array) -> Array:
        pairs = zip(refitted(x), with_it, strict=True)
        return np.concatenate([residuals(clean, truth, effects, noise) for clean, truth in pairs])

    def most(x: Array) -> float:
        pairs = zip(refitted(x), with_it, strict=True)
        return max(max(excess_by_channel(clean, truth, effects, noise).values()) for clean, truth in pairs)

    def slopes(x: Array) -> Array:
        now = distances(x)
        return np.column_stack([distances(x + unit) - now for unit in np.eye(x.size)])

    begin = np.zeros(len(moves))
    # differences are over the steps of the constants, not of rounding: a grain switches or does not
    fit = least_squares(
        distances, begin, jac=slopes, method="lm", x_scale="jac", ftol=SETTLED, max_nfev=STEPS
    )
    return Size(most(begin), most(fit.x))


def main(arguments: Sequence[str] | None = None) -> int:
    """Print one line a case of those that `challenge` draws with the same options, and the counts; 130 after Ctrl-C."""
    try:
        return _command(arguments)
    except KeyboardInterrupt:
        print(INTERRUPTED, file=sys.stderr)
        return 130


def _command(arguments: Sequence[str] | None) -> int:
    parser = argparse.ArgumentParser(prog="identifiable", description=__doc__.splitlines()[0])
    parser.add_argument(
        "--cases", type=int, default=48, help="of `challenge`, of which those that apply are taken (48)"
    )
    parser.add_argument("--seed", type=int, nargs="+", default=[1], help="one or several (1)")
    parser.add_argument("--family", default="avalanches", help="of the hysteresis (avalanches)")
    parser.add_argument("--condition", default="all", help="of the recordings (all)")
    parser.add_argument("--samples", type=int, default=5000, help="of the recording (5000)")
    parser.add_argument("--output", type=Path, required=True, help="folder; finished cases in it are kept")
    options = parser.parse_args(arguments)
    choice = Choice(
        family=options.family, condition=options.condition, samples=(options.samples, options.samples)
    )
    outputs = OutputFolder(options.output, ("identifiable.json",))
    try:
        outputs.check()
        choice.check()
        plans = [(Settings(seed, choice=choice), k) for seed in options.seed for k in range(options.cases)]
        cases = [(s, s.plan(k)) for s, k in plans if s.plan(k).kind in KINDS]
        sizes = _sizes(cases, options.output)
    except (InputError, ValueError) as error:
        return refuse("identifiable", error)
    save_json(options.output / "identifiable.json", sizes)
    outputs.remember()
    for kind, words in KINDS.items():
        left = [one["left"] for one in sizes if one["kind"] == kind and one["before"] > COUNTED_EXCESS]
        more = ", ".join(f"{sum(x > p for x in left)} more than {p:g}" for p in (COUNTED_EXCESS, 1.0))
        print(f"{words}: of {len(left)} above {COUNTED_EXCESS:g} noise powers constants leave {more}")
    print(f"results in {options.output / 'identifiable.json'}")
    return 0


def _sizes(cases: Sequence[tuple[Settings, CasePlan]], folder: Path) -> list[dict]:
    """The sizes of all cases, each kept in a file of its own."""
    found: list[dict] = []
    files = []
    for settings, plan in cases:
        of = f"{settings.seed}_{settings.choice.family}_{settings.choice.condition}_{plan.samples}"
        files.append(Paths(folder / of).result(plan.index))
    begun, new, to_do = time.monotonic(), 0, sum(not path.exists() for path in files)
    for (settings, plan), path in zip(cases, files, strict=True):
        if path.exists():
            found.append(load_json(path))
            continue
        answer = draw_case(settings.seed, plan, misfit=settings.misfit).answer
        device, effects, (first, recorded), noise = runs_of(
            settings.seed, plan, answer, misfit=settings.misfit
        )
        anew = plan.kind == "always"
        commands = (first, recorded) if anew else (recorded,)
        size = left_after_refit(device, effects, commands, noise, anew=anew)
        (effect,) = plan.effects
        line = {
            "seed": settings.seed,
            "index": plan.index,
            "kind": plan.kind,
            "device": plan.device,
            "effect": effect,
        }
        line |= {"condition": plan.condition, "before": size.before, "left": size.left}
        save_json(path, line)
        found.append(line)
        new += 1
        to_do -= 1
        rest = (time.monotonic() - begun) / new * to_do
        print(
            f"[{len(found)}/{len(cases)}] {settings.seed} case {plan.index:3d}  {plan.kind:8s}{plan.device:11s}{effect:26s}"
            f"{size.before:9.2f} noise powers, {size.left:7.2f} left; about {duration(rest)} left to run",
            flush=True,
        )
    return found


if __name__ == "__main__":
    sys.exit(main())
