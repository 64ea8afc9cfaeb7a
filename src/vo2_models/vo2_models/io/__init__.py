"""Files in and out: what is read is bounded and checked, what is written is whole or absent."""

from vo2_models.io.files import InputError, check_place, check_regular, one_line, read_bytes, write_whole
from vo2_models.io.output_folder import OutputFolder
from vo2_models.io.safe_yaml import load_yaml, read_yaml

__all__ = [
    "InputError",
    "OutputFolder",
    "check_place",
    "check_regular",
    "load_yaml",
    "one_line",
    "read_bytes",
    "read_yaml",
    "write_whole",
]
