"""A TAC-02 on a pseudo-terminal: real frames, up to a thousand a second, from a session's truth.

It runs as a program of its own, as a device does:
``python -m exumi_recorders.simulated.tac02 LINK --side left --epoch-ns N``.
"""

import argparse
import errno
import os
import signal
import subprocess
import sys
import threading
import time
import tty
from collections import deque
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from exumi_recorders.contract import DeviceError
from exumi_recorders.drivers.tac02_frames import FRAME_BYTES, GRID, OFFSET, VALID, encode
from exumi_recorders.simulated.play import SimulatedPlay

if TYPE_CHECKING:
    from exumi_data.simulation import PlaySession

__all__ = ["Fault", "SimulatedTac02", "taxel_values"]

Side = Literal["left", "right"]
FaultName = Literal["garbage", "partial", "unplug"]

_PITCH_M = 2.2e-3
_WIDTH_CELLS = 1.4
_ADC_PER_M = 1.0e6  # 2 mm of indentation take 2000 of the 3500 steps
_BLOCK = 256
_NS = 1_000_000_000
_STALE_NS = 20_000_000
_START_S = 20.0


def taxel_values(session: "PlaySession", side: Side, t_s: ArrayLike) -> NDArray[np.int16]:
    """Return what the cells of a finger's pad measure.

    Where an object is pressed in, the values fall by a step a micrometre, less with the distance
    from the contact's middle.

    Parameters
    ----------
    session : PlaySession
    side : {"left", "right"}
    t_s : array_like, shape (N,)
        Seconds since session start.

    Returns
    -------
    ndarray of int16, shape (N, 11, 6)
        3500 without contact.
    """
    times_s = np.atleast_1d(np.asarray(t_s, np.float64))
    depth_m = session.truth.contact_depth_m(side, times_s)
    # Across and down from the pad's middle; NaN without contact.
    place = np.nan_to_num(session.truth.contact_pose(side, times_s)[:, :2]) / _PITCH_M
    rows = np.arange(GRID[0]) - (GRID[0] - 1) / 2
    columns = np.arange(GRID[1]) - (GRID[1] - 1) / 2
    down = (rows[None, :, None] - place[:, 1, None, None]) ** 2
    across = (columns[None, None, :] - place[:, 0, None, None]) ** 2
    near = np.exp(-(down + across) / (2 * _WIDTH_CELLS**2))
    pressed = np.round(_ADC_PER_M * depth_m[:, None, None] * near)
    values = np.clip(OFFSET - pressed, 0, OFFSET).astype(np.int16)
    values[:, ~VALID] = OFFSET
    return values


@dataclass(frozen=True, slots=True)
class Fault:
    """Something that goes wrong once.

    Attributes
    ----------
    at_s : float
        When, seconds since session start.
    name : {"garbage", "partial", "unplug"}
        Bytes that are no frame, a frame that is cut, the plug pulled.
    amount : float
        Bytes of garbage, bytes that are left of the frame, seconds without a plug.
    """

    at_s: float
    name: FaultName
    amount: float

    @classmethod
    def from_text(cls, text: str) -> "Fault":
        """Read ``2.5:garbage:37``."""
        at_s, name, amount = text.split(":")
        if name not in ("garbage", "partial", "unplug"):
            raise ValueError(name)
        return cls(float(at_s), name, float(amount))  # type: ignore[arg-type]  # one of the three

    def __str__(self) -> str:
        return f"{self.at_s}:{self.name}:{self.amount}"


class SimulatedTac02:
    """The simulated device in a process of its own.

    Parameters
    ----------
    play : SimulatedPlay
    side : {"left", "right"}
    link : path-like
        What a rig file names as ``port``: a link to the pseudo-terminal.
    rate_hz : int, optional
    faults : sequence of Fault, optional

    Attributes
    ----------
    play : SimulatedPlay
    port : str

    Raises
    ------
    DeviceError
        It did not start.
    """

    def __init__(
        self,
        play: SimulatedPlay,
        side: Side,
        link: str | os.PathLike[str],
        *,
        rate_hz: int = 1000,
        faults: Sequence[Fault] = (),
    ) -> None:
        self.play = play
        self.port = os.fspath(link)
        options = [
            *("--side", side, "--rate-hz", str(rate_hz), "--epoch-ns", str(play.epoch_ns)),
            *("--seed", str(play.seed), "--duration-s", str(play.duration_s)),
            *("--taps", str(play.taps)),
            "--listen",
            *(word for fault in faults for word in ("--fault", str(fault))),
        ]
        command = [sys.executable, "-m", __spec__.name, self.port, *options]
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, text=True)  # noqa: S603  # this module
        if self._process.stdin is None:
            raise RuntimeError("a pipe was asked for")
        self._input = self._process.stdin
        deadline_s = time.monotonic() + _START_S
        while not Path(self.port).exists():
            if self._process.poll() is not None or time.monotonic() > deadline_s:
                self.close()
                raise DeviceError("the simulated TAC-02 did not start", where=self.port)
            time.sleep(0.01)

    def fail(self, name: FaultName, amount: float) -> None:
        """Let something go wrong now: a `Fault`'s name and amount."""
        self._input.write(f"{Fault(0.0, name, amount)}\n")
        self._input.flush()

    def close(self) -> None:
        """End it."""
        with suppress(BrokenPipeError):
            self._input.close()
        self._process.terminate()
        self._process.wait()
        Path(self.port).unlink(missing_ok=True)

    def __enter__(self) -> "SimulatedTac02":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


