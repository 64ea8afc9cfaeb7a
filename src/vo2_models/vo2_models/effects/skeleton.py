"""`new-effect NAME`: write a commented effect file that passes its checks, to be filled with physics."""

from __future__ import annotations

import argparse
import keyword
import sys
from collections.abc import Sequence
from pathlib import Path

from vo2_models.effects.catalogue import effect_ids

__all__ = ["main", "skeleton"]

_TEXT = '''"""TITLE: one line."""

import math

from vo2_models.effects.record import HEAT, Effect, State, constant_of

EFFECT = Effect(
    id="NAME",  # the file's name
    stage="thermal",  # driver, thermal, transition, terminals, structure or sensor: where it acts
    # name, neutral value (the effect is off), SI unit, meaning, lower and upper physical bound
    parameters=(
        constant_of("share", 0, "1", "part of the steady temperature rise that arrives late", -0.5, 0.5),
        constant_of("time_constant", 1, "s", "time constant of the late part", 1e-5, 1e6),
    ),
    # memories; `settled` below says what they hold after a long rest
    states=(State("late", "K", "temperature rise of the slow body"),),
    channels=HEAT,  # what it can reach: a diagnosis looks nowhere else
    needs=("body",),  # what a device must have: body, heater, pump, one body, resistance
    # clearly visible magnitudes on a shipped device; scaled to others by their natural units
    typical={"integrated": {"share": (0.03, 0.1), "time_constant": (0.02, 0.2)}},
    equation="T = T0 + (1 - share) theta + share theta_2; tau d theta_2 / dt = k1 i + k2 i^2 - theta_2",
    excitation="steps held for several time constants",
    source="where the equation comes from",
    statement="What a reader of a report must know of it, in a few plain sentences.",
)


# Hooks: functions by name (see effects/record.py, HOOKS). They are compiled; what they need they name as arguments:
# quantities of their stage, own parameters, own states. A step of a thermal effect lasts h [s].
def settled(drive):
    """Every state after a long rest."""
    return drive


def advance(drive, h, late, time_constant):
    """Every state after a step."""
    return late - math.expm1(-h / time_constant) * (drive - late)


def body(late, share):
    """Change of the body's temperature per kelvin of rise, and kelvins added to it."""
    return -share, share * late
'''


def skeleton(name: str) -> str:
    """Return the text of an effect file.

    Raises
    ------
    ValueError : a name that is no identifier of Python in small letters, or an effect's that is known.
    """
    if not name.isidentifier() or keyword.iskeyword(name) or name != name.lower():
        raise ValueError(
            f"NAME: found {name!r}, need small letters, digits and underscores, as in slow_anchor"
        )
    if name in effect_ids():
        raise ValueError(f"NAME: found {name!r}, which the catalogue has already; give another")
    return _TEXT.replace("NAME", name).replace("TITLE", name.replace("_", " ").capitalize())


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command `new-effect`; return its exit status: 0, 2 on bad input, 130 after Ctrl-C.

    Parameters
    ----------
    arguments : command line, None for that of the process
    """
    parser = argparse.ArgumentParser(
        prog="new-effect", description="Write a commented effect file to start from."
    )
    parser.add_argument("name", metavar="NAME", help="id of the effect, and name of the file")
    parser.add_argument(
        "--output", type=Path, default=Path(), metavar="DIR", help="folder (default: this one)"
    )
    given = parser.parse_args(arguments)
    target = given.output / f"{given.name}.py"
    try:
        text = skeleton(given.name)
        given.output.mkdir(parents=True, exist_ok=True)
        with target.open("x", encoding="utf-8") as stream:
            stream.write(text)
    except FileExistsError:
        print(f"new-effect: {target}: is there already; give another name or folder", file=sys.stderr)
        return 2
    except (ValueError, OSError) as error:
        print(f"new-effect: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        print(f"new-effect: interrupted; see whether {target} is whole", file=sys.stderr)
        return 130
    print(
        f"{target}: fill in the physics, then `fit`, `diagnose` and `plant` take it with --effects {given.output}"
    )
    return 0
