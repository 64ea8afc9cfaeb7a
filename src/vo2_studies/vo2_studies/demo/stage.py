"""What the acts of the demo share: the graph, the folder, and what was found so far."""

from __future__ import annotations

import subprocess
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from vo2_models.command_line import Progress
from vo2_models.recording import Recording

from vo2_studies.demo.concealed import Concealed
from vo2_studies.demo.conductor import Conductor
from vo2_studies.demo.graph import Graph

__all__ = ["Diagnosing", "Phase", "Stage"]


@dataclass(frozen=True)
class Phase:
    """A stretch of a recording, by stamps.

    Attributes
    ----------
    name : `identification`, `random`, `steps`, `sine`, `multisine`
    namespace : loop it belongs to
    start_s, end_s : first and last stamp [s]
    """

    name: str
    namespace: str
    start_s: float
    end_s: float


@dataclass(frozen=True)
class Diagnosing:
    """A diagnosis at work: its process, when it began, its log, what it reads and writes; and what was concealed."""

    process: subprocess.Popen[bytes]
    began: float
    log: Path
    bag: Path
    output: Path
    truth: Concealed

    def end(self) -> None:
        """Leave no process behind."""
        if self.process.poll() is None:
            self.process.kill()
            self.process.wait()


@dataclass
class Stage:
    """Shared by the acts, in the order in which they run.

    Attributes
    ----------
    folder : output folder
    preset, seed : device under test
    effect : effect to conceal in the last act: an id, `random` or `none`
    graph, conductor : the running nodes
    phases : what was recorded when
    metrics : what goes into metrics.json
    sections : HTML sections of the report, in order
    recordings : namespace -> role -> what the bag holds
    data : (scheme, phase) -> samples, for the figures
    diagnosing : the diagnosis, once it has been started
    progress : what `show` shows, on a terminal
    failures : what went wrong without ending the run; the demo's exit status tells that there is something
    """

    folder: Path
    preset: str
    seed: int
    effect: str
    graph: Graph
    conductor: Conductor
    phases: list[Phase] = field(default_factory=list)
    metrics: dict[str, Any] = field(default_factory=dict)
    sections: list[str] = field(default_factory=list)
    recordings: dict[str, dict[str, Recording]] = field(default_factory=dict)
    data: dict[tuple[str, str], Any] = field(default_factory=dict)
    diagnosing: Diagnosing | None = None
    failures: list[str] = field(default_factory=list)
    started: float = field(default_factory=time.monotonic)
    progress: Progress = field(default_factory=lambda: Progress("demo", lines=False), repr=False)

    @property
    def bag(self) -> Path:
        """The main recording."""
        return self.folder / "bag"

    @property
    def model_file(self) -> Path:
        """The identified model."""
        return self.folder / "model.yaml"

    def closing_lines(self) -> list[str]:
        """Return the few numbers that matter, one scheme a line."""
        lines = []
        for scheme in ("composite", "polynomial"):
            if scheme in self.metrics:
                errors = ", ".join(
                    f"{key.removesuffix('_mae_percent')} {value:.2f}"
                    for key, value in self.metrics[scheme].items()
                    if key.endswith("_mae_percent")
                )
                lines.append(f"{scheme} errors in % of range: {errors}")
        found = self.metrics.get("diagnosis", {})
        if "right" in found:
            named = ", ".join(found["effects"]) or "nothing"
            truth = ", ".join(found["concealed"]) or "nothing"
            lines.append(
                f"diagnosis: {named} named, {truth} concealed: {'right' if found['right'] else 'not right'}"
            )
        return lines

    def say(self, text: str) -> None:
        """Print one line of progress with the time since the start."""
        self.hush()
        print(f"[{time.monotonic() - self.started:5.1f} s] {text}", flush=True)

    def show(self, text: str) -> None:
        """Show what is going on in place, on a terminal."""
        self.progress(None, f"[{time.monotonic() - self.started:5.1f} s]   {text}")

    def hush(self) -> None:
        """Clear what `show` left."""
        self.progress.clear()
