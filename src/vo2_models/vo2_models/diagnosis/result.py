"""What a diagnosis says: the records behind `diagnosis.json` (schema vo2-diagnosis/1), and its check."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal

from vo2_models.io import write_whole

__all__ = [
    "FAMILIES",
    "RESULTS",
    "SCHEMA",
    "Candidate",
    "ChannelFit",
    "Diagnosis",
    "Estimate",
    "Location",
    "MovedConstant",
    "NamedEffect",
    "NextExperiment",
    "RecordingAnswer",
    "validate",
]

SCHEMA = "vo2-diagnosis/1"
RESULTS = ("diagnosis.json", "report.html", "corrected_model.yaml")
"""What a diagnosis writes into its folder."""
ROUNDING, SUMMED = 1e-9, 1e-6
"""By how much a share, and a sum of them, may be more than one."""
FAMILIES = ("drive", "heat", "transition", "film", "structure", "sensor", "clock")
"""What a family begins with; sensor and clock have `:CHANNEL` behind."""


@dataclass(frozen=True)
class Location:
    """Where excess residual energy sits: one entry per channel that has any."""

    signal: str
    share: float
    time_s: list[list[float]]
    branch: Literal["heating", "cooling", "both"]
    temperature_degC: list[float] | None
    temperature_surrogate_a: list[float]
    frequency_hz: list[float]


@dataclass(frozen=True)
class Estimate:
    """A parameter with its standard deviation."""

    value: float
    std: float
    unit: str


@dataclass(frozen=True)
class NamedEffect:
    """One thing the simulation left out, or "unknown".

    Attributes
    ----------
    id, signal : the effect, and on which channel where it sits on one
    probability : 0 to 1; of a set that of all its members together, whereas the candidate "unknown" is in no catalogue
    statement, equation : in words and as the added term
    parameters : name -> estimate
    family : drive, heat, transition, film, structure, sensor:CHANNEL or clock:CHANNEL
    form : what it does, and which of the forms of its class it has
    siblings : ids that these recordings do not tell from it; the family is the answer then. Of "unknown": it is one of these
    """

    id: str
    probability: float
    statement: str
    equation: str
    parameters: dict[str, Estimate]
    signal: str | None = None
    family: str = ""
    form: str = ""
    siblings: list[str] = field(default_factory=list)


@dataclass(frozen=True)
class MovedConstant:
    """A constant that has moved since the calibration; in one `recording` only where that is not empty."""

    constant: str
    was: float
    now: float
    std: float
    unit: str
    recording: str = ""

    def __str__(self) -> str:
        """Its name, and which recording it is of."""
        return self.constant + (f" of {self.recording}" if self.recording else "")


@dataclass(frozen=True)
class Candidate:
    """An effect that was considered.

    Attributes
    ----------
    id, signal : the effect, and on which channel where it may act on several
    probability : 0 to 1
    held_out_nrmse : channel -> root mean square error over range on parts that were not fitted: measured for the answer;
        of a rival estimated from it, by how much more of the excess the rival leaves
    explained_share : share of the excess that it explains by itself, 0 to 1
    why_not : why it is not the answer; empty for the answer, but where that is a set of effects: that it is one of the set
    """

    id: str
    probability: float
    held_out_nrmse: dict[str, float]
    signal: str | None = None
    explained_share: float = 0.0
    why_not: str = ""


@dataclass(frozen=True)
class ChannelFit:
    """Root mean square error over range, on held-out parts."""

    nrmse_before: float
    nrmse_after: float
    noise_floor: float


@dataclass(frozen=True)
class NextExperiment:
    """What to record next, and what it would separate: "unknown" twice where it is to cover what no recording has."""

    why: str
    separates: list[str]
    kind: Literal["excitation", "manual"]
    excitation: dict[str, Any] | None
    instruction: str


@dataclass(frozen=True)
class RecordingAnswer:
    """What is said of one recording, where not all have the same answer.

    Attributes
    ----------
    recording : its name
    verdict, effects, moved : as of a diagnosis
    judged_with : names of the recordings that were judged together, this one among them
    """

    recording: str
    verdict: Literal["agrees", "drifted", "differs"]
    effects: list[NamedEffect]
    moved: list[MovedConstant]
    judged_with: list[str]


@dataclass(frozen=True)
class Diagnosis:
    """Everything `diagnosis.json` holds.

    `summary`, `limits` (of the data, in words), `not_excited`, `excess`, `seconds` and `decision_limits` (of the method,
    each with its provenance) go beyond the schema, and `adequacy`: `of` the best answer, named or not, the share of the excess
    that is `explained`, the excess power `left` beyond it in noise powers of a sample, and how surely its effects act, in
    standard deviations by the scatter over stretches (`sigmas`); `own_misfit`: of resistance and deflection size
    (`level`, log10 ohm or m) and length (`travel_k`, K) of the misfit that the calibration shows, and by how many noise
    powers it missed the worst stretch of it that was left out (`left_out`); `recordings`: the answer of each, in the order
    given, where not all have the same. All else is of one of them then.
    """

    verdict: Literal["agrees", "drifted", "differs"]
    location: list[Location]
    effects: list[NamedEffect]
    candidates: list[Candidate]
    fit: dict[str, ChannelFit]
    indistinguishable: list[list[str]]
    next_experiment: NextExperiment | None
    moved: list[MovedConstant] = field(default_factory=list)
    summary: str = ""
    limits: list[str] = field(default_factory=list)
    not_excited: list[str] = field(default_factory=list)
    excess: dict[str, float] = field(default_factory=dict)
    seconds: float = 0.0
    decision_limits: dict[str, dict[str, float | str]] = field(default_factory=dict)
    adequacy: dict[str, float | list[str]] = field(default_factory=dict)
    own_misfit: dict[str, dict[str, float]] = field(default_factory=dict)
    recordings: list[RecordingAnswer] = field(default_factory=list)

    def to_dict(self) -> dict[str, Any]:
        """Return plain JSON types; `signal` is left out where an effect has none."""
        plain = {"schema": SCHEMA, **asdict(self)}
        for answer in (plain, *plain["recordings"]):
            for entry in answer["moved"]:
                entry["is"] = entry.pop("now")  # a keyword of Python
                if not entry["recording"]:
                    del entry["recording"]
            for key in ("effects", "candidates"):
                answer |= {
                    key: [
                        {k: v for k, v in entry.items() if not (k == "signal" and v is None)}
                        for entry in answer.get(key, [])
                    ]
                }
        return plain

    def save(self, path: str | Path) -> None:
        """Write `diagnosis.json`.

        Raises
        ------
        ValueError : the content breaks the schema; nothing is written.
        """
        plain = self.to_dict()
        validate(plain)
        write_whole(path, json.dumps(plain, indent=1, allow_nan=False) + "\n")


def validate(plain: Mapping[str, Any]) -> None:
    """Check a diagnosis read from JSON against the schema vo2-diagnosis/1.

    Parameters
    ----------
    plain : the document, as `Diagnosis.to_dict` makes it

    Raises
    ------
    ValueError : naming the first key that is missing or out of range.
    """

    def need(condition: bool, what: str) -> None:
        if not condition:
            raise ValueError(f"diagnosis: {what}")

    need(plain.get("schema") == SCHEMA, f"schema: found {plain.get('schema')!r}, need {SCHEMA!r}")
    for key in (
        "verdict", "moved", "location", "effects", "candidates", "fit", "indistinguishable", "next_experiment",
    ):  # fmt: skip
        need(key in plain, f"{key}: missing")
    need(plain["verdict"] in ("agrees", "drifted", "differs"), f"verdict: found {plain['verdict']!r}")
    need(
        plain["verdict"] == "differs" or not plain["effects"],
        "effects: found some, need none unless it differs",
    )
    need(
        plain["verdict"] != "drifted" or bool(plain["moved"]),
        "moved: found none, need one where it has drifted",
    )
    for entry in plain["moved"]:
        need(
            bool(entry["constant"])
            and all(math.isfinite(entry[k]) for k in ("was", "is", "std"))
            and entry["std"] >= 0,
            f"moved {entry['constant']}: need finite was, is and std",
        )
    for entry in plain["location"]:
        need(0 <= entry["share"] <= 1 + ROUNDING, f"location share: found {entry['share']}, need 0 to 1")
        need(entry["branch"] in ("heating", "cooling", "both"), f"branch: found {entry['branch']!r}")
        for key in ("temperature_surrogate_a", "frequency_hz"):
            need(len(entry[key]) == 2 and entry[key][0] <= entry[key][1], f"{key}: need [low, high]")
        need(all(a <= b for a, b in entry["time_s"]), "time_s: need [start, end] pairs")
    total = sum(entry["share"] for entry in plain["location"])
    need(total <= 1 + SUMMED, f"location shares: they sum to {total:g}, need at most 1")
    need(
        sum(entry["probability"] for entry in plain["candidates"])
        <= max(1, len(plain["effects"])) * (1 + SUMMED),
        "candidates: probabilities sum to more than the number of effects",
    )
    for entry in (*plain["effects"], *plain["candidates"]):
        need(isinstance(entry["id"], str) and bool(entry["id"]), "id: need a text")
        need(0 <= entry["probability"] <= 1, f"probability: found {entry['probability']}")
    for entry in plain["effects"]:
        need(bool(entry["statement"]) and bool(entry["equation"]), f"{entry['id']}: need words and equation")
        family = entry["family"].partition(":")[0]
        need(
            family in FAMILIES,
            f"{entry['id']} family: found {entry['family']!r}, need one of {', '.join(FAMILIES)}",
        )
        for name, estimate in entry["parameters"].items():
            need(
                math.isfinite(estimate["value"]) and estimate["std"] >= 0 and "unit" in estimate,
                f"{entry['id']}.{name}: need finite value, std >= 0 and unit",
            )
    for channel, values in plain["fit"].items():
        for key in ("nrmse_before", "nrmse_after", "noise_floor"):
            need(math.isfinite(values[key]) and values[key] >= 0, f"fit {channel} {key}: need >= 0")
    nxt = plain["next_experiment"]
    if nxt is not None:
        need(nxt["kind"] in ("excitation", "manual"), f"next_experiment kind: found {nxt['kind']!r}")
        need(len(nxt["separates"]) == 2, "next_experiment separates: need two ids")
        need(
            (nxt["excitation"] is not None) == (nxt["kind"] == "excitation"), "excitation: only with its kind"
        )
