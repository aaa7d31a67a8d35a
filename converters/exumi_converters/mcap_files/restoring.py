"""A file that exUMI wrote becomes the episode again: streams as they were, from their messages."""

import io
import json
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.frame_files import add_lossy
from exumi_converters.mcap_files.messages import BESIDE
from exumi_converters.mcap_files.own_record import OwnRecord, read_own_record
from exumi_converters.mcap_files.records import Records
from exumi_converters.mcap_files.topics import (
    ARRAYS_FOLDER,
    JSON_SCHEMAS,
    VIDEO_FOLDER,
    topic_of,
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
        self._arrays: dict[str, np.ndarray] = {}
        self._videos: dict[str, bytes] = {}

    def write(self) -> int:
        """Write the episode; return the number of samples.

        Raises
        ------
        SourceError
            The file is damaged so that no stream can be read, or a message is not as it says.
        """
        self._describe()
        records = Records(self._path)
        channels: dict[int, Any] = {}
        from mcap.records import Attachment, Channel, Message

        for record in records.read():
            if isinstance(record, Channel):
                channels[record.id] = record
                self._open_stream(record)
            elif isinstance(record, Message):
                self._take(channels[record.channel_id].topic, record)
            elif isinstance(record, Attachment):
                self._keep(record)
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
            is_json=channel.message_encoding == "json",
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
        own = topic.removesuffix("/sample")
        pending = self._streams.get(own)
        if pending is None:
            return
        if topic == own:
            pending.time.append(message.log_time - self._record.base_ns)
            if pending.is_json:
                value = self._parsed(message.data)
                pending.values.append(value)
                pending.beside.append(value)
            else:
                pending.values.append(pending.decode(message.data))
                if not pending.has_beside:
                    pending.beside.append({})
            pending.size += len(message.data)
        else:
            pending.beside.append(self._parsed(message.data))
        full = len(pending.time) >= _BATCH or pending.size >= _BATCH_BYTES
        if full and len(pending.beside) == len(pending.time):
            self._flush(pending)

    def _parsed(self, data: bytes) -> dict[str, Any]:
        try:
            value = json.loads(data)
        except ValueError:
            value = None
        if not isinstance(value, dict):
            raise SourceError("a message is no JSON object", where=self._path)
        return value

    def _flush(self, pending: _Pending) -> None:
        # Of a file that was cut, the last sample may lack what stands beside it.
        count = min(len(pending.time), len(pending.beside))
        if count == 0:
            return
        beside = _columns(pending, count, self._path)
        values: Any = pending.values[:count]
        if pending.is_json:
            key = "width_m" if pending.writer.model.kind == "width" else "values"
            values = _array([value.get(key) for value in values], pending, "data", self._path)
        elif pending.writer.model.kind == "pose":
            values = np.array(values, np.float64)
        elif isinstance(values[0], np.ndarray) and pending.writer.model.kind != "audio":
            values = np.stack(values)
        pending.writer.append(np.array(pending.time[:count], np.int64), values, **beside)  # type: ignore[attr-defined]  # all but videos'
        pending.count += count
        for waiting in (pending.time, pending.values, pending.beside):
            del waiting[:count]
        pending.size = 0

    def _keep(self, attachment: Any) -> None:
        if attachment.name.startswith(ARRAYS_FOLDER):
            path = attachment.name.removeprefix(ARRAYS_FOLDER).removesuffix(".npy")
            try:
                array = np.load(io.BytesIO(attachment.data), allow_pickle=False)
            except (ValueError, OSError, EOFError) as error:
                raise SourceError(
                    f"the attachment {attachment.name} is no plain array ({error})",
                    where=self._path,
                ) from None
            self._arrays[path] = array
        elif attachment.name.startswith(VIDEO_FOLDER):
            self._videos[attachment.name.removeprefix(VIDEO_FOLDER)] = attachment.data

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
            parts = [self._videos.get(f"{name}/{i:06d}") for i in range(len(images.files))]
            arrays = {
                key: self._arrays.get(f"streams/{name}/{key}")
                for key in ("pts", "keyframe", "file", "time", *BESIDE)
            }
            needed = [arrays[key] for key in ("pts", "keyframe", "file", "time")]
            if any(part is None for part in (*parts, *needed)):
                raise SourceError(f"video of stream {name!r} is missing", where=self._path)
            fields = _fields(model)
            fields["images"] = {**fields["images"], "files": []}
            stream = self._writer.add_stream(name, kind=model.kind, clock=model.clock, **fields)
            _append_videos(stream, images.files, parts, arrays, given=bool(model.clock.raw_time))
            self._streams[topic_of(name)] = _Pending(
                stream, None, is_json=False, has_beside=False, dtypes={}, count=stream.count
            )

    def _add_arrays(self) -> None:
        for pending in self._streams.values():
            name = pending.writer.name
            reference = self._arrays.get(f"streams/{name}/reference")
            if reference is not None:
                said = dump(self._record.metadata.streams[name]).get("reference") or {}
                pending.writer.set_reference(reference, **{"method": "captured", **said})
            valid = self._arrays.get(f"streams/{name}/valid")
            if valid is not None:
                pending.writer.set_valid(valid)  # type: ignore[attr-defined]  # of taxels
        self._add_calibration()
        self._add_derived()

    def _add_calibration(self) -> None:
        calibration = self._writer.metadata.calibration
        for name, item in list(calibration.items()):
            if item.array is None:
                continue
            array = self._arrays.get(f"calibration/{name}")
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
            array = self._arrays.get(f"derived/{key}")
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
        return _raw_image if _is_array(images) else _jpeg_bytes
    return {"pose": _transform, "audio": _sound}.get(kind)


def _is_array(images: Any) -> bool:
    return isinstance(images, dict) and images["encoding"] == "array"


def _jpeg_bytes(data: bytes) -> bytes:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage

    return bytes(CompressedImage.FromString(data).data)


def _raw_image(data: bytes) -> np.ndarray:
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    image = RawImage.FromString(data)
    return np.frombuffer(image.data, np.uint8).reshape(image.height, image.width, -1)


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


def _append_videos(
    stream: Any, files: Any, parts: list[Any], arrays: dict[str, Any], *, given: bool
) -> None:
    first = 0
    for index, (file, part) in enumerate(zip(files, parts, strict=True)):
        rows = arrays["file"] == index
        extra = {k: arrays[k][rows] for k in BESIDE if arrays[k] is not None and k != "raw"}
        if given:
            extra["time"] = arrays["time"][rows]
        keyframe = arrays["keyframe"][rows].astype(np.int64) - first
        stream.append_file(part, file, pts=arrays["pts"][rows], keyframe=keyframe, **extra)
        first += int(rows.sum())
