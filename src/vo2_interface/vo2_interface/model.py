"""What every node knows of a device: its presets, its operating point, and the `model.*` parameters of its file."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

from vo2_models.device.description import preset
from vo2_models.parameters import Parameter

__all__ = ["OperatingPoint", "model_parameters", "operating_point"]


@dataclass(frozen=True)
class OperatingPoint:
    """What a node needs of a preset.

    Attributes
    ----------
    rate_hz : usual sampling rate
    lower_a, upper_a : range of the operating current [A]
    least_a, most_a : what the device bears [A]; nothing beyond is ever commanded
    safe_a : safe current [A], `drive.safe` of the device file
    cold_a, hot_a : ends of the operating range by temperature [A]: below and above both transitions
    settle_s : time after which a held current is quasi-static [s]
    deflection_range_m : what "per cent of range" divides by [m]
    unit : of the drive, which stands for A in all of these
    """

    rate_hz: float
    lower_a: float
    upper_a: float
    least_a: float
    most_a: float
    safe_a: float
    cold_a: float
    hot_a: float
    settle_s: float
    deflection_range_m: float
    unit: str = "A"


_SETTLE_CONSTANTS = 5.0


def operating_point(preset_id: str) -> OperatingPoint:
    """Return the operating point of a preset; raise `ValueError` naming the known ones.

    Parameters
    ----------
    preset_id : preset, or path of a device file
    """
    nominal = preset(preset_id)
    cold, hot = nominal.operating_range
    return OperatingPoint(
        rate_hz=1.0 / nominal.sample_period,
        lower_a=min(cold, hot),
        upper_a=max(cold, hot),
        least_a=min(nominal.current_range),
        most_a=max(nominal.current_range),
        safe_a=nominal.safe,
        cold_a=cold,
        hot_a=hot,
        settle_s=round(_SETTLE_CONSTANTS * nominal.time_constant / nominal.sample_period + 0.5)
        * nominal.sample_period,
        deflection_range_m=nominal.deflection_range,
        unit=nominal.drive_unit,
    )


@lru_cache(maxsize=1)
def model_parameters() -> tuple[Parameter, ...]:
    """Return the records of everything a model file may hold, in every section."""
    # these modules load the compiler: only once parameters are really declared
    from vo2_models.device import PARAMETERS as DEVICE_PARAMETERS
    from vo2_models.identification.digest import DIGEST_PARAMETERS
    from vo2_models.self_sensing import PARAMETERS as SELF_SENSING_PARAMETERS

    return (*DEVICE_PARAMETERS, *DIGEST_PARAMETERS, *SELF_SENSING_PARAMETERS)
