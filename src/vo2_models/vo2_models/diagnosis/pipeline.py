"""The diagnosis as one function: recordings and a fitted simulation in, an answer with its evidence out.

Five stages, each of which returns a record that no later one changes: read, locate, search, decide, report.
"""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import replace

from threadpoolctl import threadpool_limits

from vo2_models.diagnosis.check import Unusable
from vo2_models.diagnosis.corrected_model import distance
from vo2_models.diagnosis.decide import decide, told_as, without_a_name
from vo2_models.diagnosis.limits import Limits
from vo2_models.diagnosis.locate import locate
from vo2_models.diagnosis.nominal import Nominal
from vo2_models.diagnosis.progress import Clock, Progress
from vo2_models.diagnosis.read import read
from vo2_models.diagnosis.report import assemble_diagnosis, equally_likely, unlikely
from vo2_models.diagnosis.result import Diagnosis
from vo2_models.diagnosis.search import search
from vo2_models.diagnosis.stages import Study
from vo2_models.parameters import Value
from vo2_models.recording import Recording, as_recordings

__all__ = ["diagnose", "study"]


def diagnose(
    recordings: Recording | Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    calibration: Recording | Sequence[Recording] = (),
    progress: Progress = lambda share, text: None,
) -> Diagnosis:
    """Compare recordings with a fitted simulation and say what was left out.

    Parameters
    ----------
    recordings : of one device, with the channels that it has, taken together
    model : flat `model.*` parameters as `load_model_parameters` reads them
    calibration : recordings that the model was fitted to, where what is looked for may have been there already: nominal
        device and effect are then fitted together over all recordings. Without, an effect is a change since
    progress : called with the share done, 0 to 1, and what is being done

    Returns
    -------
    verdict, effects with magnitudes and uncertainties, location, rivals and the next experiment

    Raises
    ------
    Unusable : (a ValueError) data or model with which nothing can be said; one line with the reason.
    """
    return assemble_diagnosis(study(recordings, model, calibration=calibration, progress=progress))


def study(
    recordings: Recording | Sequence[Recording],
    model: Mapping[str, Value] | Nominal,
    *,
    calibration: Recording | Sequence[Recording] = (),
    limits: Limits | None = None,
    progress: Progress = lambda share, text: None,
    names: Sequence[str] = (),
) -> Study:
    """As `diagnose`, with the evidence kept.

    Parameters
    ----------
    recordings, model, calibration, progress : as `diagnose` takes them
    limits : of every decision; those of `Limits` by default
    names : of the calibration and the recordings, in that order, for messages; numbers by default

    Returns
    -------
    what each of the five stages found

    Raises
    ------
    Unusable : (a ValueError) data or model with which nothing can be said; one line with the reason.
    """
    began = time.perf_counter()
    clock, limits = Clock(progress, 700), limits or Limits()
    nominal = model if isinstance(model, Nominal) else Nominal.from_parameters(model)
    recordings, calibration = (
        [nominal.model.description.understood(one) for one in as_recordings(part, name)]
        for name, part in (("recordings", recordings), ("calibration", calibration))
    )
    # the cores run fits in parallel: threads inside BLAS would only wait for each other
    with threadpool_limits(1, user_api="blas"):
        try:
            reading = read(
                [*calibration, *recordings], nominal, names, limits, clock, calibrations=len(calibration)
            )
        except Unusable as error:
            raise Unusable(nominal.model.description.in_own_names(str(error))) from error
        located = locate(reading, limits, clock)
        found = search(located, limits, clock, one_loop=reading.one_loop, first_use=reading.first_use)
        decision = decide(located, found, reading, limits, clock)
        answer = Study(reading, located, found, decision, limits, 0.0)
        decision = told_as(decision, equally_likely(answer))
        answer = replace(answer, decision=decision)
        while reading.first_use and decision.chosen is not None and distance(answer) > limits.farther:
            # the loops that were fitted along make up for it: no model that has it comes near the recordings
            options = tuple(o for o in found.options if o.chosen.keys != decision.chosen.keys)
            found = replace(found, options=options)
            decision = decide(located, found, reading, limits, clock)
            answer = replace(answer, search=found, decision=decision)
            decision = told_as(decision, equally_likely(answer))
            answer = replace(answer, decision=decision)
        if unlikely(answer):
            decision = without_a_name(decision, located, found, reading, limits, clock)
    return replace(answer, decision=decision, seconds=time.perf_counter() - began)
