"""Image streams of video files."""

import math
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.model.images import VideoFile, VideoImages
from exumi_data.model.streams import RgbStream, StreamModel, TactileStream
from exumi_data.store.stream_writer.base import BESIDE, whole_numbers
from exumi_data.store.stream_writer.pieces import ByteStreamWriter
from exumi_data.time import NS_PER_S, apply_clock

__all__ = ["VideoStreamWriter"]

_COPY_PIECE = 4 << 20


class VideoStreamWriter(ByteStreamWriter):
    """An image stream stored as ``video``: container files verbatim."""

    def __init__(self, folder: Path, name: str, model: RgbStream | TactileStream) -> None:
        super().__init__(folder, name, model)
        self._files: list[VideoFile] = []

    def append_file(
        self,
        source: Path | bytes,
        file: VideoFile,
        *,
        pts: np.ndarray,
        keyframe: np.ndarray,
        time: Any = None,
        **beside: Any,
    ) -> None:
        """Append one container file and the times of its frames.

        `time` is what the pts and the stream's clock give. A clock that names a `raw_time` has no
        part in the pts: then `time` is given, with the array that it was computed from.

        Parameters
        ----------
        source : pathlib.Path or bytes
            The file: copied as it is.
        file : VideoFile
            What is known of it.
        pts : (n,) int64
            Presentation time of each frame, ascending, in units of the file's time base.
        keyframe : (n,) int
            For each frame, the index *within this file* of the frame to start decoding from.
        time : (n,) int64, optional
            Nanoseconds since the episode's start, where the clock names a `raw_time`.
        **beside
            `time_host`, `time_device`, `sequence`, `flags`, each (n,): see the standard, section
            Time.

        Raises
        ------
        UsageError
            Times do not increase, the arrays differ in length, a keyframe is not at or before its
            frame, the file has another size, or `time` is given without a `raw_time` or missing
            beside one. Nothing was appended, unless the file changed while it was read: then the
            stream cannot be finished.
        """
        pts = whole_numbers(pts, np.int64, "pts", self.name)
        keyframe = whole_numbers(keyframe, np.int64, "keyframe", self.name)
        if len(pts) != len(keyframe):
            raise UsageError(f"{len(pts)} pts, {len(keyframe)} keyframes", where=self.name)
        if (keyframe < 0).any() or (keyframe > np.arange(len(keyframe))).any():
            raise UsageError("a keyframe is not at or before its frame", where=self.name)
        if unknown := set(beside) - set(BESIDE):
            raise UsageError(
                f"no array {min(unknown)} comes with a video's frames", where=self.name
            )
        if (time is None) != (self.model.clock.raw_time is None):
            raise UsageError(
                "times are given where the clock names a raw_time, and only there",
                where=self.name,
                fix="Without a raw_time they follow from pts, start_ns and the clock.",
            )
        size = len(source) if isinstance(source, bytes) else source.stat().st_size
        if size != file.bytes:
            raise UsageError(
                f"{file.name} has {size} bytes, its metadata says {file.bytes}", where=self.name
            )
        times = self._times_of(pts, file) if time is None else time
        columns = self._checked(times, beside, count=len(pts), what="pts")
        columns["file"] = np.full(len(pts), len(self._files), np.uint32)
        columns["pts"] = pts
        columns["keyframe"] = (keyframe + self.count).astype(np.uint64)
        with self._appending(columns):
            end = self._data.rows + file.bytes
            self._copy(source)
            if self._data.rows != end:
                raise UsageError(f"{file.name} changed while it was read", where=self.name)
            self._end_piece()
        self._files.append(file)

    def _times_of(self, pts: np.ndarray, file: VideoFile) -> Any:
        """Return the times that pts and clock give: exact, and rounded as the standard says."""
        scale = Fraction(file.time_base) * NS_PER_S
        half = Fraction(1, 2)
        raw = [file.start_ns + math.floor(instant * scale + half) for instant in pts.tolist()]
        clock = self.model.clock
        if clock.is_identity or not raw:
            return raw
        try:
            return apply_clock(
                np.array(raw, dtype=np.int64),
                t_ref=clock.t_ref_ns,
                drift_ppm=clock.drift_ppm,
                offset_ns=clock.offset_ns,
                latency_ns=clock.latency_ns,
            )
        except (ValueError, OverflowError) as error:
            raise UsageError(str(error), where=self.name) from None

    def _copy(self, source: Path | bytes) -> None:
        if isinstance(source, bytes):
            self._data.append_bytes(source)
            return
        with source.open("rb") as reader:
            while piece := reader.read(_COPY_PIECE):
                self._data.append_bytes(piece)

    def finish(self) -> StreamModel:
        """Write what is pending; return the stream's final metadata."""
        if not self._files:
            raise UsageError("a video stream needs at least one file", where=self.name)
        images: VideoImages = self.model.images  # type: ignore[attr-defined]  # the factory saw to it
        images.files = self._files
        return super().finish()

    def _complete(self) -> None:
        super()._complete()
        for name, dtype in (("file", np.uint32), ("pts", np.int64), ("keyframe", np.uint64)):
            self._array(name, dtype)