@dataclass
class _Terminal:
    """A pseudo-terminal under a name of our own, which stays the same when it is opened anew."""

    link: Path
    _ends: list[int] = field(default_factory=list)

    def plug(self) -> None:
        # Our own hold on the reader's end lets us write while nobody reads.
        self._ends = list(os.openpty())
        tty.setraw(self._ends[1])
        os.set_blocking(self._ends[0], False)
        temporary = self.link.with_name(f".{self.link.name}.{os.getpid()}")
        temporary.symlink_to(os.ttyname(self._ends[1]))
        temporary.replace(self.link)

    def unplug(self) -> None:
        self.link.unlink(missing_ok=True)
        while self._ends:
            os.close(self._ends.pop())

    def send(self, data: bytes) -> None:
        """Send what fits: a device's own buffer is overwritten when nobody reads."""
        try:
            os.write(self._ends[0], data)
        except OSError as error:
            if error.errno != errno.EAGAIN:
                raise


def _frames(session: "PlaySession", side: Side, rate_hz: int, first: int) -> Iterator[bytes]:
    """Yield the frames from one on; the truth is asked for many at a time."""
    while True:
        values = taxel_values(session, side, np.arange(first, first + _BLOCK) / rate_hz)
        block = encode(values)
        for start in range(0, len(block), FRAME_BYTES):
            yield block[start : start + FRAME_BYTES]
        first += _BLOCK


def _run(
    terminal: _Terminal, play: SimulatedPlay, side: Side, rate_hz: int, faults: deque[Fault]
) -> None:
    session = play.session()
    noise = np.random.default_rng(play.seed)
    first = max(0, (time.monotonic_ns() - play.epoch_ns) * rate_hz // _NS + 1)
    terminal.plug()
    for number, frame in enumerate(_frames(session, side, rate_hz, first), first):
        left_ns = play.epoch_ns + number * _NS // rate_hz - time.monotonic_ns()
        if left_ns > 0:
            time.sleep(left_ns / _NS)
        elif left_ns < -_STALE_NS:
            continue  # a device does not keep what nobody could read
        if not faults or faults[0].at_s * rate_hz > number:
            terminal.send(frame)
            continue
        fault = faults.popleft()
        if fault.name == "garbage":
            terminal.send(noise.bytes(int(fault.amount)))
        elif fault.name == "partial":
            terminal.send(frame[: int(fault.amount)])
        else:
            terminal.unplug()
            time.sleep(fault.amount)
            terminal.plug()


def _listen(asked: deque[Fault]) -> None:
    for line in sys.stdin:
        asked.append(Fault.from_text(line))
    # Whoever started it may be killed, and then closes its end of the pipe.
    os.kill(os.getpid(), signal.SIGINT)


def main() -> None:
    """Run the device until it is ended."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("link", type=Path)
    parser.add_argument("--side", choices=("left", "right"), required=True)
    parser.add_argument("--epoch-ns", type=int, required=True)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--duration-s", type=float, default=20.0)
    parser.add_argument("--taps", type=int, default=0)
    parser.add_argument("--rate-hz", type=int, default=1000)
    parser.add_argument("--fault", type=Fault.from_text, action="append", default=[])
    text = "take faults from the standard input, one a line, and end with it"
    parser.add_argument("--listen", action="store_true", help=text)
    given = parser.parse_args()
    faults = deque(sorted(given.fault, key=lambda fault: fault.at_s))
    if given.listen:
        threading.Thread(target=_listen, args=(faults,), daemon=True).start()
    play = SimulatedPlay(
        seed=given.seed, duration_s=given.duration_s, taps=given.taps, epoch_ns=given.epoch_ns
    )
    terminal = _Terminal(given.link)
    with suppress(KeyboardInterrupt):
        _run(terminal, play, given.side, given.rate_hz, faults)
    terminal.unplug()


if __name__ == "__main__":
    main()
