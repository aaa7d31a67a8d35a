"""A file that exUMI wrote becomes the episode again: streams as they were, from their messages."""

import json
import tempfile
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.mcap_files.arrays import read_array
from exumi_converters.mcap_files.messages import BESIDE
from exumi_converters.mcap_files.own_record import OwnRecord, read_own_record
from exumi_converters.mcap_files.records import AttachedFile, Records
from exumi_converters.mcap_files.topics import (
    ARRAYS_FOLDER,
    JSON_SCHEMAS,
    topic_of,
    video_piece,
)
from exumi_data.errors import SourceError
from exumi_data.model import EncodedImages, LossyStep, QualityNote
from exumi_data.model.documents import dump
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import StreamWriter

__all__ = ["RestoredFile"]

_BATCH = 512
_BATCH_BYTES = 8 * 1024**2
_KINDS = ("rgb", "tactile", "pose", "audio", *JSON_SCHEMAS)
_OF_EPISODE = ("start", "success", "operator", "site", "device", "embodiment", "calibration")


@dataclass(slots=True)
class _Pending:
    """Samples of one stream that wait to be written."""

    writer: StreamWriter
    decode: Any
    is_json: bool
    has_beside: bool
    dtypes: dict[str, np.dtype[Any]]
    time: list[int] = field(default_factory=list)
    values: list[Any] = field(default_factory=list)
    beside: list[dict[str, Any]] = field(default_factory=list)
    size: int = 0
    count: int = 0


