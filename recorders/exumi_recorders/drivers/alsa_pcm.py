"""The calls of ALSA's library that recording needs, through ctypes."""

import ctypes
import errno
from typing import Protocol

from exumi_data.time import NS_PER_S
from exumi_recorders.contract import DeviceError, DeviceLostError

__all__ = ["AlsaPcm", "OverrunError", "Pcm"]

_LIBRARY = "libasound.so.2"
_CAPTURE, _NONBLOCK = 1, 1
_INTERLEAVED, _S16_LE = 3, 2
_TSTAMP_ENABLE, _TSTAMP_MONOTONIC = 1, 1
_PERIODS = 8
_SAMPLE_BYTES = 2


class OverrunError(Exception):
    """The kernel's buffer was full: sound was lost."""


class _TimeSpec(ctypes.Structure):
    _fields_ = (("seconds", ctypes.c_long), ("nanoseconds", ctypes.c_long))


class Pcm(Protocol):
    """A sound card that is open for recording."""

    def wait(self, timeout_s: float) -> bool:
        """Wait for a block, but not longer; tell whether there may be one. Raises OverrunError."""

    def stamp(self) -> tuple[int, int]:
        """Return how many samples wait to be read, and when that was so (CLOCK_MONOTONIC, ns)."""

    def read(self, samples: int) -> bytes:
        """Return at most so many samples of all channels. Raises OverrunError."""

    def restart(self) -> None:
        """Begin again after an overrun."""

    def close(self) -> None:
        """Release the card."""


class AlsaPcm:
    """A sound card through ALSA: 16 bits, interleaved, stamped with CLOCK_MONOTONIC.

    Parameters
    ----------
    device : str
        As ALSA names it, such as ``hw:1,0``.
    rate, channels : int
        Samples per second, which the card has to keep; channels.
    block : int
        Samples of a block: the card wakes us once for each.

    Raises
    ------
    DeviceError
        There is no ALSA, or no such card, or it does not record like this.
    """

    def __init__(self, device: str, rate: int, channels: int, block: int) -> None:
        self._device = device
        self._channels = channels
        self._pcm = ctypes.c_void_p()
        try:
            self._library = ctypes.CDLL(_LIBRARY)
        except OSError:
            raise DeviceError(
                "ALSA's library is not installed", fix="On Debian: apt install libasound2."
            ) from None
        self._library.snd_strerror.restype = ctypes.c_char_p
        self._library.snd_pcm_readi.restype = ctypes.c_long
        self._buffer = ctypes.create_string_buffer(block * channels * _SAMPLE_BYTES)
        self._check(
            self._library.snd_pcm_open(
                ctypes.byref(self._pcm), device.encode(), _CAPTURE, _NONBLOCK
            ),
            "cannot be opened",
        )
        try:
            self._set_hardware(rate, block)
            self._set_software(block)
            self._check(self._library.snd_pcm_start(self._pcm), "does not start")
        except BaseException:
            self.close()
            raise

    def _text(self, code: int) -> str:
        return bytes(self._library.snd_strerror(code)).decode("utf-8", "replace")

    def _check(self, code: int, failure: str, fix: str | None = None) -> None:
        if code < 0:
            text = f"the sound card {self._device} {failure} ({self._text(code)})"
            kind = DeviceLostError if code == -errno.ENODEV else DeviceError
            raise kind(text, fix=fix or "`arecord -l` lists the cards, and what uses them.")

    def _set_hardware(self, rate: int, block: int) -> None:
        library, pcm, unsigned = self._library, self._pcm, ctypes.c_uint
        parameters = ctypes.c_void_p()
        library.snd_pcm_hw_params_malloc(ctypes.byref(parameters))
        try:
            self._check(library.snd_pcm_hw_params_any(pcm, parameters), "has no settings")
            for name, value, what in (
                ("access", _INTERLEAVED, "interleaved samples"),
                ("format", _S16_LE, "16 bits"),
                ("channels", self._channels, f"{self._channels} channels"),
            ):
                setter = getattr(library, f"snd_pcm_hw_params_set_{name}")
                self._check(setter(pcm, parameters, unsigned(value)), f"gives no {what}")
            self._check(
                library.snd_pcm_hw_params_set_rate(pcm, parameters, unsigned(rate), 0),
                f"does not record at {rate} samples/s",
                fix="`arecord --dump-hw-params` says what it does; `plughw:` would resample.",
            )
            for name, samples in (("period", block), ("buffer", block * _PERIODS)):
                near = ctypes.c_ulong(samples)
                setter = getattr(library, f"snd_pcm_hw_params_set_{name}_size_near")
                self._check(setter(pcm, parameters, ctypes.byref(near), None), "has no buffers")
            self._check(library.snd_pcm_hw_params(pcm, parameters), "takes no settings")
        finally:
            library.snd_pcm_hw_params_free(parameters)

    def _set_software(self, block: int) -> None:
        library, pcm = self._library, self._pcm
        parameters = ctypes.c_void_p()
        library.snd_pcm_sw_params_malloc(ctypes.byref(parameters))
        try:
            self._check(library.snd_pcm_sw_params_current(pcm, parameters), "has no settings")
            for name, value in (
                ("tstamp_mode", _TSTAMP_ENABLE),
                ("tstamp_type", _TSTAMP_MONOTONIC),
            ):
                setter = getattr(library, f"snd_pcm_sw_params_set_{name}")
                self._check(setter(pcm, parameters, ctypes.c_int(value)), "gives no time stamps")
            least = ctypes.c_ulong(block)
            self._check(
                library.snd_pcm_sw_params_set_avail_min(pcm, parameters, least), "has no blocks"
            )
            self._check(library.snd_pcm_sw_params(pcm, parameters), "takes no settings")
        finally:
            library.snd_pcm_sw_params_free(parameters)

    def _lost(self, code: int) -> None:
        if code in (-errno.EPIPE, -errno.ESTRPIPE):
            raise OverrunError
        if code < 0 and code not in (-errno.EAGAIN, -errno.EINTR):
            raise DeviceLostError(f"the sound card {self._device} is gone ({self._text(code)})")

    def wait(self, timeout_s: float) -> bool:
        """Wait for a block."""
        code = int(self._library.snd_pcm_wait(self._pcm, ctypes.c_int(int(timeout_s * 1e3))))
        self._lost(code)
        return code > 0

    def stamp(self) -> tuple[int, int]:
        """Return what waits, and when that was so."""
        waiting, at = ctypes.c_ulong(), _TimeSpec()
        code = self._library.snd_pcm_htimestamp(self._pcm, ctypes.byref(waiting), ctypes.byref(at))
        self._lost(int(code))
        return waiting.value, at.seconds * NS_PER_S + at.nanoseconds

    def read(self, samples: int) -> bytes:
        """Read samples."""
        frame_bytes = self._channels * _SAMPLE_BYTES
        most = min(samples, len(self._buffer) // frame_bytes)
        count = int(self._library.snd_pcm_readi(self._pcm, self._buffer, ctypes.c_ulong(most)))
        self._lost(count)
        return self._buffer.raw[: max(0, count) * frame_bytes]

    def restart(self) -> None:
        """Begin again."""
        self._check(self._library.snd_pcm_prepare(self._pcm), "does not start again")
        self._check(self._library.snd_pcm_start(self._pcm), "does not start again")

    def close(self) -> None:
        """Release the card; also a second time."""
        pcm, self._pcm = self._pcm, ctypes.c_void_p()
        if pcm.value is not None:
            self._library.snd_pcm_close(pcm)
