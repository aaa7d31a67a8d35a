"""A file that somebody else wrote: images, poses and sound by Foxglove's schemas."""

import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exumi_converters.mcap_files.records import Records
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.errors import DamagedDataError, SourceError
from exumi_data.model import ArrayImages, Clock, EncodedImages, Frames, QualityNote
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey
from exumi_data.time import format_rate, format_utc

__all__ = ["ForeignFile"]

_IMAGES = ("foxglove.CompressedImage", "foxglove.RawImage")
_POSES = ("foxglove.FrameTransform", "foxglove.PoseInFrame")
_SOUND = "foxglove.RawAudio"
_YEAR_2000_NS = 946_684_800_000_000_000
_NUDGED = 1 << 0


@dataclass(slots=True)
class _Topic:
    """One topic that becomes a stream."""

    name: str
    schema: str
    kind: str
    stream: Any = None
    last_ns: int | None = None
    count: int = 0
    dropped: int = 0
    seen: int = 0
    analysis: TactileAnalysis = field(default_factory=TactileAnalysis)
    taken: set[int] = field(default_factory=set)  # which messages of a tactile topic
    reasons: set[str] = field(default_factory=set)


class ForeignFile:
    """One file that is being read.

    Parameters
    ----------
    path : pathlib.Path
    writer : EpisodeWriter
    tactile : tuple of str
        Topics whose images are of tactile sensors.
    """

    def __init__(self, path: Path, writer: EpisodeWriter, *, tactile: tuple[str, ...]) -> None:
        self._path = path
        self._writer = writer
        self._tactile = tactile
        self._topics: dict[int, _Topic] = {}
        self._unread: dict[str, str] = {}
        self._start_ns: int | None = None

    def write(self) -> int:
        """Write the streams; return the number of samples.

        Raises
        ------
        SourceError
            There is no message that can be read.
        """
        from mcap.records import Channel, Message, Schema

        schemas: dict[int, str] = {}
        records = Records(self._path)
        channels = self._topics
        for record in records.read():
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                self._open(record, schemas.get(record.schema_id, ""))
            elif isinstance(record, Message) and record.channel_id in channels:
                self._take(channels[record.channel_id], record)
        self._note(records.damage)
        for channel, topic in channels.items():
            if topic.kind == "tactile" and topic.count:
                reader = _TopicReader(self._path, channel, topic)
                topic.analysis.finish(self._writer, topic.stream, reader)
        count = sum(topic.count for topic in self._topics.values())
        if count == 0:
            unread = ", ".join(f"{topic} ({why})" for topic, why in sorted(self._unread.items()))
            raise SourceError(
                f"no message of it can be read: {records.damage or unread or 'it is empty'}",
                where=self._path,
            )
        return count

    def _open(self, channel: Any, schema: str) -> None:
        if channel.id in self._topics or channel.topic in self._unread:
            return
        known = schema in (*_IMAGES, *_POSES, _SOUND)
        if channel.message_encoding != "protobuf" or not known:
            self._unread[channel.topic] = f"{schema or 'no schema'}, {channel.message_encoding}"
            return
        kind = "pose" if schema in _POSES else "audio" if schema == _SOUND else "rgb"
        if kind == "rgb" and channel.topic in self._tactile:
            kind = "tactile"
        self._topics[channel.id] = _Topic(self._name(channel.topic), schema, kind)

    def _name(self, topic: str) -> str:
        """Make a stream's name of a topic's."""
        name = re.sub(r"[^a-z0-9]+", "_", topic.lower()).strip("_")
        name = name if name[:1].isalpha() else f"topic_{name}".rstrip("_")
        taken = {known.name for known in self._topics.values()}
        number, free = 2, name
        while free in taken:
            free, number = f"{name}_{number}", number + 1
        return free

    def _take(self, topic: _Topic, record: Any) -> None:
        number, topic.seen = topic.seen, topic.seen + 1
        try:
            message = _parsed(topic.schema, record.data)
            stamp = message.timestamp.ToNanoseconds() or record.log_time
            value = _VALUES[topic.schema](message)
        except (ValueError, SourceError) as error:
            topic.dropped += 1
            topic.reasons.add(str(error))
            return
        if self._start_ns is None:
            self._start_ns = stamp if stamp > _YEAR_2000_NS else 0
            self._writer.metadata.start = format_utc(stamp) if self._start_ns else None
        if topic.stream is None:
            topic.stream = self._add_stream(topic, value, message)
        fits = topic.stream is not None and _fits(topic.stream, value)
        if not fits:
            topic.dropped += 1
            topic.reasons.add("another size or encoding than the first")
            return
        if topic.kind == "tactile":
            try:
                topic.analysis.add(_grey(value))
            except DamagedDataError as error:
                topic.dropped += 1
                topic.reasons.add(error.what)
                return
            topic.taken.add(number)
        self._append(topic, stamp - self._start_ns, value)

    def _append(self, topic: _Topic, at: int, value: Any) -> None:
        flags = 0
        if topic.last_ns is not None and at <= topic.last_ns:
            at, flags = topic.last_ns + 1, _NUDGED
        topic.last_ns = at
        topic.count += 1
        topic.stream.append(at, value, flags=flags)

    def _add_stream(self, topic: _Topic, value: Any, message: Any) -> Any:
        fields: dict[str, Any] = {}
        if topic.kind in {"rgb", "tactile"}:
            fields["images"] = _images_of(value)
        elif topic.kind == "pose":
            child = getattr(message, "child_frame_id", "") or topic.name
            parent = getattr(message, "parent_frame_id", "") or getattr(message, "frame_id", "")
            fields["frames"] = Frames(parent=parent or "unknown", child=child)
        else:
            fields["rate"] = format_rate(Fraction(message.sample_rate))
            fields["channels"] = value.shape[1]
        clock = Clock(source="mcap", stamp_point="unknown")
        return self._writer.add_stream(topic.name, kind=topic.kind, clock=clock, **fields)

    def _note(self, damage: str | None) -> None:
        notes = self._writer.metadata.quality
        if damage is not None:
            notes.append(
                QualityNote(
                    code="truncated",
                    message=f"the file ends early or is damaged ({damage}); what came before was "
                    "kept",
                )
            )
        for topic in self._topics.values():
            if topic.dropped:
                reasons = "; ".join(sorted(topic.reasons)[:3])
                notes.append(
                    QualityNote(
                        code="dropped",
                        message=f"{topic.dropped} messages of {topic.name} were left out: "
                        f"{reasons}",
                    )
                )
        if self._unread:
            named = ", ".join(f"{t} ({why})" for t, why in sorted(self._unread.items()))
            message = f"topics that were not read: {named}"
            notes.append(QualityNote(code="not-converted", message=message, severity="info"))


