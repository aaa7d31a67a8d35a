"""Sound: blocks of 16-bit samples, each with the time at which its first sample reached the hub.

ALSA tells how many samples waited at a moment of CLOCK_MONOTONIC; the first of them came that many
samples earlier. Of a socket (``unix:/path``) the blocks bring their own stamps, in the frames of
`socket_camera`.
"""

import time
from collections.abc import Callable
from fractions import Fraction
from typing import Protocol

from pydantic import BaseModel, ConfigDict, Field

from exumi_data.time import NS_PER_S
from exumi_recorders.contract import Blocks, DeviceError, DriverType, Event, Health, Port, Sample
from exumi_recorders.drivers.alsa_pcm import AlsaPcm, OverrunError, Pcm
from exumi_recorders.drivers.camera import Frame, Shape
from exumi_recorders.drivers.socket_camera import SocketSource
from exumi_recorders.drivers.waiting import first_items

__all__ = ["DRIVER", "AlsaSource", "SoundDriver", "SoundOptions"]

_SOCKET = "unix:"
_SAMPLE_BYTES = 2
_SILENT_NS = NS_PER_S
_AT_ONCE = 16
_SEQUENCES = 1 << 32
_PAST_NS = 60 * NS_PER_S


class SoundOptions(BaseModel):
    """A microphone's part of a rig file.

    Attributes
    ----------
    device : str
        As ALSA names it (``hw:1,0``; ``arecord -l`` lists them), or ``unix:/path`` of a socket.
    rate : int
        Samples per second.
    channels : int
    block_ms : int
        Milliseconds of a block.
    """

    model_config = ConfigDict(extra="forbid", frozen=True)

    device: str = Field(default="default", min_length=1)
    rate: int = Field(default=48_000, ge=1000, le=768_000)
    channels: int = Field(default=1, ge=1, le=64)
    block_ms: int = Field(default=20, ge=1, le=1000)

    @property
    def block(self) -> int:
        """Samples of a block."""
        return self.rate * self.block_ms // 1000


