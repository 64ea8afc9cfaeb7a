"""Fit, explain and judge one measured set: every candidate on training recordings, all errors on held-out ones.

The choice is made on the training recordings; the held-out ones only say whether it holds. A name needs what the
diagnosis needs: its share of the excess on held-out data, parameters inside their bounds and told from nothing, the same
sign in every fold, and together with what it leaves over no more than an incomplete remainder.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray
from vo2_models.diagnosis.noise import level_from_differences
from vo2_models.effects import effect
from vo2_models.recording import RESISTANCE, TIP_DEFLECTION

from vo2_studies.measured.candidates import LAG, PIEZO, RATE_INDEPENDENT, VO2, Candidate
from vo2_studies.measured.cases import Case
from vo2_studies.measured.fitting import CandidateFit, Setting, fit_candidate, fit_lag
from vo2_studies.measured.laws import LawResult, compare_laws

__all__ = ["Fold", "Judgement", "SetStudy", "study_set"]

Floats = NDArray[np.float64]
COMPLETE = 0.85
"""Least share of the excess on held-out data that a named effect explains."""
SIGMAS = 4.0
"""Least distance of its magnitude from nothing, in standard deviations."""
SIMILAR_ERROR = 1.15
"""Rivals with a held-out error within this factor are not told apart."""
TRAINED_SHARE = 0.6
"""Part of a single recording that is fitted; the rest is predicted."""
_SIMPLE = (RATE_INDEPENDENT.id, LAG.id)
PROMISING = 3
"""Effects of the catalogue, the best on the first fold's training recordings, that are fitted in the other folds too."""


@dataclass(frozen=True)
class Fold:
    """What is fitted and what is predicted.

    Attributes
    ----------
    words : what is held out
    train, held : recordings with what is judged of them
    """

    words: str
    train: tuple[Case, ...]
    held: tuple[Case, ...]


@dataclass(frozen=True)
class Judgement:
    """One candidate over all folds in which it was fitted.

    Attributes
    ----------
    candidate : hypothesis
    fits : one per fold, the first folds first
    training : root mean square on what was fitted
    held : root mean square on what was held out, all folds in which it was fitted [judged unit]
    gain : share of the reference's excess that it removes on what was held out in the same folds
    """

    candidate: Candidate
    fits: tuple[CandidateFit, ...]
    training: float
    held: float
    gain: float


@dataclass(frozen=True)
class SetStudy:
    """What was found in a set.

    Attributes
    ----------
    key : of its source
    cases : all recordings, all samples
    folds : splits
    noise : level of the instrument's noise [judged unit]
    judgements : rate independent, one lag, then candidates by held-out error
    chosen : candidate of the catalogue that fits the training recordings best
    named : whether the held-out recordings bear it out
    reasons : why not, one sentence each
    rivals : ids that the held-out recordings do not separate from the chosen one
    reference : id of the simpler model that gains are told against: the better one on held-out data of the rate
        independent and the lag, so that no gain is over a model that only failed
    laws : for relaxations, which law each follows by itself
    """

    key: str
    cases: tuple[Case, ...]
    folds: tuple[Fold, ...]
    noise: float
    judgements: tuple[Judgement, ...]
    chosen: Judgement
    named: bool
    reasons: tuple[str, ...]
    rivals: tuple[str, ...]
    reference: str
    laws: tuple[LawResult, ...] = field(default=())

    def of(self, name: str) -> Judgement:
        """Return the judgement of a candidate by its id."""
        return next(j for j in self.judgements if j.candidate.id == name)

    @property
    def best(self) -> Judgement:
        """The least held-out error of all, in the catalogue or not."""
        return min(self.judgements, key=lambda j: j.held)


