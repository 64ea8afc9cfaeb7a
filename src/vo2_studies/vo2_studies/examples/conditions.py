"""Conditions that the authors of measured data changed: what an expert answers beside what the diagnosis says."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml
from vo2_identification.bags import read_recording, write_bag
from vo2_identification.conversion.column_map import read_map
from vo2_identification.conversion.converting import convert_file
from vo2_models.device.description import DeviceDescription, preset
from vo2_models.diagnosis.files import write_results
from vo2_models.diagnosis.pipeline import study
from vo2_models.diagnosis.result import Diagnosis
from vo2_models.identification.model_fit import fit_model
from vo2_models.model_file import save_model_parameters
from vo2_models.recording import HEATER_CURRENT, Recording

from vo2_studies.examples.cases import Example, curve_of

__all__ = ["AGREEMENT", "Asked", "Condition", "agreement", "ask", "read_conditions"]

AGREEMENT = (
    "same",
    "same family",
    "unknown, same family",
    "another verdict",
    "another family",
    "wrong name",
    "not asked",
)
"""How a tool's answer stands to an expert's, best first."""
_HALVES = ("first half", "second half")


@dataclass(frozen=True)
class Condition:
    """What was changed, and what an expert answers.

    Attributes
    ----------
    id, changed, source : in words
    calibrate, diagnose : recordings, each a path below the data folder, perhaps with ", " and a part of it
    verdict, names, families : that are right; verdict "agrees" or "drifted" has no name
    """

    id: str
    changed: str
    source: str
    calibrate: tuple[str, ...]
    diagnose: tuple[str, ...]
    verdict: tuple[str, ...]
    names: tuple[str, ...]
    families: tuple[str, ...]

    @property
    def expected(self) -> str:
        """The expert's answer in words."""
        named = ", ".join(self.names) or "no name"
        family = f"; family {', '.join(self.families)}" if self.families else ""
        return f"{' or '.join(self.verdict)}: {named}{family}"


@dataclass(frozen=True)
class Asked:
    """What the tool said of a condition.

    Attributes
    ----------
    condition : what was asked
    said : the answer in words, or why there is none
    agreement : of `AGREEMENT`
    names : effects that were named, "unknown" excluded
    """

    condition: Condition
    said: str
    agreement: str
    names: tuple[str, ...] = ()


def read_conditions(path: Path) -> list[Condition]:
    """Return the conditions of a file of schema `vo2-conditions/1`.

    Raises
    ------
    ValueError : another schema, or a missing key; with the file.
    """
    content: dict[str, Any] = yaml.safe_load(path.read_text(encoding="utf-8"))
    if content.get("schema") != "vo2-conditions/1":
        raise ValueError(f"{path}: schema: found {content.get('schema')!r}, need vo2-conditions/1")
    found = []
    for one in content["conditions"]:
        try:
            answer = one["answer"]
            found.append(
                Condition(
                    one["id"], one["changed"], one["source"], tuple(one["calibrate"]), tuple(one["diagnose"]),
                    tuple(answer["verdict"]), tuple(answer["name"]), tuple(answer["families"]),
                )
            )  # fmt: skip
        except KeyError as error:
            raise ValueError(f"{path}: {one.get('id', 'condition')}: found no {error}, need it") from error
    return found


def agreement(condition: Condition, diagnosis: Diagnosis) -> str:
    """Return how a diagnosis stands to the expert's answer, one of `AGREEMENT`.

    A name is wrong where the expert has none, or another one. "unknown" counts by its family.

    Parameters
    ----------
    condition, diagnosis : asked, and answered
    """
    names = [effect.id for effect in diagnosis.effects if effect.id != "unknown"]
    if set(names) - set(condition.names):
        return "wrong name"
    if diagnosis.verdict not in condition.verdict:
        return "another verdict"
    if names or diagnosis.verdict != "differs":
        return "same"
    if not diagnosis.effects or diagnosis.effects[0].family not in condition.families:
        return "another family"
    return "same family" if not condition.names else "unknown, same family"


def ask(condition: Condition, examples: Sequence[Example], data: Path, output: Path) -> Asked:
    """Calibrate and diagnose a condition; write model and diagnosis below `output`.

    Recordings that cannot be read, fitted or diagnosed give an answer that says so.
    """
    place = output / condition.id
    try:
        device, calibration = _recorded(condition.calibrate, examples, data, place / "calibration")
        _, others = _recorded(condition.diagnose, examples, data, place / "diagnosed")
        _, parameters = fit_model(calibration, device.key, names=condition.calibrate)
        save_model_parameters(place / "model.yaml", parameters)
        found = write_results(study(others, parameters, names=condition.diagnose), place)
    except ValueError as error:
        return Asked(condition, f"no answer: {error}", "not asked")
    entries = [
        f"{effect.id} ({effect.family}, probability {effect.probability:.2f})" for effect in found.effects
    ]
    said = f"{found.verdict}: {', '.join(entries) or 'no name'}"
    names = tuple(effect.id for effect in found.effects if effect.id != "unknown")
    return Asked(condition, said, agreement(condition, found), names)


def _recorded(
    named: Sequence[str], examples: Sequence[Example], data: Path, place: Path
) -> tuple[DeviceDescription, list[Recording]]:
    """Device and recordings in roles, converted with the map of the example whose data they are."""
    found, device = [], None
    for one in named:
        name, _, part = one.partition(", ")
        path = data / name
        owners = [e for e in examples if path.is_relative_to(data / e.data) and path.is_file()]
        if not owners:
            raise ValueError(f"{path}: found no file, need the measured recordings (--data, or VO2_DATA)")
        # the deepest folder that holds it, and there the map that is for such a file
        owner = max(owners, key=lambda e: (len(Path(e.data).parts), _maps(e, path)))
        if not _maps(owner, path):
            raise ValueError(
                f"{one}: has no column for a drive, and no map of {owner.folder.name} is for it; need one"
            )
        device = preset(owner.folder / "device.yaml")
        (converted,) = convert_file(path, read_map(owner.folder / "map.yaml"))
        # as a bag, so that it is read as any other
        bag = write_bag(place / one.replace("/", "_").replace(", ", "_"), converted.recording)
        found.append(_part(read_recording(bag, device=device)[0], part))
    if device is None:
        raise ValueError("condition: found no recording, need at least one")
    return device, found


def _maps(example: Example, path: Path) -> bool:
    """Whether the map of an example is for a file of this name."""
    return path.match(read_map(example.folder / "map.yaml").files)


def _part(recording: Recording, part: str) -> Recording:
    """A half of a recording, or of its curves."""
    if not part:
        return recording
    half = next((k for k, words in enumerate(_HALVES) if part.startswith(words)), None)
    if half is None:
        raise ValueError(f"{part}: found this part of a recording, need {' or '.join(_HALVES)}")
    middle = len(recording) // 2
    if part.endswith("of the curves"):
        curve = curve_of(recording[HEATER_CURRENT])
        middle = int(np.flatnonzero(curve > curve[-1] // 2)[0])
    return recording.slice(middle, len(recording)) if half else recording.slice(0, middle)