class RestoredFile:
    """One file of ours that is being read.

    Parameters
    ----------
    path : pathlib.Path
    writer : EpisodeWriter
    """

    def __init__(self, path: Path, writer: EpisodeWriter) -> None:
        record = read_own_record(path)
        if record is None:
            raise SourceError("changed while it was read", where=path)
        self._path = path
        self._writer = writer
        self._record: OwnRecord = record
        self._streams: dict[str, _Pending] = {}
        self._attached: dict[str, AttachedFile] = {}

    def write(self) -> int:
        """Write the episode; return the number of samples.

        Raises
        ------
        SourceError
            The file is damaged so that no stream can be read, or a message is not as it says.
        """
        self._describe()
        records = Records(self._path)
        topics: dict[int, str] = {}
        from mcap.records import Channel, Message

        for record in records.read():
            if isinstance(record, Channel):
                topics[record.id] = record.topic
                self._open_stream(record)
            elif isinstance(record, Message):
                self._take(topics.get(record.channel_id, ""), record)
            elif isinstance(record, AttachedFile):
                self._attached[record.name] = record
        for pending in self._streams.values():
            self._flush(pending)
        if records.damage is not None:
            self._note_damage(records.damage)
        self._add_videos()
        self._add_arrays()
        return sum(pending.count for pending in self._streams.values())

    def _describe(self) -> None:
        """Take over what the episode said of itself."""
        before, after = self._record.metadata, self._writer.metadata
        for name in _OF_EPISODE:
            setattr(after, name, getattr(before, name))
        after.quality = [*before.quality, *after.quality]
        for key, value in (before.model_extra or {}).items():
            setattr(after, key, value)
        if before.source.lossy:
            after.source.lossy = [*before.source.lossy, *(after.source.lossy or [])]

    def _open_stream(self, channel: Any) -> None:
        name = channel.metadata.get("exumi.stream", "")
        model = self._record.metadata.streams.get(name)
        if model is None or model.kind not in _KINDS or channel.topic != topic_of(name):
            return
        if channel.topic in self._streams:  # files repeat their channels at the end
            return
        fields = _fields(model)
        images = fields.get("images")
        if images is not None and images["encoding"] == "video":
            fields["images"] = self._as_jpeg(name, images)
        stream = self._writer.add_stream(name, kind=model.kind, clock=model.clock, **fields)
        self._streams[channel.topic] = _Pending(
            writer=stream,
            decode=_decoder(model.kind, fields.get("images")),
            is_json=model.kind in JSON_SCHEMAS,
            has_beside=bool(set(BESIDE) & set(model.arrays)),
            dtypes={
                key.removeprefix("exumi.dtype."): _dtype(text, self._path)
                for key, text in channel.metadata.items()
                if key.startswith("exumi.dtype.")
            },
        )

    def _as_jpeg(self, name: str, images: dict[str, Any]) -> EncodedImages:
        add_lossy(
            self._writer,
            LossyStep(
                step="jpeg-encode",
                stream=name,
                detail="the video's frames were decoded and encoded as JPEG, quality 95, when the "
                "MCAP file was written",
                by="exumi-data",
            ),
        )
        return EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=images["height"],
            width=images["width"],
            channels=images["channels"],
        )

    def _take(self, topic: str, message: Any) -> None:
        at = message.log_time - self._record.base_ns
        pending = self._streams.get(topic)
        if pending is None:
            pending = self._streams.get(topic.removesuffix("/sample"))
            if pending is not None:
                self._take_beside(pending, at, topic, message.data)
            return
        pending.time.append(at)
        pending.size += len(message.data)
        if pending.is_json:
            value = self._parsed(message.data, topic)
            pending.values.append(value)
            pending.beside.append(value)
        else:
            pending.values.append(self._decoded(pending, message.data, topic))
            if not pending.has_beside:
                pending.beside.append({})
        self._flush_if_full(pending, topic)

    def _take_beside(self, pending: _Pending, at: int, topic: str, data: bytes) -> None:
        """Take what stands beside a sample: it comes next after it, and has its time."""
        place = len(pending.beside)
        if place >= len(pending.time) or pending.time[place] != at:
            raise SourceError(f"a message of {topic} belongs to no sample", where=self._path)
        pending.beside.append(self._parsed(data, topic))
        self._flush_if_full(pending, topic)

    def _flush_if_full(self, pending: _Pending, topic: str) -> None:
        lacking = len(pending.time) - len(pending.beside)
        if lacking > 1:
            raise SourceError(f"{topic}/sample lacks what stands beside a sample", where=self._path)
        full = len(pending.time) >= _BATCH or pending.size >= _BATCH_BYTES
        if full and not lacking:
            self._flush(pending)

    def _parsed(self, data: bytes, topic: str) -> dict[str, Any]:
        try:
            value = json.loads(data)
        except (ValueError, RecursionError):
            value = None
        if not isinstance(value, dict):
            raise SourceError(f"a message of {topic} is no JSON object", where=self._path)
        return value

    def _decoded(self, pending: _Pending, data: bytes, topic: str) -> Any:
        from google.protobuf.message import DecodeError

        try:
            return pending.decode(data)
        except (DecodeError, ValueError, OverflowError) as error:
            raise SourceError(
                f"a message of {topic} is not what its schema says ({error})", where=self._path
            ) from None

    def _flush(self, pending: _Pending) -> None:
        # Of a file that was cut, the last sample may lack what stands beside it.
        count = min(len(pending.time), len(pending.beside))
        if count == 0:
            return
        beside = _columns(pending, count, self._path)
        values: Any = pending.values[:count]
        if pending.is_json:
            key = "width_m" if pending.writer.model.kind == "width" else "values"
            if any(key not in value for value in values):
                name = pending.writer.name
                raise SourceError(f"a message of {name!r} holds no {key}", where=self._path)
            values = _array([value[key] for value in values], pending, "data", self._path)
        elif pending.writer.model.kind == "pose":
            values = np.array(values, np.float64)
        elif isinstance(values[0], np.ndarray) and pending.writer.model.kind != "audio":
            values = np.stack(values)
        time = _numbers(pending.time[:count], np.dtype(np.int64), self._path)
        pending.writer.append(time, values, **beside)  # type: ignore[attr-defined]  # all but videos'
        pending.count += count
        for waiting in (pending.time, pending.values, pending.beside):
            del waiting[:count]
        pending.size = 0

    def _array(self, path: str) -> np.ndarray | None:
        """Return an array that is attached; None: it is not."""
        attached = self._attached.get(f"{ARRAYS_FOLDER}{path}.npy")
        return None if attached is None else read_array(attached)

    def _note_damage(self, damage: str) -> None:
        if not any(pending.count for pending in self._streams.values()):
            raise SourceError(f"is damaged before the first sample ({damage})", where=self._path)
        self._writer.metadata.quality.append(
            QualityNote(
                code="truncated",
                message=f"the file ends early or is damaged ({damage}); what came before was kept",
            )
        )

    def _add_videos(self) -> None:
        if self._record.video != "attach":
            return
        for name, model in self._record.metadata.streams.items():
            images = getattr(model, "images", None)
            if images is None or images.encoding != "video":
                continue
            arrays = {
                key: self._array(f"streams/{name}/{key}")
                for key in ("pts", "keyframe", "file", "time", *BESIDE)
            }
            needed = [arrays[key] for key in ("pts", "keyframe", "file", "time")]
            if any(array is None for array in needed) or len({len(a) for a in needed}) > 1:  # type: ignore[arg-type]  # none of them is None here
                raise SourceError(f"times of the video {name!r} are missing", where=self._path)
            fields = _fields(model)
            fields["images"] = {**fields["images"], "files": []}
            stream = self._writer.add_stream(name, kind=model.kind, clock=model.clock, **fields)
            self._append_videos(stream, images.files, arrays, given=bool(model.clock.raw_time))
            self._streams[topic_of(name)] = _Pending(
                stream, None, is_json=False, has_beside=False, dtypes={}, count=stream.count
            )

    def _append_videos(
        self, stream: Any, files: Any, arrays: dict[str, Any], *, given: bool
    ) -> None:
        first = 0
        for index, file in enumerate(files):
            rows = arrays["file"] == index
            extra = {k: arrays[k][rows] for k in BESIDE if arrays[k] is not None and k != "raw"}
            if given:
                extra["time"] = arrays["time"][rows]
            keyframe = arrays["keyframe"][rows].astype(np.int64) - first
            with tempfile.TemporaryDirectory() as folder:
                path = self._whole_video(stream.name, index, Path(folder, "video"))
                stream.append_file(path, file, pts=arrays["pts"][rows], keyframe=keyframe, **extra)
            first += int(rows.sum())

    def _whole_video(self, stream: str, index: int, path: Path) -> Path:
        """Write a video file that is attached, in one piece or several, and return its path."""
        pieces = self._video_pieces(stream, index)
        if not pieces:
            raise SourceError(f"video {index} of stream {stream!r} is missing", where=self._path)
        with path.open("wb") as file:
            for piece in pieces:
                file.writelines(piece.pieces())
        return path

    def _video_pieces(self, stream: str, index: int) -> list[AttachedFile]:
        whole = self._attached.get(video_piece(stream, index, None))
        if whole is not None:
            return [whole]
        found: list[AttachedFile] = []
        while (piece := self._attached.get(video_piece(stream, index, len(found)))) is not None:
            found.append(piece)
        return found

    def _add_arrays(self) -> None:
        for pending in self._streams.values():
            name = pending.writer.name
            reference = self._array(f"streams/{name}/reference")
            if reference is not None:
                said = dump(self._record.metadata.streams[name]).get("reference") or {}
                pending.writer.set_reference(reference, **{"method": "captured", **said})
            valid = self._array(f"streams/{name}/valid")
            if valid is not None:
                pending.writer.set_valid(valid)  # type: ignore[attr-defined]  # of taxels
        self._add_calibration()
        self._add_derived()

    def _add_calibration(self) -> None:
        calibration = self._writer.metadata.calibration
        for name, item in list(calibration.items()):
            if item.array is None:
                continue
            array = self._array(f"calibration/{name}")
            if array is None:
                del calibration[name]
                self._lost(f"the array of the calibration item {name!r}")
            else:
                self._writer.add_calibration_array(item.array, array)

    def _add_derived(self) -> None:
        derived = self._record.derived
        written = {pending.writer.name: pending.count for pending in self._streams.values()}
        for key, item in derived.items.items() if derived else ():
            stream, _, name = key.partition("/")
            array = self._array(f"derived/{key}")
            if array is None or not written.get(stream):
                continue
            said = item.model_dump(exclude_unset=True)
            self._writer.add_derived(stream, name, array, **said)

    def _lost(self, what: str) -> None:
        self._writer.metadata.quality.append(
            QualityNote(code="missing", message=f"{what} is not in the file")
        )


