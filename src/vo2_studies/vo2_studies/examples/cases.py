"""An example: which recordings calibrate, which are predicted, and what of them the fit is not given."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from numpy.typing import NDArray

__all__ = ["Case", "Example", "curve_of", "data_files", "held_out", "read_examples"]

_TOP = 0.05
"""Share of its span below its largest value from which a drive counts as back in saturation."""


@dataclass(frozen=True)
class Case:
    """One fit.

    Attributes
    ----------
    calibrate, predict : files below the example's data folder
    hold : what of the calibration is held out, as `held_out` takes it; empty where other files are predicted
    """

    calibrate: tuple[str, ...]
    predict: tuple[str, ...]
    hold: Mapping[str, float]

    @property
    def name(self) -> str:
        """Name of folders and rows."""
        return Path(self.calibrate[0]).name.split(".csv")[0].removesuffix(".dat")


@dataclass(frozen=True)
class Example:
    """One set of measured data: the folder with its device file and map, where its files lie, and its cases."""

    folder: Path
    title: str
    data: str
    cases: tuple[Case, ...]


def read_examples(folder: Path) -> list[Example]:
    """Return all examples of a folder, in alphabetical order.

    Raises
    ------
    ValueError : none there, or a file that is not as it should be.
    """
    found = []
    for path in sorted(folder.glob("*/example.yaml")):
        content: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
        try:
            cases = tuple(
                Case(tuple(one["calibrate"]), tuple(one.get("predict", ())), dict(one.get("held_out", {})))
                for one in content["cases"]
            )
            found.append(Example(path.parent, str(content["title"]), str(content["folder"]), cases))
        except (KeyError, TypeError) as error:
            raise ValueError(
                f"{path}: found no {error}, need title, folder and cases with calibrate"
            ) from error
    if not found:
        raise ValueError(f"{folder}: found no */example.yaml, need the examples of this project")
    return found


def held_out(drive: NDArray[np.float64], hold: Mapping[str, float]) -> NDArray[np.bool_]:
    """Return which samples (n,) of a recording the fit is not given.

    `after`: all from this share of the samples on. `blocks` with `of`: each blocks-th block of this many samples.
    `curves`: each curves-th curve, where a curve begins when the drive comes back to saturation.

    Raises
    ------
    ValueError : none of these keys.
    """
    index = np.arange(drive.size)
    ways: dict[str, Callable[[], NDArray[np.bool_]]] = {
        "after": lambda: index >= hold["after"] * drive.size,
        "blocks": lambda: index // int(hold["of"]) % int(hold["blocks"]) == 1,
        "curves": lambda: curve_of(drive) % int(hold["curves"]) == 1,
    }
    for key, way in ways.items():
        if key in hold:
            return way()
    raise ValueError(f"held_out: found {dict(hold)}, need one of {', '.join(ways)}")


def curve_of(drive: NDArray[np.float64]) -> NDArray[np.intp]:
    """Number of the curve that each sample belongs to: it grows where the drive enters the top of its range."""
    top = drive > drive.max() - _TOP * float(np.ptp(drive))
    return np.cumsum(top & ~np.concatenate([[False], top[:-1]]))


def data_files(example: Example, data: Path, names: Sequence[str]) -> list[Path]:
    """Return the files of an example; raise a `ValueError` that names the first one that is not there."""
    found = [data / example.data / name for name in names]
    for path in found:
        if not path.is_file():
            raise ValueError(f"{path}: found no file, need the measured recordings (--data, or VO2_DATA)")
    return found
