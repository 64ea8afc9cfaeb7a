"""`instrument`: a simulated DAQ with a current source, to try a rig's node with: SCPI-like lines over TCP or a pty.

`*IDN?` names it, `SOUR:CURR X` sets the current [A], `OUTP ON` and `OUTP OFF` switch it, `READ?` is answered with
current [A], resistance [ohm] and deflection [m], `SYST:ERR?` with what was wrong last. Behind it is the simulated
device, in real time. `--silent-after S`, `--garbled-after S` and `--beyond-after S` make it fail.
"""

from __future__ import annotations

import argparse
import math
import os
import socket
import sys
import time
import tty
from collections.abc import Sequence

from vo2_models.device import truth

__all__ = ["Instrument", "main"]

_NO_ERROR = '0,"No error"'
_MOST_STEPS = 200
"""After a long silence the device is not stepped through all of it: it settles in a few time constants."""


class Instrument:
    """What answers the lines.

    Parameters
    ----------
    device : preset, or path of a device file
    seed : which device of this kind

    Attributes
    ----------
    current_a, output : what was set last [A]; whether the output is on
    """

    def __init__(self, device: str = "integrated", seed: int = 1) -> None:
        self._stepper = truth(device, seed=seed).stepper(seed=seed + 1)
        self.current_a, self.output = 0.0, False
        self._error = _NO_ERROR
        self._values = self._stepper.step(0.0)
        self._at_s = time.monotonic()

    def answer(self, line: str) -> str | None:
        """Obey a line; return the answer, None where it has none."""
        words = line.strip().upper()
        self._go_on()
        if words == "*IDN?":
            return f"VO2,simulated DAQ,{self._stepper.period:g},1"
        if words == "READ?":
            return ",".join(f"{value:.9g}" for value in self._values)
        if words == "SOUR:CURR?":
            return f"{self.current_a:.9g}"
        if words == "OUTP?":
            return str(int(self.output))
        if words == "SYST:ERR?":
            said, self._error = self._error, _NO_ERROR
            return said
        if words in ("OUTP ON", "OUTP OFF"):
            self.output = words == "OUTP ON"
        elif words.startswith("SOUR:CURR "):
            self._set(words.removeprefix("SOUR:CURR "))
        else:
            self._error = f'-113,"Undefined header; {line.strip()}"'
        return None

    def _set(self, text: str) -> None:
        try:
            value = float(text)
        except ValueError:
            value = math.nan
        if math.isfinite(value):
            self.current_a = value
        else:
            self._error = f'-224,"Illegal parameter value; {text}"'

    def _go_on(self) -> None:
        """Bring the device to the present time, with the current that has flown since."""
        now = time.monotonic()
        steps = int((now - self._at_s) / self._stepper.period)
        self._at_s += steps * self._stepper.period
        for _ in range(min(steps, _MOST_STEPS)):
            self._values = self._stepper.step(self.current_a if self.output else 0.0)


def _serve(instrument: Instrument, number: int, options: argparse.Namespace) -> None:
    """Answer the lines that come on a file descriptor until it is closed."""
    began, rest = time.monotonic(), b""
    while True:
        try:
            data = os.read(number, 65_536)
        except OSError:  # a serial line whose other end was closed
            return
        if not data:
            return
        *lines, rest = (rest + data).split(b"\n")
        passed_s = time.monotonic() - began
        for line in lines:
            said = instrument.answer(line.decode("ascii", "replace"))
            if options.log:
                print(line.decode("ascii", "replace"), file=sys.stderr, flush=True)
            if said is None or passed_s > options.silent_after:
                continue
            if passed_s > options.garbled_after:
                said = "?" + said
            if passed_s > options.beyond_after:
                said = ",".join([*said.split(",")[:-1], "9.9E+37"])
            os.write(number, said.encode("ascii") + b"\n")


def main(args: Sequence[str] | None = None) -> int:
    """Serve one client after the other until Ctrl-C.

    Parameters
    ----------
    args : command line, None for that of the process

    Returns
    -------
    int : exit status
    """
    parser = argparse.ArgumentParser(prog="instrument", description=__doc__, allow_abbrev=False)
    parser.add_argument("--device", default="integrated", help="Preset, or path of a device file.")
    parser.add_argument("--seed", type=int, default=1, help="Which device of this kind.")
    parser.add_argument("--port", type=int, default=5025, help="TCP port on this host; 0 for a free one.")
    parser.add_argument("--pty", action="store_true", help="A pseudo terminal in the place of TCP.")
    parser.add_argument("--silent-after", type=float, default=math.inf, metavar="S", help="Answer no more.")
    parser.add_argument("--garbled-after", type=float, default=math.inf, metavar="S", help="Answer nonsense.")
    parser.add_argument(
        "--beyond-after",
        type=float,
        default=math.inf,
        metavar="S",
        help="The last value is beyond the range.",
    )
    parser.add_argument("--log", action="store_true", help="Write every line that comes to standard error.")
    options = parser.parse_args(args)
    try:
        instrument = Instrument(options.device, options.seed)
        if options.pty:
            return _serve_terminal(instrument, options)
        return _serve_socket(instrument, options)
    except (ValueError, OSError) as error:
        print(f"instrument: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 0


def _serve_terminal(instrument: Instrument, options: argparse.Namespace) -> int:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    print(f"serial://{os.ttyname(theirs)}", flush=True)
    _serve(instrument, ours, options)
    return 0


def _serve_socket(instrument: Instrument, options: argparse.Namespace) -> int:
    with socket.create_server(("127.0.0.1", options.port)) as server:
        print(f"tcp://127.0.0.1:{server.getsockname()[1]}", flush=True)
        while True:
            client, _ = server.accept()
            with client:
                client.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
                _serve(instrument, client.fileno(), options)


if __name__ == "__main__":
    sys.exit(main())
