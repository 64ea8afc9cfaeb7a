"""A diagnosis at work in a thread of its own, and its answer in the few words that `/diagnostics` has room for."""

from __future__ import annotations

import threading
import traceback
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

from vo2_models.parameters import Value
from vo2_models.recording import Recording

if TYPE_CHECKING:
    from vo2_models.diagnosis.result import Diagnosis

__all__ = ["DiagnosisJob", "summary_values"]


class _CancelledError(Exception):
    """Nobody wants the answer any more."""


@dataclass
class DiagnosisJob:
    """One recording against one model.

    Attributes
    ----------
    recording, parameters : what is compared; flat `model.*` parameters
    share, text : progress, 0 to 1, and what is being done
    answer : once it is done
    error : why there is no answer
    """

    recording: Recording
    parameters: Mapping[str, Value]
    share: float = 0.0
    text: str = "starting"
    answer: Diagnosis | None = None
    error: str = ""
    _thread: threading.Thread = field(init=False)
    _cancelled: bool = False

    def __post_init__(self) -> None:
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    @property
    def running(self) -> bool:
        """Whether it is still at work."""
        return self._thread.is_alive()

    def cancel(self) -> None:
        """Give up; the thread ends at its next step, and there will be no answer."""
        self._cancelled = True

    def _run(self) -> None:
        try:
            # the compiler and the simulation load only now
            from vo2_models.diagnosis.pipeline import diagnose

            self.answer = diagnose([self.recording], self.parameters, progress=self._note)
        except _CancelledError:
            self.error = "cancelled"
        except ValueError as error:
            self.error = f"the recording cannot be diagnosed: {' '.join(str(error).split())}"
        except Exception as error:  # a thread has nobody above it: what it dies of must reach the operator
            traceback.print_exc()
            self.error = f"the diagnosis broke down: {error!r}; the log has the traceback"

    def _note(self, share: float, text: str) -> None:
        if self._cancelled:
            raise _CancelledError
        self.share, self.text = share, text


def summary_values(answer: Diagnosis) -> dict[str, str]:
    """Return key -> value for a diagnostic status: verdict, effects with probability, parameters, gain.

    Parameters
    ----------
    answer : a diagnosis
    """
    values = {"verdict": answer.verdict, "effects": ", ".join(each.id for each in answer.effects)}
    for each in answer.effects:
        name = f"{each.id}:{each.signal}" if each.signal else each.id
        values[f"{name} probability"] = f"{each.probability:.3f}"
        for parameter, estimate in each.parameters.items():
            unit = "" if estimate.unit in ("", "1") else f" {estimate.unit}"
            values[f"{name} {parameter}"] = f"{estimate.value:.4g} +- {estimate.std:.2g}{unit}"
    for channel, fit in answer.fit.items():
        values[f"{channel} nrmse"] = f"{fit.nrmse_before:.3g} -> {fit.nrmse_after:.3g}"
    if answer.indistinguishable:
        values["indistinguishable"] = ", ".join(" / ".join(pair) for pair in answer.indistinguishable)
    return values
