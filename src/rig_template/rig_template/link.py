"""Lines of text to an instrument and back, over TCP or a serial port."""

from __future__ import annotations

import os
import select
import socket
import termios
import time
import tty
from typing import Protocol
from urllib.parse import parse_qs, urlsplit

__all__ = ["AbsentError", "Link", "LinkError", "open_link"]

_BLOCK = 65_536
_LONGEST = 1_000_000


class LinkError(ValueError):
    """The instrument does not answer, or not in lines; one line says which and what to look at."""


class AbsentError(LinkError, ConnectionError):
    """Nobody is there: the instrument is off, or not yet on; a node that starts ends with status 1, and may be started again."""


class _Port(Protocol):
    """An open device: written to, waited for and read by its file descriptor."""

    def fileno(self) -> int: ...

    def close(self) -> None: ...


class _Descriptor:
    def __init__(self, number: int) -> None:
        self._number = number

    def fileno(self) -> int:
        return self._number

    def close(self) -> None:
        os.close(self._number)


class Link:
    """One question, one answer, each a line.

    Parameters
    ----------
    port : an open socket or serial port
    name : for messages
    timeout_s : after which an answer that has not come is a fault [s]
    """

    def __init__(self, port: _Port, name: str, timeout_s: float) -> None:
        self._port, self._name, self._timeout_s = port, name, timeout_s
        self._rest = b""
        os.set_blocking(port.fileno(), False)

    def write(self, line: str) -> None:
        """Send a line that has no answer.

        Parameters
        ----------
        line : without its end

        Raises
        ------
        LinkError : the other side has gone or takes nothing any more.
        """
        data = line.encode("ascii") + b"\n"
        deadline = time.monotonic() + self._timeout_s
        while data:
            self._wait(deadline, writing=True)
            try:
                data = data[os.write(self._port.fileno(), data) :]
            except OSError as error:
                raise LinkError(f"{self._name}: {error.strerror}: is the instrument on?") from error

    def ask(self, line: str) -> str:
        """Send a line and return the answer without its end.

        Parameters
        ----------
        line : without its end

        Returns
        -------
        str

        Raises
        ------
        LinkError : no answer within the time, or no text.
        """
        self.drop()
        self.write(line)
        deadline = time.monotonic() + self._timeout_s
        while b"\n" not in self._rest:
            self._wait(deadline, writing=False)
            self._read()
        answer, _, self._rest = self._rest.partition(b"\n")
        try:
            return answer.decode("ascii").strip()
        except UnicodeDecodeError:
            raise LinkError(
                f"{self._name}: found {answer[:20]!r}, need text: is the baud rate right?"
            ) from None

    def drop(self) -> None:
        """Forget what came too late for an earlier question."""
        while select.select([self._port], [], [], 0.0)[0]:
            self._read()
        self._rest = b""

    def close(self) -> None:
        """Close the connection."""
        self._port.close()

    def _read(self) -> None:
        try:
            data = os.read(self._port.fileno(), _BLOCK)
        except OSError as error:
            raise LinkError(f"{self._name}: {error.strerror}: is the instrument on?") from error
        if not data:
            raise LinkError(f"{self._name}: the instrument has closed the connection")
        self._rest += data
        if len(self._rest) > _LONGEST:
            raise LinkError(f"{self._name}: found {len(self._rest)} bytes without an end of line")

    def _wait(self, deadline: float, *, writing: bool) -> None:
        ports = [self._port]
        left_s = max(0.0, deadline - time.monotonic())
        ready = select.select([] if writing else ports, ports if writing else [], [], left_s)
        if not any(ready):
            raise LinkError(f"{self._name}: no answer within {self._timeout_s:g} s")


def open_link(address: str, timeout_s: float) -> Link:
    """Open the connection to an instrument.

    Parameters
    ----------
    address : `tcp://HOST:PORT`, or `serial:///dev/ttyUSB0?baud=115200`
    timeout_s : of the connection and of every answer [s]

    Returns
    -------
    Link

    Raises
    ------
    LinkError : an address that is none of these, or nobody there.
    """
    parts = urlsplit(address)
    try:
        if parts.scheme == "tcp" and parts.hostname and parts.port:
            found = socket.create_connection((parts.hostname, parts.port), timeout_s)
            # a command is a few bytes: they are not to wait for more
            found.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
            return Link(found, address, timeout_s)
        if parts.scheme == "serial" and parts.path:
            baud = parse_qs(parts.query).get("baud", ["115200"])[0]
            return Link(_serial_port(parts.path, baud), address, timeout_s)
    except (OSError, termios.error) as error:
        reason = error.args[-1] if error.args else error
        raise AbsentError(f"connection: {address}: {reason}: is the instrument on?") from error
    except ValueError as error:
        raise LinkError(f"connection: {address}: {error}") from error
    raise LinkError(f"connection: found {address!r}, need tcp://HOST:PORT or serial:///dev/NAME?baud=115200")


def _serial_port(path: str, baud: str) -> _Descriptor:
    speed = getattr(termios, f"B{baud}", None)
    if not isinstance(speed, int):
        raise ValueError(f"baud: found {baud}, need a usual rate such as 9600 or 115200")
    number = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        tty.setraw(number)
        settings = termios.tcgetattr(number)
        settings[4] = settings[5] = speed
        termios.tcsetattr(number, termios.TCSANOW, settings)
    except termios.error:
        os.close(number)
        raise
    return _Descriptor(number)
