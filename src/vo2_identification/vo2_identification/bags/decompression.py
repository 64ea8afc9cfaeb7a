"""Decompression that gives what it can of data cut short."""

from __future__ import annotations

import sys
from typing import Any

if sys.version_info >= (3, 14):
    from compression import zstd
else:
    from backports import zstd

__all__ = ["ZSTD_MAGIC", "expand", "zstd"]

ZSTD_MAGIC = b"\x28\xb5\x2f\xfd"
"""First bytes of every zstd frame; serialized messages begin with 0x00."""

_PIECE = 1 << 16


def expand(data: bytes, compression: str) -> tuple[bytes, bool]:
    """Return the decompressed bytes and whether the compressed data was whole.

    Parameters
    ----------
    data : compressed bytes, possibly cut short
    compression : "", "zstd" or "lz4" as MCAP names them

    Raises
    ------
    ValueError : unknown compression.
    """
    if compression == "":
        return data, True
    decoder: Any
    failure: type[Exception]
    if compression == "zstd":
        decoder, failure = zstd.ZstdDecompressor(), zstd.ZstdError
    elif compression == "lz4":
        import lz4.frame

        decoder, failure = lz4.frame.LZ4FrameDecompressor(), RuntimeError
    else:
        raise ValueError(f"compression {compression!r} is not known, need zstd, lz4 or none")
    pieces: list[bytes] = []
    # piece by piece, so that damage in the middle costs only what comes after it
    for start in range(0, len(data), _PIECE):
        try:
            pieces.append(decoder.decompress(data[start : start + _PIECE]))
        except failure:
            return b"".join(pieces), False
        if decoder.eof:
            return b"".join(pieces), True
    return b"".join(pieces), False
