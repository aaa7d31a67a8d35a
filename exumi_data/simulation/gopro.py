"""Clips as a GoPro writes them: video, timecode, and its telemetry track with a gyroscope."""

import struct
from collections.abc import Callable
from dataclasses import dataclass
from datetime import datetime, timedelta
from fractions import Fraction
from pathlib import Path
from typing import Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

__all__ = ["Pictures", "SimulatedGoPro", "TurningHand", "gpmf_payload", "timecode_text"]

Pictures = Callable[[int], NDArray[np.uint8]]
"""From a frame's number to its picture, (H, W, 3) uint8 RGB; asked for in order."""

_SIDE_PX = 32
_PAYLOAD_S = 1.001
_TELEMETRY_BASE = Fraction(1, 1000)


class TurningHand(Protocol):
    """A hand whose angular velocity is known."""

    def rad_per_s(self, t_s: NDArray[np.floating]) -> NDArray[np.float64]:
        """Return it about the hand's own axes, (N, 3), at seconds of the session."""
        ...


def _flat(number: int) -> NDArray[np.uint8]:
    return np.full((_SIDE_PX, _SIDE_PX, 3), 8 * (number % 32), np.uint8)


@dataclass(frozen=True, slots=True)
class SimulatedGoPro:
    """A camera that is fixed to the hand somehow, with a clock that somebody once set.

    Attributes
    ----------
    rate : Fraction
        Frames a second.
    gyro_hz : float
    noise_rad_per_s : float
        Standard deviation of a gyroscope's sample about each axis.
    bias_rad_per_s : (float, float, float)
    mounting_deg : (float, float, float)
        Euler angles xyz from the hand's axes to the camera's.
    drift_ppm : float
        By how much its clock runs fast.
    clock_s : float
        By how much its clock is ahead, time zone included.
    codec : str
        FFmpeg's name of an encoder.
    bit_rate : int
    position_deg : (float, float) or None
        Latitude and longitude that its receiver says; None where it has no fix.
    """

    rate: Fraction = Fraction(30_000, 1001)
    gyro_hz: float = 199.3
    noise_rad_per_s: float = 0.01
    bias_rad_per_s: tuple[float, float, float] = (0.012, -0.008, 0.005)
    mounting_deg: tuple[float, float, float] = (31.0, -12.0, 97.0)
    drift_ppm: float = 0.0
    clock_s: float = 0.0
    codec: str = "mpeg4"
    bit_rate: int = 1_000_000
    position_deg: tuple[float, float] | None = None

    def film(  # keyword-only options, each with a default
        self,
        path: Path,
        hand: TurningHand,
        span_s: tuple[float, float],
        *,
        session_start: datetime,
        seed: int = 0,
        telemetry: bool = True,
        pictures: Pictures | None = None,
    ) -> None:
        """Write a clip.

        Parameters
        ----------
        path : pathlib.Path
            ``.MP4``.
        hand : TurningHand
            That it is fixed to.
        span_s : (float, float)
            From when to when, seconds of the session.
        session_start : datetime
            UTC of the session's time 0.
        seed : int, optional
            Of the gyroscope's noise.
        telemetry : bool, optional
            Whether there is a gyroscope.
        pictures : callable, optional
            What it sees. Default: small grey squares.
        """
        import av

        draw = pictures or _flat

        fast = 1.0 + 1e-6 * self.drift_ppm
        length_s = (span_s[1] - span_s[0]) * fast
        shown = session_start + timedelta(seconds=span_s[0] + self.clock_s)
        with av.open(str(path), "w", format="mp4", options={"write_tmcd": "1"}) as container:
            container.metadata["creation_time"] = shown.strftime("%Y-%m-%dT%H:%M:%SZ")
            if self.position_deg is not None:
                container.metadata["location"] = "{:+08.4f}{:+09.4f}/".format(*self.position_deg)
            quick = {"preset": "ultrafast"} if self.codec.startswith("libx26") else {}
            video = container.add_stream(self.codec, rate=self.rate, options=quick)
            assert isinstance(video, av.VideoStream)  # noqa: S101  # the codec is one
            pixels = draw(0)
            video.height, video.width = pixels.shape[:2]
            video.pix_fmt, video.bit_rate = "yuv420p", self.bit_rate
            video.metadata["timecode"] = timecode_text(shown, self.rate)
            data = container.add_data_stream("bin_data") if telemetry else None
            if data is not None:
                data.time_base = _TELEMETRY_BASE
            for number in range(int(length_s * self.rate)):
                pixels = draw(number) if number else pixels
                container.mux(video.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
            container.mux(video.encode(None))
            if data is None:
                return
            for start_ms, length_ms, payload in self._payloads(
                hand, span_s[0], length_s, np.random.default_rng([seed, 7])
            ):
                packet = av.Packet(payload)
                packet.stream, packet.time_base = data, _TELEMETRY_BASE
                packet.pts = packet.dts = start_ms
                packet.duration = length_ms
                container.mux(packet)

    def _payloads(
        self,
        hand: TurningHand,
        start_s: float,
        length_s: float,
        rng: np.random.Generator,
    ) -> list[tuple[int, int, bytes]]:
        time_s = (np.arange(int(length_s * self.gyro_hz)) + rng.uniform()) / self.gyro_hz
        true_s = start_s + time_s / (1.0 + 1e-6 * self.drift_ppm)
        turned = hand.rad_per_s(true_s)
        values = Rotation.from_euler("xyz", self.mounting_deg, degrees=True).apply(turned)
        values += np.array(self.bias_rad_per_s)
        values += rng.normal(0.0, self.noise_rad_per_s, values.shape)
        found = []
        for number in range(int(length_s / _PAYLOAD_S) + 1):
            first, last = np.searchsorted(time_s, [number * _PAYLOAD_S, (number + 1) * _PAYLOAD_S])
            if last > first:
                start_ms = round(1e3 * number * _PAYLOAD_S)
                length_ms = min(round(1e3 * _PAYLOAD_S), round(1e3 * length_s) - start_ms)
                payload = gpmf_payload(
                    values[first:last], total=int(last), position_deg=self.position_deg
                )
                found.append((start_ms, max(1, length_ms), payload))
        return found


def timecode_text(moment: datetime, rate: Fraction) -> str:
    """Return the timecode of a moment, in drop-frame where the rate asks for it.

    Parameters
    ----------
    moment : datetime
    rate : Fraction
        Frames a second.
    """
    nominal = round(rate)
    seconds = 3600 * moment.hour + 60 * moment.minute + moment.second + moment.microsecond * 1e-6
    frame = int(seconds * rate)
    drops = rate != nominal
    if drops:
        lost = nominal // 15
        tens, rest = divmod(frame, 600 * nominal - 9 * lost)
        frame += 9 * lost * tens
        if rest >= lost:
            frame += lost * ((rest - lost) // (60 * nominal - lost))
    whole, number = divmod(frame, nominal)
    mark = ";" if drops else ":"
    hours, minutes, second = whole // 3600, whole // 60 % 60, whole % 60
    return f"{hours % 24:02d}:{minutes:02d}:{second:02d}{mark}{number:02d}"


_SCALE = 939


def gpmf_payload(
    rad_per_s: NDArray[np.float64],
    *,
    total: int,
    device: str = "Hero12",
    position_deg: tuple[float, float] | None = None,
) -> bytes:
    """Return a payload of telemetry that holds these samples of a gyroscope.

    Parameters
    ----------
    rad_per_s : (N, 3) float64
    total : int
        Samples of the clip up to the end of this payload.
    device : str, optional
        What the camera calls itself.
    position_deg : (float, float), optional
        Latitude and longitude: ten samples of them, at one place.
    """
    counts = np.rint(rad_per_s * _SCALE).astype(">i2")
    stream = (
        _record(b"TSMP", "L", 4, struct.pack(">L", total))
        + _record(b"STNM", "c", 1, b"Gyroscope")
        + _record(b"SIUN", "c", 5, b"rad/s")
        + _record(b"SCAL", "s", 2, struct.pack(">h", _SCALE))
        + _record(b"GYRO", "s", 6, counts.tobytes())
    )
    return _record(
        b"DEVC",
        "\0",
        1,
        _record(b"DVID", "L", 4, struct.pack(">L", 1))
        + _record(b"DVNM", "c", 1, device.encode())
        + _record(b"STRM", "\0", 1, stream)
        + (b"" if position_deg is None else _record(b"STRM", "\0", 1, _places(position_deg))),
    )


def _places(position_deg: tuple[float, float]) -> bytes:
    scale = np.array([10_000_000, 10_000_000, 1000, 1000, 100], ">i4")
    sample = np.rint(np.array([*position_deg, 520.0, 0.1, 0.1]) * scale).astype(">i4")
    return (
        _record(b"STNM", "c", 1, b"GPS (Lat., Long., Alt., 2D speed, 3D speed)")
        + _record(b"GPSF", "L", 4, struct.pack(">L", 3))
        + _record(b"GPSU", "U", 16, b"260301120000.000")
        + _record(b"GPSP", "S", 2, struct.pack(">H", 154))
        + _record(b"SCAL", "l", 4, scale.tobytes())
        + _record(b"GPS5", "l", 20, np.tile(sample, 10).tobytes())
    )


def _record(key: bytes, kind: str, size: int, content: bytes) -> bytes:
    head = struct.pack(">4scBH", key, kind.encode(), size, len(content) // size)
    return head + content + bytes(-len(content) % 4)
