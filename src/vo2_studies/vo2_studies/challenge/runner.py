"""The blind protocol: write the bags, hide the answers, run `fit` and `diagnose` as separate processes, keep results.

    DIR/answers/0007.json            the truth, never given to the processes below
    DIR/cases/0007/calibration|test  bags; removed once the case is finished, unless they are to be kept
    DIR/cases/0007/device.yaml       data sheet of a rig that is no preset
    DIR/cases/0007/model.yaml, diagnosis/, *.log   what fit and diagnose wrote
    DIR/models/NAME.yaml             fit of a calibration that several cases share
    DIR/results/0007.json            exit states, wall times, diagnosis; a case with this file is finished

Every file appears under its final name only when whole, so an interrupt at any time loses at most a case.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Protocol

import yaml
from vo2_models.command_line import duration
from vo2_models.io import write_whole

from vo2_studies.challenge.conditions import write_recording
from vo2_studies.challenge.devices import Preset
from vo2_studies.challenge.draw import Case, draw_case, draw_rig, follow_up_recording
from vo2_studies.challenge.plan import CasePlan, Choice, plan_case

__all__ = [
    "INTERRUPTED",
    "CaseRunner",
    "Paths",
    "Settings",
    "finished",
    "interrupt_on_sigterm",
    "load_json",
    "run_all",
    "save_json",
    "write_case",
]

INTERRUPTED = "interrupted; finished cases are kept, the same command continues"

KEYS = ("verdict", "location", "effects", "candidates", "fit", "indistinguishable", "next_experiment")


class Drawing(Protocol):
    """What cases come from: drawn devices (`Settings`) or measured ones (`recordings.draw.MeasuredSettings`)."""

    def plan(self, index: int) -> CasePlan: ...

    def case(self, plan: CasePlan) -> Case: ...


@dataclass(frozen=True)
class Settings:
    """What decides the cases: changing one of these in a begun folder is refused."""

    seed: int
    misfit: float = 0.1
    choice: Choice = field(default_factory=Choice)

    def plan(self, index: int) -> CasePlan:
        """Return the plan of case `index`."""
        return plan_case(self.seed, index, self.choice)

    def case(self, plan: CasePlan) -> Case:
        """Draw the case of `plan`."""
        return draw_case(self.seed, plan, misfit=self.misfit)

    def rig(self, plan: CasePlan) -> Preset:
        """Return the rig of the case as its data sheet tells it."""
        return draw_rig(self.seed, plan)


@dataclass(frozen=True)
class Paths:
    """Places of one run below `root`."""

    root: Path

    def answer(self, index: int) -> Path:
        return self.root / "answers" / f"{index:04d}.json"

    def case(self, index: int) -> Path:
        return self.root / "cases" / f"{index:04d}"

    def model(self, calibration: str) -> Path:
        return self.root / "models" / f"{calibration}.yaml"

    def result(self, index: int) -> Path:
        return self.root / "results" / f"{index:04d}.json"


def save_json(path: Path, content: Any) -> None:
    """Write `content` as JSON so that `path` is whole or absent at any time."""
    write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")


def load_json(path: Path) -> Any:
    """Return the content of a JSON file."""
    return json.loads(path.read_text(encoding="utf-8"))


def finished(paths: Paths, index: int) -> bool:
    """Whether case `index` has its answer and its result."""
    return paths.result(index).exists() and paths.answer(index).exists()


@dataclass
class CaseRunner:
    """Runs cases, one call a case; safe to call from several threads.

    Attributes
    ----------
    settings, paths : what and where
    fit, diagnose : the commands in front of their options
    timeout_s : of each process
    keep_bags : leave the bags in place
    follow_up : play the proposed excitation on the concealed device and diagnose both recordings
    threads : numerical threads of each process, 0 for as many as it likes
    """

    settings: Drawing
    paths: Paths
    fit: Sequence[str] = (sys.executable, "-m", "vo2_identification.fit", "--simulation-only")
    diagnose: Sequence[str] = (sys.executable, "-m", "vo2_identification.diagnose")
    timeout_s: float = 300.0
    keep_bags: bool = False
    follow_up: bool = False
    threads: int = 0
    _running: set[subprocess.Popen] = field(default_factory=set)
    _lock: threading.Lock = field(default_factory=threading.Lock)
    _stopped: bool = False

    def run(self, plan: CasePlan) -> dict[str, Any]:
        """Run case `plan` unless it is finished; return its result.

        Raises
        ------
        InterruptedError : `stop` was called meanwhile; nothing was recorded.
        """
        paths, index = self.paths, plan.index
        if finished(paths, index):
            return load_json(paths.result(index))
        folder = paths.case(index)
        shutil.rmtree(folder, ignore_errors=True)  # an interrupted try
        case = self.settings.case(plan)
        device = write_case(case, paths)
        result = self._diagnose(plan, folder, device, paths.model(case.shared) if case.shared else None)
        if self.follow_up and result["diagnosis"] is not None:
            self._follow_up(plan, folder, result)
        save_json(paths.result(index), result)
        if not self.keep_bags:
            for name in ("calibration", "test", "follow_up", *(path.name for path in folder.glob("day_*"))):
                shutil.rmtree(folder / name, ignore_errors=True)
        return result

    def stop(self) -> None:
        """End the processes that this runner started and let no more start."""
        with self._lock:
            self._stopped = True
            running = list(self._running)
        for process in running:
            _end(process)

    def _diagnose(self, plan: CasePlan, folder: Path, device: str, shared: Path | None) -> dict[str, Any]:
        """Fit, unless the model of a shared calibration is there already, and diagnose."""
        result: dict[str, Any] = {
            "failure": "",
            "fit_seconds": None,
            "seconds": None,
            "diagnosis": None,
            "follow_up": None,
        }
        # relative paths from inside the case's folder: nothing in the command line leads to the answers
        fit = [*self.fit, "--bag", "calibration", "--device", device, "--output", "model.yaml"]
        failure = ""
        if shared is not None and shared.exists():
            shutil.copyfile(shared, folder / "model.yaml")
        else:
            failure, result["fit_seconds"] = self._process(fit, folder, "fit")
        if not failure and not (folder / "model.yaml").exists():
            failure = "fit: wrote no model"
        if not failure:
            if shared is not None and not shared.exists():
                shared.parent.mkdir(exist_ok=True)
                write_whole(shared, (folder / "model.yaml").read_text(encoding="utf-8"))
            others = sorted(path.name for path in folder.glob("day_*"))
            command = [*self.diagnose, *_recordings(plan, "test", *others), "--output", "diagnosis"]
            failure, result["seconds"] = self._process(command, folder, "diagnose")
        if not failure:
            result["diagnosis"], failure = _read_diagnosis(folder / "diagnosis" / "diagnosis.json")
        result["failure"] = failure
        return result

    def _follow_up(self, plan: CasePlan, folder: Path, result: dict[str, Any]) -> None:
        """Play the proposed excitation, if there is one, and diagnose both recordings together."""
        from vo2_studies.challenge.excitation import played_current

        experiment = result["diagnosis"]["next_experiment"]
        settings = self.settings
        if experiment is None or experiment["kind"] != "excitation" or not isinstance(settings, Settings):
            return  # a measured device is not at hand
        try:
            current = played_current(experiment["excitation"], settings.rig(plan))
        except (TypeError, ValueError) as error:
            result["follow_up_failure"] = f"not playable: {error}"
            return
        answer = load_json(self.paths.answer(plan.index))
        recording = follow_up_recording(
            settings.seed,
            plan,
            answer,
            current,
            misfit=settings.misfit,
        )
        write_recording(folder / "follow_up", recording.measurement, recording.commands)
        command = [*self.diagnose, *_recordings(plan, "test", "follow_up")]
        failure, _ = self._process([*command, "--output", "diagnosis_2"], folder, "follow_up")
        if not failure:
            result["follow_up"], failure = _read_diagnosis(folder / "diagnosis_2" / "diagnosis.json")
        result["follow_up_failure"] = failure

    def _process(self, command: Sequence[str], folder: Path, name: str) -> tuple[str, float]:
        """Run `command` in `folder`; return why it failed (or "") and its wall time [s]."""
        environment = dict(os.environ)
        if self.threads:
            for key in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "NUMBA_NUM_THREADS"):
                environment[key] = str(self.threads)
        start = time.monotonic()
        with (folder / f"{name}.log").open("wb") as log:
            with self._lock:
                if self._stopped:
                    raise InterruptedError
                process = subprocess.Popen(
                    command, cwd=folder, stdout=log, stderr=log, env=environment, start_new_session=True
                )
                self._running.add(process)
            try:
                code = process.wait(self.timeout_s)
            except subprocess.TimeoutExpired:
                _end(process)
                return f"{name}: no result within {self.timeout_s:g} s", time.monotonic() - start
            finally:
                with self._lock:
                    self._running.discard(process)
        if self._stopped:
            raise InterruptedError
        return ("" if code == 0 else f"{name}: exit status {code}"), time.monotonic() - start


@contextlib.contextmanager
def interrupt_on_sigterm() -> Iterator[None]:
    """Treat SIGTERM as Ctrl-C while inside, so that no started process is left behind."""

    def interrupt(number: int, frame: object) -> None:
        raise KeyboardInterrupt

    if threading.current_thread() is not threading.main_thread():
        yield  # signals can be handled in the main thread only
        return
    before = signal.signal(signal.SIGTERM, interrupt)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, before)


def run_all(
    plans: Sequence[CasePlan],
    runner: CaseRunner,
    jobs: int,
    words: Callable[[CasePlan, dict[str, Any]], str] = lambda plan, result: "",
) -> bool:
    """Run what is not finished, with progress and the remaining time on stderr; return False when interrupted.

    Parameters
    ----------
    plans, runner, jobs : what, how, and how many at a time
    words : of a case and its result, for its line
    """
    left = [plan for plan in plans if not finished(runner.paths, plan.index)]
    kept = len(plans) - len(left)
    if kept:
        print(f"{kept} finished cases kept", file=sys.stderr)
    start = time.monotonic()
    pool = ThreadPoolExecutor(jobs)
    waiting: dict[Future, CasePlan] = {pool.submit(runner.run, plan): plan for plan in left}
    try:
        count = 0
        while waiting:
            ready, _ = wait(waiting, return_when=FIRST_COMPLETED)
            for future in ready:
                plan = waiting.pop(future)
                result = future.result()
                count += 1
                rest = (time.monotonic() - start) / count * (len(left) - count)
                state = result["failure"] or f"diagnosed in {result['seconds']:.1f} s"
                said = words(plan, result)
                print(
                    f"[{kept + count}/{len(plans)}] case {plan.index:04d} {plan.device}: {state}"
                    f"{said and ', ' + said}; about {duration(rest)} left",
                    file=sys.stderr,
                    flush=True,
                )
    except KeyboardInterrupt:
        print(INTERRUPTED, file=sys.stderr)
        return False
    finally:
        for future in waiting:
            future.cancel()
        if waiting:
            runner.stop()
        pool.shutdown()
    return True


def write_case(case: Case, paths: Paths) -> str:
    """Write answer and bags of a case, and the device file of a rig that is no preset; return what `fit` calls it."""
    folder = paths.case(case.plan.index)
    folder.mkdir(parents=True, exist_ok=True)
    save_json(paths.answer(case.plan.index), case.answer)
    for name, recorded in (("calibration", case.calibration), ("test", case.test), *case.others):
        write_recording(folder / name, recorded.measurement, recorded.commands)
    if case.document is None:
        return case.plan.device
    write_whole(folder / "device.yaml", yaml.safe_dump(dict(case.document), sort_keys=False))
    return "device.yaml"


def _recordings(plan: CasePlan, *bags: str) -> list[str]:
    """Return the options of `diagnose` for the recordings of a case."""
    given = [part for bag in bags for part in ("--bag", bag)]
    if plan.kind == "always":
        given += ["--calibration", "calibration"]
    return [*given, "--model", "model.yaml"]


def _end(process: subprocess.Popen) -> None:
    """End a process of ours and its children."""
    for number in (signal.SIGTERM, signal.SIGKILL):
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, number)
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(3)
            return


def _read_diagnosis(path: Path) -> tuple[Mapping[str, Any] | None, str]:
    """Return the diagnosis and "", or None and what is wrong with the file."""
    if not path.exists():
        return None, "diagnose: wrote no diagnosis.json"
    try:
        diagnosis = load_json(path)
    except ValueError:
        return None, "diagnose: diagnosis.json is not JSON"
    if not isinstance(diagnosis, dict) or diagnosis.get("schema") != "vo2-diagnosis/1":
        return None, "diagnose: diagnosis.json is not of schema vo2-diagnosis/1"
    if missing := [key for key in KEYS if key not in diagnosis]:
        return None, f"diagnose: diagnosis.json lacks {', '.join(missing)}"
    return diagnosis, ""