class _TopicReader:
    """The tactile images of one topic, again."""

    def __init__(self, path: Path, channel: int, topic: _Topic) -> None:
        self._path = path
        self._channel = channel
        self._topic = topic

    def _values(self) -> Iterator[bytes | np.ndarray]:
        from mcap.records import Message

        number = -1
        for record in Records(self._path).read():
            if isinstance(record, Message) and record.channel_id == self._channel:
                number += 1
                if number in self._topic.taken:
                    schema = self._topic.schema
                    yield _VALUES[schema](_parsed(schema, record.data))

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every image, (H, W) uint8 luma."""
        return map(_grey, self._values())

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        """Return some images, ascending, each (H, W, C) uint8."""
        wanted = set(indices)
        return [_picture(value) for i, value in enumerate(self._values()) if i in wanted]


def _picture(value: bytes | np.ndarray) -> np.ndarray:
    if not isinstance(value, bytes):
        return value
    out = np.empty(jpeg.size_of(value), np.uint8)
    jpeg.decode_into(value, out)
    return out


def _grey(value: bytes | np.ndarray) -> np.ndarray:
    if not isinstance(value, bytes):
        return to_grey(value) if value.shape[2] == 3 else value[..., 0]  # colours
    out = np.empty((*jpeg.size_of(value)[:2], 1), np.uint8)
    jpeg.decode_into(value, out)
    return out[..., 0]


def _parsed(schema: str, data: bytes) -> Any:
    from importlib import import_module

    from google.protobuf.message import DecodeError

    word = schema.removeprefix("foxglove.")
    module = import_module(f"foxglove_schemas_protobuf.{word}_pb2")
    try:
        return getattr(module, word).FromString(data)
    except DecodeError as error:
        msg = f"a message is no {schema} ({error})"
        raise ValueError(msg) from None


def _compressed(message: Any) -> Any:
    """Return a JPEG as it is; other formats become pixels."""
    data = bytes(message.data)
    if jpeg.is_jpeg(data):
        return data
    import cv2

    image = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_COLOR_RGB) if data else None
    if image is None:
        msg = f"an image ({message.format or 'unknown format'}) cannot be decoded"
        raise ValueError(msg)
    return np.asarray(image, np.uint8)


_CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "8UC1": 1, "8UC3": 3}


def _raw(message: Any) -> np.ndarray:
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        msg = f"raw images of the encoding {message.encoding!r}"
        raise ValueError(msg)
    row = message.width * channels
    step = message.step or row
    if step < row or len(message.data) < step * message.height:
        msg = "a raw image is cut short"
        raise ValueError(msg)
    data = np.frombuffer(message.data, np.uint8)[: step * message.height]
    image = data.reshape(message.height, step)[:, :row]
    image = image.reshape(message.height, message.width, channels)
    return image[..., ::-1] if message.encoding in {"bgr8", "8UC3"} else image


def _pose(message: Any) -> np.ndarray:
    if hasattr(message, "translation"):
        p, q = message.translation, message.rotation
    else:
        p, q = message.pose.position, message.pose.orientation
    values = np.array([p.x, p.y, p.z, q.x, q.y, q.z, q.w])
    norm = float(np.linalg.norm(values[3:]))
    if not np.isfinite(values).all() or norm < 0.5:  # no rotation at all
        msg = "a pose holds no rotation, or no finite numbers"
        raise ValueError(msg)
    values[3:] /= norm
    return values


def _audio(message: Any) -> np.ndarray:
    if message.format != "pcm-s16" or message.number_of_channels < 1:
        msg = f"sound of the format {message.format!r}"
        raise ValueError(msg)
    samples = np.frombuffer(message.data, "<i2")
    return samples.reshape(-1, message.number_of_channels)


_VALUES: dict[str, Callable[[Any], Any]] = {
    "foxglove.CompressedImage": _compressed,
    "foxglove.RawImage": _raw,
    "foxglove.FrameTransform": _pose,
    "foxglove.PoseInFrame": _pose,
    "foxglove.RawAudio": _audio,
}


def _images_of(value: bytes | np.ndarray) -> EncodedImages | ArrayImages:
    if isinstance(value, bytes):
        height, width, channels = jpeg.size_of(value)
        return EncodedImages(
            encoding="encoded",
            media_type="image/jpeg",
            height=height,
            width=width,
            channels=_colours(channels),
        )
    height, width, channels = value.shape
    return ArrayImages(encoding="array", height=height, width=width, channels=_colours(channels))


def _colours(channels: int) -> Literal[1, 3]:
    return 1 if channels == 1 else 3


def _fits(stream: Any, value: Any) -> bool:
    images = getattr(stream.model, "images", None)
    if images is None:
        return True
    size = (images.height, images.width, images.channels)
    if isinstance(value, bytes):
        return bool(images.encoding == "encoded" and jpeg.size_of(value) == size)
    return bool(images.encoding == "array" and value.shape == size)