def _fields(model: Any) -> dict[str, Any]:
    """Return a stream's fields without those that the writer fills."""
    document = dump(model)
    return {
        key: value
        for key, value in document.items()
        if key not in {"kind", "clock", "arrays", "reference"}
    }


def _decoder(kind: str, images: Any) -> Any:
    """Return what makes a value of a message's bytes."""
    if kind in {"rgb", "tactile"}:
        return partial(_raw_image, images=images) if _is_array(images) else _jpeg_bytes
    return {"pose": _transform, "audio": _sound}.get(kind)


def _is_array(images: Any) -> bool:
    return isinstance(images, dict) and images["encoding"] == "array"


def _jpeg_bytes(data: bytes) -> bytes:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    return bytes(CompressedImage.FromString(data).data)


def _raw_image(data: bytes, images: dict[str, Any]) -> np.ndarray:
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    shape = (images["height"], images["width"], images["channels"])
    return np.frombuffer(RawImage.FromString(data).data, np.uint8).reshape(shape)


def _transform(data: bytes) -> tuple[float, ...]:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform

    message = FrameTransform.FromString(data)
    p, q = message.translation, message.rotation
    return (p.x, p.y, p.z, q.x, q.y, q.z, q.w)


def _sound(data: bytes) -> np.ndarray:
    from foxglove_schemas_protobuf.RawAudio_pb2 import RawAudio

    message = RawAudio.FromString(data)
    samples = np.frombuffer(message.data, "<i2")
    return samples.reshape(-1, message.number_of_channels)