def study_set(
    key: str,
    cases: Sequence[Case],
    *,
    say: Callable[[str], None] = lambda text: None,
    candidates: Sequence[Candidate] | None = None,
    setting: Setting | None = None,
) -> SetStudy:
    """Fit and judge all candidates of a set.

    Parameters
    ----------
    key : of the source; "piezo" is one recording, split in time
    cases : of the set
    say : called with what is being done
    candidates : hypotheses, by default those of the device's kind
    setting : of all fits, by default from the set's times
    """
    channel = cases[0].channel
    single = len(cases) == 1
    noise = _noise(cases)
    tried = tuple(candidates if candidates is not None else PIEZO if channel == TIP_DEFLECTION else VO2)
    setting = setting or _setting(channel, single, cases)
    folds = (_split_in_time(cases[0]),) if single else _split_by_recording(key, cases)
    fits: dict[str, list[CandidateFit]] = {}
    for number, fold in enumerate(folds):
        say(f"{key}: fitting without {fold.words}")
        plain = fit_candidate(setting, fold.train, RATE_INDEPENDENT, 0.0)
        lag = fit_lag(setting, fold.train)
        tau = lag.values["thermal.time_constant"]
        fits.setdefault(RATE_INDEPENDENT.id, []).append(plain)
        fits.setdefault(LAG.id, []).append(lag)
        for candidate in tried if number == 0 else _promising(tried, fits):
            say(f"{key}: {candidate.id}, without {fold.words}")
            found = fit_candidate(setting, fold.train, candidate, tau, lag)
            fits.setdefault(candidate.id, []).append(found)
    records = {c.id: c for c in (RATE_INDEPENDENT, LAG, *tried)}
    plainly = {name: _judge(records[name], fits[name], fits[name], folds, noise) for name in _SIMPLE}
    reference = min(_SIMPLE, key=lambda name: plainly[name].held)
    judgements = [_judge(records[name], fits[name], fits[reference], folds, noise) for name in records]
    head, rest = judgements[:2], sorted(judgements[2:], key=lambda j: j.held)
    complete = [j for j in rest if j.candidate.in_catalogue and len(j.fits) == len(folds)]
    chosen = min(complete, key=lambda j: j.training)
    rivals = tuple(
        j.candidate.id
        for j in complete
        if j is not chosen and j.gain > 0.25 and j.held < SIMILAR_ERROR * chosen.held
    )
    reasons = _doubts(chosen, rest)
    if rivals:
        reasons.append(f"{' and '.join(rivals)} predicts about as well and is not told apart")
    laws = () if single else tuple(compare_laws(case) for case in cases)
    return SetStudy(
        key,
        tuple(cases),
        folds,
        noise,
        (*head, *rest),
        chosen,
        not reasons,
        tuple(reasons),
        rivals,
        reference,
        laws,
    )


def _setting(channel: str, single: bool, cases: Sequence[Case]) -> Setting:
    dt = min(case.recording.sample_period_s for case in cases)
    longest = max(float(case.recording.time_s[-1] - case.recording.time_s[0]) for case in cases)
    constants = np.geomspace(1.5 * dt, 0.1 * longest if not single else 20.0 * dt, 7)
    if channel == RESISTANCE:
        return Setting(channel, True, 6, 0.01, tuple(constants.tolist()))
    return Setting(channel, False, 8, 1e-7, tuple(constants.tolist()))


