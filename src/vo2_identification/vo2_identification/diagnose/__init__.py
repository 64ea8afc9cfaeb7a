"""The command `diagnose`; what it calls is `vo2_models.diagnosis`."""

from vo2_identification.diagnose.command import main

__all__ = ["main"]