def _dtype(text: str, path: Path) -> np.dtype[Any]:
    try:
        found = np.dtype(text)
    except TypeError:
        found = np.dtype(object)
    if found.kind not in "iuf":
        raise SourceError(f"{text!r} is no type of numbers", where=path)
    return found


def _columns(pending: _Pending, count: int, path: Path) -> dict[str, np.ndarray]:
    """Return the arrays beside the data that these samples have."""
    rows = pending.beside[:count]
    kinds = {"time_host": np.int64, "time_device": np.int64, "sequence": np.uint64}
    found: dict[str, np.ndarray] = {}
    for name in BESIDE:
        values = [row.get(name) for row in rows]
        if all(value is None for value in values):
            continue
        if name == "raw":
            found[name] = _array(values, pending, name, path)
        else:
            found[name] = _numbers(values, np.dtype(kinds.get(name, np.uint32)), path)
    return found


def _array(values: list[Any], pending: _Pending, name: str, path: Path) -> np.ndarray:
    return _numbers(values, pending.dtypes.get(name, np.dtype(np.float64)), path)


def _numbers(values: list[Any], dtype: np.dtype[Any], path: Path) -> np.ndarray:
    try:
        # None becomes nan where numbers may be none.
        return np.array(values, dtype=np.float64 if dtype.kind == "f" else dtype).astype(dtype)
    except (TypeError, ValueError, OverflowError) as error:
        raise SourceError(f"a message holds no {dtype} ({error})", where=path) from None
