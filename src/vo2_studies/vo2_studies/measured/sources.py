"""Which measured recordings there are, and how they become bags: through the maps that `convert` ships."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from vo2_models.recording import Recording

__all__ = ["SOURCES", "Source", "Trace", "as_bags"]

_GALLONI = "Galloni et al., PNAS 121(17), 2024; Milstein-Lab/neuromorphic-btsp, MIT"


@dataclass(frozen=True)
class Source:
    """One measured set.

    Attributes
    ----------
    key : short name
    title : for people
    file : file or folder below the data folder
    map : name of the map of `convert`
    cited : whose data, and under which licence
    """

    key: str
    title: str
    file: str
    map: str
    cited: str


_SHEET = "vo2_device/relaxation_timescales.xlsx"
SOURCES: dict[str, Source] = {
    source.key: source
    for source in (
        Source(
            "pulses",
            "VO2 device at 68.5 °C, two voltage pulses of 10 ms",
            "vo2_device/short_pulses",
            "vo2_device_pulses",
            _GALLONI,
        ),
        Source(
            "fast",
            "VO2 device, after pulses of 0.1 s and 4 to 20 mA",
            _SHEET,
            "vo2_device_relaxation_fast",
            _GALLONI,
        ),
        Source(
            "slow",
            "VO2 device, after pulses of 0.1 s and 10 to 70 mA",
            _SHEET,
            "vo2_device_relaxation_slow",
            _GALLONI,
        ),
        Source(
            "ultraslow",
            "VO2 device, after pulses of 0.01 to 2 s",
            _SHEET,
            "vo2_device_relaxation_ultraslow",
            _GALLONI,
        ),
        Source(
            "piezo",
            "Piezo actuator, 1 Hz sinusoid",
            "piezo/Model_Vi_Do.dat",
            "piezo",
            "Yan Naing Aye, DiscreteBacklashOperator, MIT",
        ),
    )
}


@dataclass(frozen=True)
class Trace:
    """One recording of a set, as read back from its bag.

    Attributes
    ----------
    label : what varies within the set, as "20 mA", "4.25 V", "0.1 s"
    recording : channels as measured
    bag : where it was read from
    problems : what conversion and reading found wrong
    """

    label: str
    recording: Recording
    bag: Path
    problems: tuple[str, ...]

    @property
    def value(self) -> float:
        """Number of the label."""
        return float(self.label.split()[0])


def as_bags(source: Source, data: Path, folder: Path) -> list[Trace]:
    """Convert a set to bags in `folder` and read them back, in the order of what varies.

    Raises
    ------
    ValueError : (MapError, BagError) the files are not there, or are not as the map says.
    """
    from vo2_identification.bags import read_recording, write_bag
    from vo2_identification.conversion.column_map import read_map
    from vo2_identification.conversion.converting import convert_file, files_of
    from vo2_identification.convert import shipped_maps

    column_map = read_map(shipped_maps()[source.map])
    found = []
    for file in files_of(data / source.file, column_map):
        for converted in convert_file(file, column_map):
            label = _label(converted.name)
            bag = folder / f"{source.key}_{label.replace(' ', '')}"
            write_bag(bag, converted.recording)
            recording, problems = read_recording(bag)
            texts = [problem.text for problem in (*converted.problems, *problems)]
            found.append(Trace(label, recording, bag, tuple(dict.fromkeys(texts))))
    return sorted(found, key=lambda trace: trace.value)


def _label(name: str) -> str:
    """Number and unit in the name of a converted recording; "1" for the only one of its set."""
    for word in name.split("_"):
        digits = word.rstrip("mAVs")
        if digits != word and digits.replace(".", "", 1).isdigit():
            return f"{digits} {word[len(digits) :]}"
    return "1"
