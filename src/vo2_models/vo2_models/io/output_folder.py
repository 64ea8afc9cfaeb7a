"""Output folders that a person may also use: a command replaces what it wrote itself, and nothing else."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from vo2_models.io.files import InputError, check_place, read_bytes, write_whole

__all__ = ["MANIFEST", "OutputFolder"]

MANIFEST = ".vo2_outputs.json"
"""File in an output folder that lists what the commands of this project wrote there."""
_MOST_BYTES = 1 << 26

# path below the folder -> size [bytes] and time of the last change [ns]; empty for a folder and for a log, which a
# process may end after the list was made
_Entries = dict[str, list[int]]


class OutputFolder:
    """Entries of a folder that one command writes, and replaces when it runs again.

    What it wrote is known by a list in the folder, with sizes and times: what is not in the list, or has changed since,
    belongs to somebody else.

    Parameters
    ----------
    path : the folder
    names : entries of the folder that the command writes: files, or folders with everything in them
    """

    def __init__(self, path: str | Path, names: Sequence[str]) -> None:
        self.path = Path(path)
        self.names = tuple(names)

    def check(self) -> None:
        """Refuse a folder in which the command would replace what it did not write.

        Raises
        ------
        InputError : names the first such entry, or the folder that cannot be written.
        """
        if self.path.exists() and not self.path.is_dir():
            raise InputError(f"{self.path}: is a file, need a folder")
        check_place(self.path / MANIFEST)
        known = self._known()
        for name, found in self._found().items():
            if known.get(name) != found:
                what = (
                    "has changed since it was written"
                    if name in known
                    else "is not an output of this program"
                )
                raise InputError(
                    f"{self.path / name}: {what} and would be replaced; move it away or choose another output folder"
                )

    def clear(self) -> None:
        """Delete what earlier runs wrote.

        Raises
        ------
        InputError : as `check`; nothing is deleted.
        OSError : the folder cannot be written.
        """
        self.check()
        for name in self.names:
            place = self.path / name
            shutil.rmtree(place) if place.is_dir() else place.unlink(missing_ok=True)

    def remember(self) -> None:
        """List what is there under the names now as written by the command.

        Raises
        ------
        OSError : the folder cannot be written.
        """
        others = {name: found for name, found in self._known().items() if not self._is_own(name)}
        if content := others | self._found():
            write_whole(self.path / MANIFEST, json.dumps(content, indent=0, sort_keys=True) + "\n")

    @contextmanager
    def replaced(self) -> Iterator[Path]:
        """Clear, give the folder to write into, and remember what was written, however it ends."""
        self.clear()
        try:
            yield self.path
        finally:
            self.remember()

    def _is_own(self, name: str) -> bool:
        return name.split("/", 1)[0] in self.names

    def _known(self) -> _Entries:
        place = self.path / MANIFEST
        if not place.exists():
            return {}
        try:
            content = json.loads(read_bytes(place, _MOST_BYTES))
        except (ValueError, RecursionError):
            return {}  # then nothing is ours
        return content if isinstance(content, dict) else {}

    def _found(self) -> _Entries:
        return {
            str(place.relative_to(self.path)): _signature(place)
            for name in self.names
            for place in _walk(self.path / name)
        }


def _walk(place: Path) -> Iterator[Path]:
    if place.is_symlink() or place.exists():
        yield place
    if place.is_dir() and not place.is_symlink():
        for inside in sorted(place.iterdir()):
            yield from _walk(inside)


def _signature(place: Path) -> list[int]:
    if place.suffix == ".log" or (place.is_dir() and not place.is_symlink()):
        return []
    status = place.lstat()
    return [status.st_size, status.st_mtime_ns]
