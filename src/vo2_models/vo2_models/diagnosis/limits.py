"""Every limit of a decision in one record, each with where it comes from; `diagnosis.json` repeats them.

A drop of chi-square is counted in units of the noise power of one sample. What depends on the number of samples, on
the noise or on the device's own misfit is measured on the data instead and is no field here.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from math import exp, log10
from typing import Any

__all__ = ["Limits"]


def _limit(value: float, provenance: str) -> Any:
    return field(default=value, metadata={"provenance": provenance})


@dataclass(frozen=True)
class Limits:
    """When an answer is given; each field's provenance is in its metadata, see `with_provenance`.

    "Own simulator" below means devices drawn by `vo2_models.device.truth` with composite recordings of 4 000 to
    10 000 samples.
    """

    stamps: float = _limit(
        0.25,
        "share of the squared misfit that commands moved by one sample period may leave to count as stamped at the other "
        "end of their interval: one period off is most of a misfit, or none",
    )
    whole_period: float = _limit(
        0.1,
        "distance from a whole sample period, in periods, of a delay that counts as a convention of the stamps",
    )
    gain: float = _limit(
        400.0,
        "least drop of chi-square of a named effect: the largest on some fifty effect-free recordings of the own "
        "simulator was 329",
    )
    coarse: float = _limit(
        1.2,
        "what a converter that the values show by themselves changes, over the calibration's noise, from which it is new: a "
        "converter alone makes a noise of its step over the root of 12",
    )
    line: float = _limit(
        0.5,
        "share of its channel's squared error that a swing at one frequency must explain to be named where the rest has no name: "
        "reasoned; of two composed disturbances of a sensor, looked at, it was the smaller part",
    )
    seen: float = _limit(
        0.99,
        "probability of an effect that the values show by themselves: chance puts no thousand values on a comb, but a program "
        "behind the converter may",
    )
    sigmas: float = _limit(
        4.0,
        "least distance of a magnitude from zero, in its standard deviations: 6e-5 two-sided, for some 30 effects",
    )
    sure: float = _limit(
        10.0,
        "standard deviations by which an effect acts from which it is mentioned beside agreement or moved constants although it "
        "leaves too much for a name: of 45 explanations of two looked-at draws, devices with a body, all 4 such ones were right",
    )
    switching: float = _limit(
        0.5,
        "standard deviation of a switching time, as a share of how long it was on: beyond, no edge is seen",
    )
    slack: float = _limit(
        0.12,
        "residual power beyond the noise, in noise powers, of unchanged devices of the own simulator",
    )
    own_misfit: float = _limit(
        2.0,
        "on a device without body, distance from the model over the fit's error on held-out parts of its calibration, below "
        "which a recording agrees: 0.84 and 1.92 of the reruns of two seals; few cases, and remounts go beyond",
    )
    unlike_misfit: float = _limit(
        3.1,
        "the same, below which it agrees too where no effect is named: of 30 unchanged devices of nine laws the largest were "
        "3.03, 2.44, 2.26, 2.15 and 1.92. Nor is one named there while the excess is below `channel_excess`: of ten "
        "explanations of recordings of muscles and elastomers that others simulated, 2 were right and 4 of unchanged devices",
    )
    far_beyond: float = _limit(
        30.0,
        "residual power beyond noise and misfit of the calibration, in powers of these, from which a recording differs however "
        "near it is by the above: a slow drift is small and unlike a misfit; of 220 unchanged or moved devices of five looked-at "
        "draws without body the largest were 21, 9.9 and 6.0",
    )
    farther: float = _limit(
        1.5,
        "at first use: distance of the corrected model from the recordings, in that of the model as it is, from which what was "
        "fitted along makes up for a name: at most 1.2 with a right name, 4 to 20 with a false one, on 20 devices that others "
        "had simulated",
    )
    as_it_is: float = _limit(
        6.5,
        "on a device without body, distance of a recording from the model as it is, over the fit's error on held-out parts of "
        "its calibration, from which they do not agree though moved constants and loops together take it up: of some eighty "
        "unchanged and remounted devices of four looked-at draws the largest were 5.8, 3.8, 3.6 and 3.5",
    )
    told: float = _limit(
        0.75,
        "on a device without body, share of the samples that an explanation may be judged by, where it brings them from beyond "
        "twice its misfit to within it: a law misses small loops far from its kind by ten times as much as all others",
    )
    rival_of_misfit: float = _limit(
        0.9,
        "on a device without body, share of a name's gain from which another effect is a rival, so that neither is named: on "
        "a seal whose force was averaged a resonance gained most, and five others, the true one too, at least 95 % of it",
    )
    equal_of_misfit: float = _limit(
        0.99,
        "the same share, both fitted about themselves, from which another effect is a rival whatever it leaves: a dead time and "
        "a late clock of one response were 0.2 % apart",
    )
    law_misfit: float = _limit(
        0.05,
        "largest error of a channel, as a share of its range, that fitted loops make of a recording unlike the calibration: "
        "published laws reach 0.01 to 0.03",
    )
    else_base: float = _limit(
        3.06,
        "log odds that an explanation is wrong: constant; fitted as in `challenge.calibrate` to the best explanations of 160 "
        "recordings of seven families by two versions, named or not: 68 right, a sibling's form among them, and 46 wrong; of 83 "
        "explanations of 120 later recordings they name 46 right and 5 wrong ones, as those fitted to these do",
    )
    else_sure: float = _limit(
        3.3, "the same, less for each decade of standard deviations by which its effects act"
    )
    else_left: float = _limit(
        2.09,
        "the same, more for each decade of `least` and the excess power that it leaves, in noise powers of a sample",
    )
    least: float = _limit(
        0.1,
        "excess power, in noise powers, from which what is left counts: a noise's level is known to as much",
    )
    surest: float = _limit(1000.0, "standard deviations beyond which nothing is surer")
    equation: float = _limit(
        0.005,
        "share of what is explained that does not count as left, nor as what a second effect explains: an equation 7 % off "
        "leaves as much; of two recordings with one effect of a user's own the false second ones explained 0.0035 and 0.0025, "
        "of a third 0.010, which stays",
    )
    doubt: float = _limit(
        0.4,
        "probability that an explanation is wrong up to which it is named: of the 114 above, each family by coefficients of "
        "the others, 46 right and 6 wrong ones below 0.3; of 62 later ones of eight families 28 right and 6 wrong below 0.3, "
        "two of these siblings of the truth, and all 5 between 0.3 and 0.5 right",
    )
    credible: float = _limit(
        0.9,
        "of effects none of which is more likely than everything else together, the fewest that are together this share of all "
        "that have a name are told, without choosing: an ordinary credible set",
    )
    dominated: float = _limit(
        0.5,
        "share of a name's gain that another effect alone must not reach: an equation a little off has no rival",
    )
    share: float = _limit(
        0.25,
        "least share of a name's gain that shows on held-out blocks, and of the excess that a correction without a name "
        "removes there: false names explained 0.04 to 0.06, true ones 0.5 to 0.65 in the median",
    )
    course: float = _limit(
        0.5,
        "share of the best effect's gain from which a drift is tried with any course in time: half of it at least",
    )
    bend: float = _limit(
        0.02,
        "share of a drift's gain that its bend must add, beyond `gain`, to be told: less is the pattern's own curvature",
    )
    second: float = _limit(
        0.04,
        "share of the first effect's gain from which a second may act like it: an equation 20 % off leaves as much",
    )
    second_cosine: float = _limit(
        0.25,
        "largest cosine of a second effect's pattern with the first's where it gains less: such an equation leaves its like",
    )
    excess: float = _limit(
        0.5,
        "where nothing is named, a recording differs from this residual power beyond the noise on: of 63 unchanged devices of "
        "a family that no law describes, and of 9 of two generators by others, the largest were 0.36, 0.35, 0.33, 0.30 and 0.29",
    )
    channel_excess: float = _limit(1.0, "the same of a single channel; there 0.68, 0.64, 0.57, 0.52 and 0.42")
    loud_misfit: float = _limit(
        5.0,
        "noises from which a misfit of the calibration is told beside agreement: as `fit` calls a calibration fitted poorly",
    )
    unlike_law: float = _limit(
        5.0,
        "what nothing predicts passes for the law's own misfit below so many times a noise's power and what the calibration "
        "misses of a stretch: of 58 looked-at recordings of devices without a new effect the largest was 1.9",
    )
    rival: float = _limit(
        25.0, "difference of chi-square below which two effects are not told apart: 5 sigma"
    )
    apart: float = _limit(
        100.0,
        "difference of chi-square to every other effect where constants could stand for the name: 10 sigma",
    )
    tie: float = _limit(
        0.02,
        "pairs within this share of what the best leaves over are equal: the one with fewer parameters is named",
    )
    drift_p: float = _limit(
        1e-6,
        "probability, for unchanged constants, of a squared move over its covariance as large as the one from which they "
        "have moved; the chi-square quantile for 7 or 8 constants is about 41, of 13 unchanged devices of the own simulator, "
        "whose loops are of another family than the model's, the largest was 15",
    )
    mistaken: float = _limit(
        4.0,
        "on a device without body, deviations by which a constant may differ from the calibration's own value: as `sigmas`; a "
        "dead time was followed by 43, and an average named beside it",
    )
    alone: float = _limit(
        0.05,
        "share of the squared residual (without body, of what is beyond noise and misfit) that few moved constants may leave by "
        "themselves, loops as the calibration left them, to be told: of five recordings of a device that others simulated it "
        "was 0.0007 to 0.0096; of 16 drawn devices without body whose constant had moved 0.000 to 0.023, of 20 with an effect at "
        "least 0.14",
    )
    alone_beside: float = _limit(
        1.5,
        "squared residual that they may leave, over that of an effect in their place, to be told and not the effect: of a wire "
        "that others simulated, which the law misses, a room 3 K off was a laser that leaves as much",
    )
    alone_from: float = _limit(
        10.0,
        "squared residual of a sample, over its noise, from which that is asked: a room 0.1 K off left 21",
    )
    alone_gain: float = _limit(
        0.2,
        "share of what the others leave that each of these constants must explain: reasoned, not measured",
    )
    alone_misfit: float = _limit(
        0.5,
        "standard deviation of what a misfit moves such a constant by, as a share of the most that it can: of eight moves of "
        "three devices that others simulated the furthest lay 2.9 and 1.2 of these deviations off, by scatter alone up to 9",
    )
    elsewhere: float = _limit(
        30.0,
        "excess power left in a channel that a name does not reach, in noise powers, from which the name does not tell what is "
        "missing: a room that swung by 1.5 K on a device that others simulated was a drifting zero of its thermometer, with 302 "
        "and 88 left in resistance and deflection",
    )
    flat: float = _limit(
        1.25,
        "median distance, over that of noise alone, of the values beyond a limit of a channel from it, up to which the channel "
        "ends there: 1.0 at most of three simulated sensors that end before their noise, between 1.4 and 2 of an unchanged drawn "
        "device whose law misses the end of its range",
    )
    constant_moved: float = _limit(
        4.0, "move of one constant, in standard deviations, from which it counts in what moved constants cost"
    )
    quiet: float = _limit(
        1.4, "residual power over noise power up to which a channel's residual is taken for its noise"
    )
    faint: float = _limit(25.0, "score from which a refit could make a hypothesis worth a name: 5 sigma")
    unseen: float = _limit(
        50.0, "chi-square of an effect of typical size below which these recordings do not excite it: 7 sigma"
    )
    temper: float = _limit(
        8.0,
        "divides log likelihood ratios: effective samples are fewer than samples by the misfit's correlation",
    )
    temper_on_one_loop: float = _limit(
        0.05,
        "the same on one loop only, as a share of what the best effect explains: of 38 changes of devices without body, measured "
        "ones among them, the best was right in 20 of 21 where it gained 3 % more than any other, and in 10 of 17 below",
    )
    separated: float = _limit(
        8.0,
        "predicted distance of two explanations, in standard deviations, from which an experiment is worth proposing",
    )

    def probability_of_something_else(self, sigmas: float, left: float) -> float:
        """Return the probability that an explanation is wrong.

        Parameters
        ----------
        sigmas : standard deviations by which its effects act
        left : excess power that it leaves beyond what its equation may, in noise powers of a sample
        """
        sure = log10(min(max(sigmas, 1.0), self.surest))
        odds = self.else_base - self.else_sure * sure + self.else_left * log10(1.0 + left / self.least)
        return 1.0 / (1.0 + exp(-odds))

    def with_provenance(self) -> dict[str, dict[str, float | str]]:
        """Return name -> value and provenance, for `diagnosis.json`."""
        return {
            each.name: {"value": getattr(self, each.name), "provenance": each.metadata["provenance"]}
            for each in fields(self)
        }
