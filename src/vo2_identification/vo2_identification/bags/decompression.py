"""Compression, and decompression that gives what it can of data cut short, and no more than a stated multiple of it.

A few hundred kilobytes of zstd or lz4 can stand for gigabytes. Recordings compress some 20 times; what expands to more
than 200 times its size plus a megabyte is cut there; what is held in memory whole, a chunk or a message, at 268 MB.
"""

from __future__ import annotations

import sys
from collections.abc import Iterable, Iterator
from typing import Any

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = ["COMPRESSIONS", "ZSTD_MAGIC", "compress", "expand", "expand_pieces", "most_bytes"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of every zstd frame; serialized messages begin with 0x00."""

COMPRESSIONS = ("none", "zstd", "lz4")
"""What chunks of an MCAP file may be compressed with."""
_PIECE = 1 << 16
_MOST_TIMES = 200
_SLACK = 1 << 20
_MOST_AT_ONCE = 1 << 28


def most_bytes(compressed: int) -> int:
    """Return how many bytes this many compressed bytes may stand for."""
    return _MOST_TIMES * compressed + _SLACK


def compress(data: bytes, compression: str) -> bytes:
    """Return the compressed bytes.

    Parameters
    ----------
    data : of any length
    compression : "", "zstd" or "lz4" as MCAP names them

    Returns
    -------
    bytes

    Raises
    ------
    ValueError : unknown compression.
    """
    if compression == "":
        return data
    if compression == "zstd":
        return zstd.compress(data)
    if compression == "lz4":
        import lz4.frame

        compressed: bytes = lz4.frame.compress(data)
        return compressed
    raise ValueError(f"compression {compression!r} is not known, need zstd, lz4 or none")


def expand(data: bytes, compression: str) -> tuple[bytes, str]:
    """Return the decompressed bytes and what is wrong with them, "" if they are whole.

    Parameters
    ----------
    data : compressed bytes, possibly cut short
    compression : "", "zstd" or "lz4" as MCAP names them

    Raises
    ------
    ValueError : unknown compression.
    """
    if compression == "":
        return data, ""
    pieces: list[bytes] = []
    # piece by piece, so that damage in the middle costs only what comes after it
    parts = (data[start : start + _PIECE] for start in range(0, len(data), _PIECE))
    try:
        for piece in expand_pieces(parts, compression, min(most_bytes(len(data)), _MOST_AT_ONCE)):
            pieces.append(piece)
    except EOFError as error:
        return b"".join(pieces), str(error)
    return b"".join(pieces), ""


def expand_pieces(parts: Iterable[bytes], compression: str, most: int) -> Iterator[bytes]:
    """Yield decompressed pieces of at most a megabyte, at most `most` bytes in all.

    Parameters
    ----------
    parts : compressed pieces, in order

    Raises
    ------
    EOFError : the data is damaged, cut short, or stands for more than `most` bytes; all before that was yielded.
    ValueError : unknown compression.
    """
    decoder: Any
    failure: type[Exception]
    if compression == "zstd":
        decoder, failure = zstd.ZstdDecompressor(), zstd.ZstdError
    elif compression == "lz4":
        import lz4.frame

        decoder, failure = lz4.frame.LZ4FrameDecompressor(), RuntimeError
    else:
        raise ValueError(f"compression {compression!r} is not known, need zstd, lz4 or none")
    count = 0
    for part in parts:
        waiting = part
        while True:
            try:
                piece = decoder.decompress(waiting, max_length=min(_SLACK, most - count + 1))
            except failure as error:
                raise EOFError(f"it is damaged ({error})") from None
            waiting = b""
            count += len(piece)
            if count > most:
                raise EOFError(f"it expands to more than {most / 1e6:.4g} MB, at most that is read")
            if piece:
                yield piece
            if decoder.eof:
                return
            if decoder.needs_input or not piece:
                break
    raise EOFError("it is cut short")
