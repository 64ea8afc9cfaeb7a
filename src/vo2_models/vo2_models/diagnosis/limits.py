"""Every limit of a decision in one record, each with where it comes from; `diagnosis.json` repeats them.

A drop of chi-square is counted in units of the noise power of one sample. Noise and the device's own misfit are measured on the
data and are no fields here. Limits of a drop (`gain`, `rival`, `apart`, `unseen`) do not grow with the number of samples.
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
    else_least: float = _limit(
        0.05,
        "least probability that an answer is wrong, a name or none, unless the values themselves show it: of 207 answers of "
        "fourteen draws of `challenge --family avalanches` that were told with more than 0.9, 190 were right, 0.92",
    )
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
    beside_course: float = _limit(
        0.1,
        "share of the gain of a course in time from which a second effect that goes on and off is named beside it: the splines "
        "left 0.06 of a room that swung seven times in a recording, the one case looked at",
    )
    excess: float = _limit(
        0.5,
        "where nothing is named, a recording differs from this residual power beyond the noise on: of 63 unchanged devices of "
        "a family that no law describes, and of 9 of two generators by others, the largest were 0.36, 0.35, 0.33, 0.30 and 0.29",
    )
    channel_excess: float = _limit(
        1.0,
        "the same of a single channel; there 0.68, 0.64, 0.57, 0.52 and 0.42. What a name explains, below which it "
        "needs more than is left in a channel that it does not reach: an unchanged device in another room, 0.29 and 0.84",
    )
    loud_misfit: float = _limit(
        5.0,
        "noises from which a misfit of the calibration is told beside agreement: as `fit` calls a calibration fitted poorly",
    )
    far_from_calibration: float = _limit(
        4.0,
        "noise and misfit of the calibration together, r.m.s., from which what is left in a channel is told beside agreement: "
        "chosen, and words only, as it does not separate: of 46 looked-at unchanged recordings the largest were 5.4, 5.0, 4.3, "
        "of 26 that agreed in spite of an effect six were 4.4 to 8.5",
    )
    unlike_law: float = _limit(
        5.0,
        "what nothing predicts passes for the law's own misfit below so many times a noise's power and what the calibration "
        "misses of a stretch: of 76 looked-at recordings of devices without a new effect the largest was 2.4",
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
    moved_share: float = _limit(
        0.5,
        "on a device without body, share that moved constants must take up of the squared error beyond the calibration's, else "
        "what is missed is something else: one half, by its meaning",
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
    samples_of_one_loop: float = _limit(
        8.0,
        "on a device without body, independent samples that a recording of one loop is worth at most, however long: of 56 "
        "looked-at changes concealed in measurements the log loss of the true one is 0.56, 0.76 without it, 0.60 with 12 samples "
        "and 0.55 with 5",
    )
    separated: float = _limit(
        8.0,
        "predicted distance of two explanations, in standard deviations, from which an experiment is worth proposing",
    )

    # of the data: what cannot be judged, and what is said of the rest
    unjudged: float = _limit(
        0.2,
        "share of the samples at temperatures that the calibration hardly covers from which the summary begins with it: reasoned",
    )
    shortest: int = _limit(
        50, "fewest samples that can be judged, half of them on what is covered: chosen, not derived"
    )
    few: int = _limit(500, "samples below which it is said what so few cannot tell: chosen, not derived")
    copied: float = _limit(
        1e-6, "relative spread of the ratio of two channels up to which one is a copy of the other: rounding"
    )
    far_off: float = _limit(
        100.0,
        "factor between the largest value of a channel, or the sample period, and that of the device, either way, within which "
        "it can be this one: chosen, not derived",
    )
    gap: float = _limit(
        1.5, "distance of two samples, in sample periods, from which one is missing: chosen, not derived"
    )
    gaps: float = _limit(0.3, "share of a recording that may be gaps: chosen, not derived")
    unsteady: float = _limit(
        0.5, "share of sample periods a fifth off their median from which stamps are no clock: half of them"
    )
    drive_known: float = _limit(0.5, "share of the samples whose current must be known: chosen, not derived")
    no_drive: float = _limit(
        0.01,
        "share of the operating range that the current must cover to excite anything: chosen, not derived",
    )
    narrow: float = _limit(
        0.3, "the same, below which it is said that what is outside was not excited: chosen, not derived"
    )
    complete: float = _limit(
        0.999, "share of a channel's samples below which it is said how many are missing: chosen, not derived"
    )
    constant: float = _limit(
        1e-4, "share of its range that a channel which is not constant varies by: chosen, not derived"
    )
    noisy: float = _limit(
        0.25, "noise over spread of a channel from which it is mostly noise: chosen, not derived"
    )
    still: float = _limit(
        0.9,
        "noise from differences, as a share of the spread, from which there is nothing else: of white noise it is 1",
    )
    small_part: float = _limit(
        0.1,
        "share of a channel's range below which that is so; a drive that jumps at every sample makes more of it look white",
    )
    bends_by: float = _limit(
        1.5,
        "steps of a converter that values on its comb bend by at most, in the median: chosen, not derived",
    )
    clipped: float = _limit(
        0.02, "share of the samples at a channel's end value from which that is said: chosen, not derived"
    )
    dropped: float = _limit(
        0.02,
        "share of a channel's range by which the simulation, and what is beside, is off 0 where a reading of exactly 0 is none: "
        "chosen, not derived",
    )
    dropped_most: float = _limit(0.5, "share of such readings of which that must hold: most of them")
    forgotten: float = _limit(
        0.7,
        "share of the samples after gaps, loops unknown, beyond which nothing is judged: chosen, not derived",
    )
    reverse: float = _limit(
        -0.5,
        "correlation with the simulation below which a channel runs the other way: no effect turns a loop upside down",
    )
    other_film: float = _limit(
        1.5,
        "factor between the resistances of two recordings from which they are of two films: gains change by per cents",
    )
    other_device: int = _limit(
        3,
        "constants that are far off at once, a response's gain among them, from which the recording may be of another device, "
        "and one less where nothing is named: another day moves one or two",
    )
    other_loops: float = _limit(
        10.0,
        "excess, in noise powers, from which what no function of the drive and the temperature describes may be another device's "
        "loops: chosen, not derived",
    )
    described: float = _limit(
        0.75,
        "share of it up to which they do not: of six other devices they described 0.27, 0.37, 0.63, and 0.77 to 0.83",
    )
    far_move: float = _limit(
        0.03, "share by which such a constant is off: reasoned, another day moves one or two by as much"
    )
    other_film_samples: int = _limit(
        50, "samples on either side of the loops from which that can be told: chosen, not derived"
    )
    foreign: float = _limit(
        10.0,
        "times what the fit left of its calibration, from which a recording is not the one that it was fitted to: chosen, not "
        "derived",
    )
    begun_at_rest: float = _limit(
        0.2,
        "squared distance of the first samples from a device at rest at the first current, over that from a cold one, below "
        "which it was so: chosen, not derived",
    )
    begun_at_rest_by: float = _limit(
        100.0, "the same, what it must be below that as well, in noise powers: chosen, not derived"
    )
    crosses: float = _limit(
        0.5, "share of the range of temperatures that counts as crossing it: chosen, not derived"
    )
    turns_apart: float = _limit(
        0.05, "share of that range by which turning points are two: chosen, not derived"
    )
    levels: int = _limit(5, "turning temperatures from which it is more than one loop: chosen, not derived")
    rates: float = _limit(
        3.0, "times the slowest crossing's rate from which it is more than one loop: chosen, not derived"
    )
    same_steps: float = _limit(
        1.05, "ratio of the steps of two converters below which they are the same one's: chosen, not derived"
    )
    # of where recording and simulation differ
    beside: float = _limit(
        5.0,
        "chi-square over samples from which constants follow an effect that is no move of them, and are not sought further: "
        "chosen, not derived",
    )
    went: float = _limit(
        10.0,
        "move of a constant, in units of what the simulation is linear over, from which the way to it may have led astray: "
        "chosen, not derived",
    )
    better: float = _limit(
        0.5,
        "share that a constant by itself may leave to be moved to, of the squared residual, and then of the excess: chosen, not "
        "derived",
    )
    unchanged: float = _limit(10.0, "change of chi-square that is none: chosen, not derived")
    quiet_from: float = _limit(
        0.3, "residual power over noise power from which, up to `quiet`, it is noise: chosen, not derived"
    )
    noise_least: float = _limit(
        0.5, "level of such a residual over the known noise from which it is the noise: chosen, not derived"
    )
    noise_most: float = _limit(1.6, "the same, up to which it is: chosen, not derived")
    one_branch: float = _limit(
        4.0,
        "times the energy per sample of the other branch that one must have to be the place: chosen, not derived",
    )
    # of the search: what is followed further
    absorbed: float = _limit(
        0.005,
        "share of what a magnitude changes, in energy, up to which a refitted device is taken to stand for all of it: an "
        "equation that is 7 % off leaves as much",
    )
    promising: float = _limit(
        0.08, "share of the best score from which an effect is refitted: chosen, not derived"
    )
    strong: float = _limit(
        0.25,
        "the same, from which it is however many others are ahead: a limit of the drive is not linear, and may score a quarter "
        "of what others do that it leaves behind once refitted",
    )
    to_the_end: float = _limit(
        0.5, "share of the best gain of brief refits from which one is gone on with: chosen, not derived"
    )
    inside: float = _limit(
        0.8,
        "share of the best gain from which an effect off its bounds comes before a better one at a bound: chosen, not derived",
    )
    bound_shows: float = _limit(
        4.0,
        "change of chi-square by a step of a parameter from which a bound that it has come to matters: chosen, not derived",
    )
    bound_forgone: float = _limit(
        100.0,
        "drop of chi-square beyond a bound from which the bound matters: a quarter of what makes a name",
    )
    like_a_course: float = _limit(
        0.8,
        "share of the gain of a course from which another effect is linearised about itself beside it: chosen, not derived",
    )
    near: float = _limit(
        4.0,
        "excess power left by an effect with constants held, over the least that any leaves, up to which it is linearised about "
        "itself: farther ones do not catch up",
    )
    loud: float = _limit(
        1.0,
        "excess power that moved constants alone must leave for an effect that leaves noise to be clear of them: the noise's",
    )
    part_of_loud: float = _limit(
        0.25,
        "share of that excess up to which the effect may leave some before it is linearised about itself: chosen, not derived",
    )
    partner: float = _limit(
        0.1,
        "share of the best score beside a first effect from which a second is refitted: chosen, not derived",
    )
    hopeless: float = _limit(
        0.25,
        "share of what the first leaves over below which the best second is not followed further: chosen, not derived",
    )
    nearly: float = _limit(
        0.25,
        "excess, in what the best pair leaves, by which a pair may miss it and still be worth an exchange: chosen, not derived",
    )
    # of the decision
    stable: float = _limit(
        2.5, "factor in size up to which folds find that an effect does the same: chosen, not derived"
    )
    stable_cosine: float = _limit(
        0.7, "cosine of what it does in two folds from which that is the same: chosen, not derived"
    )
    within_k: float = _limit(
        0.5,
        "kelvins beyond the temperatures of the training blocks up to which a held-out sample is judged: chosen, not derived",
    )
    flat_samples: int = _limit(
        20,
        "samples beyond a limit of a channel from which it is asked whether they are flat: chosen, not derived",
    )
    mimic: float = _limit(
        0.5,
        "share of the most that an effect saves of a move of the constants from which another would look like it: half of it",
    )
    alone_most: int = _limit(
        3, "constants at most that are told to have moved by themselves: chosen, not derived"
    )
    as_late: float = _limit(
        1.5,
        "times of two sensors over each other up to which both follow something that is late: chosen, not derived; where one "
        "relaxation had made both they came out as 1.2",
    )
    alone_lag: float = _limit(
        1.0,
        "sample periods that the lag of a drive which heats nothing must have moved by: how it goes on between samples is not "
        "known",
    )
    unnamed: float = _limit(
        0.2,
        "excess power of a channel, in noise powers, from which a correction without a name is sought: chosen, not derived",
    )
    unnamed_share: float = _limit(
        0.03, "share of that excess that a group of its functions must remove: chosen, not derived"
    )
    unnamed_gain: float = _limit(
        30.0, "energy, in noise powers of a sample, that it must remove as well: chosen, not derived"
    )
    tone: float = _limit(
        30.0, "times the median of the spectrum from which a line of it is a tone: chosen, not derived"
    )
    # of what is told
    likelier: float = _limit(
        0.5,
        "probability from which a name, or what has none, is likelier than all else: one half, by its meaning",
    )
    clear_family: float = _limit(
        0.25,
        "share of the excess that the best effect of a family explains more than that of any other, from which what has no name "
        "is told of that family: of eleven looked-at answers without a name it changes two, both for the better",
    )
    left_here: float = _limit(
        2.0,
        "so many times its chi-square may an explanation leave in the problem without effects to be compared with others there: "
        "chosen, not derived",
    )
    decade: float = _limit(
        0.01, "decades by which a gain may miss a power of ten and be taken for it: 2 %; chosen, not derived"
    )
    one_by_one: float = _limit(
        10.0,
        "times the least excess of a recording, at least `excess`, from which another's says that they differ: chosen, not "
        "derived",
    )
    slow_misfit: float = _limit(
        3.0,
        "level of what the fit missed of a calibration over that of its innovations, from which at first use it is judged once "
        "more as no noise: chosen, not derived; 7 to 18 where a room wandered by 1.5 K, the case looked at",
    )
    most_of_it: float = _limit(
        0.5,
        "held-out error with a name over that without, in a channel that it explains, up to which such a name counts: reasoned, "
        "three quarters of the power; the share of what a first effect leaves, up to which a pair may leave, and "
        "of the excess from which something explains most of it: a half, by its meaning",
    )
    misfitted: float = _limit(
        1.5,
        "times a sensor's noise from which what is taken for noise holds misfit of the calibration too: chosen, not derived",
    )
    worth: float = _limit(
        0.05,
        "least share of the excess that terms without a name must remove on held-out blocks, and that a later model must leave "
        "less, to be written down: chosen, not derived",
    )
    by_itself: float = _limit(
        1.5,
        "what a corrected model leaves, over what the diagnosis does, from which it is told: chosen, not derived",
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
