"""What the last act conceals, and whether the diagnosis found it: no graph, no files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import yaml
from vo2_models.effects import effect, effect_ids
from vo2_models.page.page import formula, paragraph, section, table

__all__ = ["Concealed", "Outcome", "check_choice", "conceal", "diagnosis_section", "failed_section", "judge"]


@dataclass(frozen=True)
class Concealed:
    """The truth: one effect of the catalogue, or none (empty id)."""

    id: str = ""
    values: Mapping[str, float | str] = field(default_factory=dict)

    @property
    def plain(self) -> dict[str, dict[str, float | str]]:
        """Effect id -> values; empty for none."""
        return {self.id: dict(self.values)} if self.id else {}

    @property
    def as_parameter(self) -> str:
        """The parameter `effects` of the plant: YAML in one line, as a command line passes it."""
        return yaml.safe_dump(self.plain, default_flow_style=True, width=10_000).strip() if self.id else ""

    @property
    def in_words(self) -> str:
        """The effect with its magnitude."""
        if not self.id:
            return "no effect"
        given = {name: value for name, value in self.values.items() if name != "signal"}
        place = f" on {self.values['signal']}" if "signal" in self.values else ""
        units = {parameter.name: parameter.unit for parameter in effect(self.id).parameters}
        sizes = ", ".join(f"{name} {_number(value, units[name])}" for name, value in given.items())
        return f"{self.id}{place} ({sizes})"


@dataclass(frozen=True)
class Outcome:
    """How an answer compares with the truth.

    Attributes
    ----------
    right : exactly the concealed effect is named, on its signal; or nothing, where nothing was concealed
    limit_stated : not named, but told to be inseparable from what is named, or not excited
    sentence : the same in words
    """

    right: bool
    limit_stated: bool
    sentence: str


def check_choice(choice: str, preset: str) -> None:
    """Raise a `ValueError` that lists what can be concealed, unless `choice` is one of it."""
    known = (*effect_ids(preset), "random", "none")
    if choice not in known:
        raise ValueError(f"--effect: found {choice!r}, need one of {', '.join(known)}")


def conceal(choice: str, preset: str, seed: int) -> Concealed:
    """Draw an effect and its magnitude from the seed; `choice` is an id, `random` or `none`."""
    check_choice(choice, preset)
    if choice == "none":
        return Concealed()
    rng = np.random.default_rng(seed)
    # drawn in any case: the same seed gives the same magnitude whether the id was chosen or drawn
    drawn = str(rng.choice(effect_ids(preset)))
    name = drawn if choice == "random" else choice
    return Concealed(name, effect(name).draw(preset, rng))


def judge(answer: Mapping[str, Any], truth: Concealed) -> Outcome:
    """Compare a `diagnosis.json` with what was concealed."""
    named = [(each["id"], each.get("signal") or "") for each in answer["effects"] if each["id"] != "unknown"]
    if not truth.id:
        right = answer["verdict"] == "agrees"
        return Outcome(
            right, False, "Right: nothing was concealed." if right else "Wrong: nothing was concealed."
        )
    wanted = (truth.id, str(truth.values.get("signal", "")))
    if named == [wanted]:
        return Outcome(True, False, f"Right: {truth.in_words} was concealed.")
    rivals = sorted({name for pair in answer["indistinguishable"] if truth.id in pair for name in pair})
    was = f"{truth.in_words} was concealed"
    if wanted in named:
        return Outcome(False, False, f"Partly right: {was}, and something else was named beside it.")
    if rivals:
        return Outcome(
            False, True, f"Not named first, but told to be inseparable here ({' / '.join(rivals)}): {was}."
        )
    if truth.id in answer.get("not_excited", ()):
        return Outcome(False, True, f"Not named, but told to be not excited by this recording: {was}.")
    if answer["verdict"] == "agrees":
        return Outcome(False, False, f"Missed: {was}.")
    return Outcome(False, False, f"Wrong: {was}.")


def diagnosis_section(
    answer: Mapping[str, Any], truth: Concealed, outcome: Outcome, seed: int, *, figure: str = ""
) -> str:
    """Return the report's section: verdict, place, physics, gain (with a figure), and only then the truth."""
    parts = [
        paragraph(
            "The device was given a change, or none, that nobody told the diagnosis about. It got the recording of "
            "10 000 samples and the model identified above."
        ),
        paragraph(answer.get("summary", f"Verdict: {answer['verdict']}.")),
    ]
    if answer["location"]:
        rows = [
            [
                each["signal"],
                f"{100 * each['share']:.0f} %",
                each["branch"],
                " to ".join(f"{value:.1f}" for value in each["temperature_degC"] or ()) or "-",
                " to ".join(f"{value:.3g}" for value in each["frequency_hz"]),
            ]
            for each in answer["location"]
        ]
        heads = ["channel", "share of the excess", "branch", "temperature [°C]", "frequency [Hz]"]
        parts.append(table("Where simulation and recording differ", heads, rows))
    for each in answer["effects"]:
        place = f" on {each['signal']}" if each.get("signal") else ""
        parts.append(
            paragraph(f"{each['id']}{place}, probability {each['probability']:.2f}. {each['statement']}")
        )
        parts.append(formula(each["equation"]))
        if each["parameters"]:
            rows = [
                [name, f"{p['value']:.4g}", f"{p['std']:.2g}", p["unit"]]
                for name, p in each["parameters"].items()
            ]
            parts.append(table("Parameters", ["name", "value", "standard deviation", "unit"], rows))
    rows = [
        [channel, *(f"{100 * fit[key]:.3f}" for key in ("nrmse_before", "nrmse_after", "noise_floor"))]
        for channel, fit in answer["fit"].items()
    ]
    parts.append(
        table(
            "Root mean square error on held-out parts [% of range]",
            ["channel", "before", "after the correction", "noise floor"],
            rows,
        )
    )
    if figure:
        parts.append(figure)
    parts.append(paragraph(f"{outcome.sentence} Seed {seed}."))
    parts.append(
        '<p>More in the <a href="diagnosis/report.html">report of the diagnosis</a>; '
        'the corrected model is <a href="diagnosis/corrected_model.yaml">corrected_model.yaml</a>.</p>'
    )
    return section("Diagnosis of a concealed change", *parts)


def failed_section(reason: str, truth: Concealed, seed: int) -> str:
    """Return the section of a diagnosis that gave no answer."""
    return section(
        "Diagnosis of a concealed change",
        paragraph(f"FAILED: {reason}"),
        paragraph(f"Concealed was {truth.in_words}, seed {seed}."),
    )


def _number(value: float | str, unit: str) -> str:
    return f"{float(value):.4g}" + (f" {unit}" if unit not in ("", "1") else "")