class SoundSource(Protocol):
    """Where blocks come from; their `sequence` is None where lost ones are not numbered."""

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the blocks that have come; wait for the first, but not longer."""

    def close(self) -> None:
        """Release it; also a second time."""


class AlsaSource:
    """Blocks of a sound card.

    Parameters
    ----------
    pcm : Pcm
    options : SoundOptions
    """

    def __init__(self, pcm: Pcm, options: SoundOptions) -> None:
        self._pcm = pcm
        self._options = options
        self._frame_bytes = options.channels * _SAMPLE_BYTES
        self._next_ns: int | None = None
        self.overruns = 0
        self.lost_blocks = 0

    def read(self, timeout_s: float) -> list[Frame]:
        """Return the blocks that have come.

        Raises
        ------
        DeviceLostError
            The card is gone.
        """
        found: list[Frame] = []
        try:
            if not self._pcm.wait(timeout_s):
                return found
            while len(found) < _AT_ONCE:
                waiting, at_ns = self._pcm.stamp()
                if waiting < self._options.block:
                    break
                data = self._pcm.read(self._options.block)
                if not data:
                    break
                stamp_ns = at_ns - round(Fraction(waiting * NS_PER_S, self._options.rate))
                self._count(stamp_ns, len(data) // self._frame_bytes)
                found.append(Frame(data, stamp_ns))
        except OverrunError:
            self.overruns += 1
            self._pcm.restart()
        return found

    def _count(self, stamp_ns: int, samples: int) -> None:
        """Count what was lost between two blocks, after an overrun: their times say it."""
        rate, block = self._options.rate, self._options.block
        if self._next_ns is not None and self.overruns > 0:
            missing = (stamp_ns - self._next_ns) * rate / NS_PER_S / block
            self.lost_blocks += max(0, round(missing))
        self._next_ns = stamp_ns + round(Fraction(samples * NS_PER_S, rate))

    def close(self) -> None:
        """Release the card."""
        self._pcm.close()


class SoundDriver:
    """A microphone, as the contract of drivers has it; its one port is ``sound``.

    Parameters
    ----------
    options : SoundOptions
    open_pcm : callable
        Opens a sound card.
    monotonic_ns : callable
        The hub's clock.
    """

    def __init__(
        self,
        options: SoundOptions,
        open_pcm: Callable[[str, int, int, int], Pcm] = AlsaPcm,
        monotonic_ns: Callable[[], int] = time.monotonic_ns,
    ) -> None:
        self._options = options
        self._open_pcm = open_pcm
        self._now_ns = monotonic_ns
        self._source: SoundSource | None = None
        self._blocks = self._refused = self._skipped = 0
        self._next_sequence: int | None = None
        self._last_ns: int | None = None
        self._seen_ns = 0

    @property
    def ports(self) -> tuple[Port, ...]:
        """The port ``sound``."""
        options = self._options
        numbered = options.device.startswith(_SOCKET)
        return (
            Port(
                name="sound",
                kind="audio",
                payload=Blocks(channels=options.channels, rate=str(options.rate)),
                stamp_point="kernel_rx",
                droppable=True,
                modulus=SocketSource.modulus if numbered else None,
                metadata={"rate": str(options.rate), "channels": options.channels},
            ),
        )

    def open(self) -> None:
        """Open the card.

        Raises
        ------
        DeviceError
            It is not there, in use, or does not record like this.
        """
        self.close()
        options = self._options
        self._blocks = self._refused = self._skipped = 0
        self._next_sequence = self._last_ns = None
        if options.device.startswith(_SOCKET):
            source = SocketSource(options.device.removeprefix(_SOCKET))
            self._source = source
            # A socket asks for no shape: who serves it has decided.
            source.open(Shape(0, 0, Fraction(options.rate, options.block)))
        else:
            pcm = self._open_pcm(options.device, options.rate, options.channels, options.block)
            self._source = AlsaSource(pcm, options)
        self._seen_ns = self._now_ns()

    def read(self, timeout_s: float) -> list[Sample | Event]:
        """Return the blocks that have come; wait for the first, but not longer.

        Raises
        ------
        DeviceLostError
            The card is gone.
        """
        source = self._source
        if source is None:
            raise DeviceError(f"the sound card {self._options.device} is not open")

        def receive(left_s: float) -> list[Sample | Event]:
            return [
                Sample("sound", block.stamp_ns, block.data, sequence=block.sequence)
                for block in source.read(left_s)
                if self._takes(block)
            ]

        return first_items(receive, timeout_s)

    def _takes(self, block: Frame) -> bool:
        self._seen_ns = self._now_ns()
        if block.sequence is not None:
            if self._next_sequence is not None:
                missing = (block.sequence - self._next_sequence) % _SEQUENCES
                # More than half of the range is a step back: no loss.
                self._skipped += missing if missing < _SEQUENCES // 2 else 0
            self._next_sequence = (block.sequence + 1) % _SEQUENCES
        whole = block.data and not len(block.data) % (self._options.channels * _SAMPLE_BYTES)
        later = self._last_ns is None or block.stamp_ns > self._last_ns
        near = self._seen_ns - _PAST_NS < block.stamp_ns <= self._seen_ns
        if not (whole and later and near) or block.fault is not None:
            self._refused += 1
            return False
        self._blocks += 1
        self._last_ns = block.stamp_ns
        return True

    def health(self) -> Health:
        """Tell blocks and losses."""
        source = self._source
        lost = {"rejected": self._refused, "sequence": self._skipped}
        readings: dict[str, int] = {"blocks": self._blocks}
        if isinstance(source, AlsaSource):
            lost["overrun"] = source.lost_blocks
            readings["overruns"] = source.overruns
        silent_ns = self._now_ns() - self._seen_ns
        problems: tuple[str, ...] = ()
        if source is not None and silent_ns > _SILENT_NS:
            problems = (f"no sound for {silent_ns / NS_PER_S:.0f} s",)
        found = {cause: number for cause, number in lost.items() if number}
        return Health(lost=found, readings=readings, problems=problems)

    def close(self) -> None:
        """Release the card."""
        source, self._source = self._source, None
        if source is not None:
            source.close()


DRIVER = DriverType(
    name="alsa",
    text="A microphone or sound card through ALSA: 16-bit blocks with their times.",
    options=SoundOptions,
    make=SoundDriver,
)