def _noise(cases: Sequence[Case]) -> float:
    """Level of what changes from sample to sample, where the recordings move least [judged unit]."""
    levels = []
    for case in cases:
        values = case.grid.measured[case.channel]
        values = values[np.isfinite(values)]
        levels.append(level_from_differences(values[values.size // 2 :]))
    return float(np.median(levels))


def _split_by_recording(key: str, cases: Sequence[Case]) -> tuple[Fold, ...]:
    """Every recording between the two extremes is held out once; the extremes are always fitted.

    Of the recordings with two pulses the time after the second is held out once too.
    """
    thin = [case.thinned() for case in cases]
    folds = []
    for first in (0, 1):
        held = tuple(thin[1 + first : -1 : 2])
        train = tuple(case for case in thin if case not in held)
        folds.append(Fold(", ".join(case.label for case in held), train, held))
    if key == "pulses":
        early = tuple(_judged_where(case, ~_after_second_pulse(case)) for case in thin)
        late = tuple(_judged_where(case, _after_second_pulse(case)) for case in thin)
        folds.append(Fold("what follows the second pulse", early, late))
    return tuple(folds)


def _split_in_time(case: Case) -> Fold:
    index = np.arange(len(case.recording))
    seen = index < TRAINED_SHARE * index.size
    words = f"the last {100 * (1 - TRAINED_SHARE):.0f} % of the time"
    return Fold(words, (_judged_where(case, seen),), (_judged_where(case, ~seen),))


def _after_second_pulse(case: Case) -> NDArray[np.bool_]:
    """Samples from the second rise of the drive on (n,)."""
    on = case.drive > 0.0
    rises = np.flatnonzero(on[1:] & ~on[:-1]) + 1
    return np.arange(on.size) >= rises[-1]


def _judged_where(case: Case, keep: NDArray[np.bool_]) -> Case:
    values = np.where(keep, case.recording[case.channel], np.nan)
    channels = {**case.recording.channels, case.channel: values}
    return replace(case, recording=replace(case.recording, channels=channels))


def _promising(tried: Sequence[Candidate], fits: dict[str, list[CandidateFit]]) -> list[Candidate]:
    """The best of the catalogue on the first fold's training recordings, and all from outside it."""
    inside = sorted((c for c in tried if c.in_catalogue), key=lambda c: fits[c.id][0].rms)[:PROMISING]
    return [*inside, *(c for c in tried if not c.in_catalogue)]


def _judge(
    candidate: Candidate,
    fits: Sequence[CandidateFit],
    references: Sequence[CandidateFit],
    folds: Sequence[Fold],
    noise: float,
) -> Judgement:
    own, base = [], []
    for fit, simple, fold in zip(fits, references, folds, strict=False):
        for case in fold.held:
            own.append(_finite(fit.gap(case)))
            base.append(_finite(simple.gap(case)))
    squares, simple_squares = (np.concatenate(parts) ** 2 for parts in (own, base))
    excess = float(np.sum(simple_squares) - simple_squares.size * noise**2)
    gain = float(np.sum(simple_squares) - np.sum(squares)) / excess if excess > 0.0 else 0.0
    training = float(np.sqrt(np.mean([fit.rms**2 for fit in fits])))
    return Judgement(candidate, tuple(fits), training, float(np.sqrt(np.mean(squares))), gain)


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]


def _doubts(chosen: Judgement, others: Sequence[Judgement]) -> list[str]:
    """Why the chosen effect is not named; empty where it is."""
    name = chosen.candidate.id
    found = []
    if chosen.gain < COMPLETE:
        found.append(
            f"a name must explain {100 * COMPLETE:.0f} % of the excess on held-out data, {name} removes "
            f"{100 * chosen.gain:.0f} %"
        )
    bound = sorted({text for fit in chosen.fits for text in fit.at_bound})
    if bound:
        found.append(f"{', '.join(bound)} ended at a physical bound")
    found += _unstable(chosen, SIGMAS)
    better = [j for j in others if not j.candidate.in_catalogue and j.held**2 < 0.5 * chosen.held**2]
    if better:
        found.append(
            f"{better[0].candidate.id}, which the catalogue does not have, leaves less than half the energy of {name}"
        )
    return found


def _unstable(chosen: Judgement, sigmas: float) -> list[str]:
    """Magnitudes that are not told from nothing, or change sign or size between the folds."""
    found = []
    for key in chosen.candidate.effects:
        record = effect(key.split(":")[0])
        for parameter in record.parameters:
            name = f"{key.replace(':', '.')}.{parameter.name}"
            if name not in chosen.fits[0].values or float(parameter.lower or 0.0) > 0.0:
                continue
            values = [fit.values[name] for fit in chosen.fits]
            distance = min(abs(fit.values[name]) / max(fit.std[name], 1e-300) for fit in chosen.fits)
            if distance < sigmas:
                short = np.floor(10 * distance) / 10  # never rounded up to what is needed
                found.append(f"{name} is {short:.1f} standard deviations from nothing, need {sigmas:g}")
            low, high = min(values), max(values)
            if low * high <= 0.0 or max(abs(low), abs(high)) > 2.5 * min(abs(low), abs(high)):
                found.append(f"{name} runs from {low:.3g} to {high:.3g} between the folds")
    return found
