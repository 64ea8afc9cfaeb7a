"""Regular files of bounded size in, whole files out."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

__all__ = ["InputError", "check_place", "check_regular", "one_line", "read_bytes", "write_whole"]

_LONGEST_LINE = 600
_KINDS = (
    (stat.S_ISDIR, "a folder"),
    (stat.S_ISFIFO, "a FIFO"),
    (stat.S_ISCHR, "a device file"),
    (stat.S_ISBLK, "a device file"),
    (stat.S_ISSOCK, "a socket"),
)


class InputError(ValueError):
    """Input that cannot be used; the message is one printable line of bounded length.

    Messages quote what was found, and a hostile file decides how long that is.
    """

    def __init__(self, message: str) -> None:
        super().__init__(one_line(message))


def one_line(text: object, longest: int = _LONGEST_LINE) -> str:
    """Return a text in one line of printable characters, its middle left out where it is longer than `longest`."""
    plain = str(text)
    if len(plain) > longest:
        half = (longest - 5) // 2
        plain = f"{plain[:half]} ... {plain[-half:]}"
    return " ".join("".join(each if each.isprintable() else " " for each in plain).split())


def check_regular(path: str | Path, most_bytes: int | None = None) -> int:
    """Return the size of a regular file [bytes]; opening anything else, as a FIFO, may wait for ever.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    InputError : nothing there, no regular file, or larger than `most_bytes`.
    """
    try:
        found = os.stat(path)
    except (OSError, ValueError) as error:  # ValueError: a NUL in the name
        raise InputError(f"{path}: cannot be read ({getattr(error, 'strerror', None) or error})") from error
    if not stat.S_ISREG(found.st_mode):
        kind = next((name for is_kind, name in _KINDS if is_kind(found.st_mode)), "something else")
        raise InputError(f"{path}: found {kind}, need a regular file")
    if most_bytes is not None and found.st_size > most_bytes:
        raise InputError(
            f"{path}: found {found.st_size / 1e6:.6g} MB, need at most {most_bytes / 1e6:.6g} MB in such a file"
        )
    return found.st_size


def read_bytes(path: str | Path, most_bytes: int) -> bytes:
    """Return the content of a regular file of at most `most_bytes`.

    Parameters
    ----------
    path : of the file

    Raises
    ------
    InputError : as `check_regular`, or not readable.
    """
    check_regular(path, most_bytes)
    try:
        with open(path, "rb") as file:
            return file.read(most_bytes)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from error


def check_place(path: str | Path) -> None:
    """Refuse before the work a place where nothing could be written after it; folders on the way may be missing.

    Parameters
    ----------
    path : of the file that is to be written

    Raises
    ------
    InputError : names the folder that cannot be written into.
    """
    parent = next((folder for folder in Path(path).absolute().parents if folder.exists()), Path("/"))
    if not parent.is_dir():
        raise InputError(f"{path}: cannot be written ({parent} is not a folder that may be written into)")
    try:
        # to ask for permission would not do: root has it where nobody can write
        with tempfile.TemporaryFile(dir=parent):
            pass
    except OSError as error:
        raise InputError(
            f"{path}: cannot be written ({parent} is not a folder that may be written into: {error.strerror or error})"
        ) from error


def write_whole(path: str | Path, content: str | bytes) -> None:
    """Write a file that appears whole or not at all: it is written beside its place and then moved there.

    Parameters
    ----------
    content : text is written as UTF-8

    Raises
    ------
    OSError : the disk is full or the folder cannot be written; `filename` is `path`, nothing is left beside it.
    """
    target = Path(path)
    data = content.encode() if isinstance(content, str) else content
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        handle, partial = tempfile.mkstemp(dir=target.parent, prefix=f".{target.name[:100]}.", suffix=".part")
        try:
            with os.fdopen(handle, "wb") as stream:
                stream.write(data)
            os.chmod(partial, 0o644)
            os.replace(partial, target)
        except BaseException:
            os.unlink(partial)  # a full disk or Ctrl-C leaves nothing beside the place
            raise
    except OSError as error:
        raise OSError(error.errno, error.strerror, str(target)) from error
