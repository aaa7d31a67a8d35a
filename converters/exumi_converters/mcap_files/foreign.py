"""A file that somebody else wrote: images, poses and sound by Foxglove's schemas."""

import math
import re
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exumi_converters.mcap_files.records import Records
from exumi_converters.picture_files import check_size, decode_picture
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.errors import DamagedDataError, ExumiError, SourceError
from exumi_data.model import ArrayImages, Clock, EncodedImages, Frames, QualityNote
from exumi_data.standard import flags as standard_flags
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey
from exumi_data.time import format_rate, format_utc, parse_rate

__all__ = ["ForeignFile"]

_IMAGES = ("foxglove.CompressedImage", "foxglove.RawImage")
_POSES = ("foxglove.FrameTransform", "foxglove.PoseInFrame")
_SOUND = "foxglove.RawAudio"
_YEAR_2000_NS = 946_684_800_000_000_000
_DAY_NS = 86_400_000_000_000
_LAST_NS = 2**63
_MOST_STREAMS = 64
_MOST_REASONS = 3
_LONGEST_NAME = 56  # leaves room for a number


_FramePair = tuple[str, str]


@dataclass(slots=True)
class _Channel:
    """A channel that is read."""

    topic: str
    schema: str
    seen: int = 0


@dataclass(slots=True)
class _Topic:
    """What becomes a stream: a topic, or the transforms of one frame in it."""

    name: str
    schema: str
    kind: str
    shift_ns: int = 0
    stream: Any = None
    last_ns: int | None = None
    shifted: bool = False
    count: int = 0
    analysis: TactileAnalysis = field(default_factory=TactileAnalysis)
    taken: set[int] = field(default_factory=set)  # which messages of a tactile topic


@dataclass(slots=True)
class _Dropped:
    """Messages that were left out."""

    count: int = 0
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
        self._channels: dict[int, _Channel] = {}
        self._topics: dict[tuple[int, _FramePair | None], _Topic] = {}
        self._unread: dict[str, str] = {}
        self._dropped: dict[str, _Dropped] = {}
        self._start_ns: int | None = None
        self._start_log_ns = 0

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
        channels = self._channels
        for record in records.read():
            if isinstance(record, Schema):
                schemas[record.id] = record.name
            elif isinstance(record, Channel):
                self._open(record, schemas.get(record.schema_id, ""))
            elif isinstance(record, Message) and record.channel_id in channels:
                self._take(channels[record.channel_id], record)
        self._note(records.damage)
        for (channel, _), topic in self._topics.items():
            if topic.kind == "tactile" and topic.count:
                reader = _TopicReader(self._path, channel, topic)
                topic.analysis.finish(self._writer, topic.stream, reader)
        count = sum(topic.count for topic in self._topics.values())
        if count == 0:
            why = dict(self._unread)
            why |= {name: min(dropped.reasons) for name, dropped in self._dropped.items()}
            unread = ", ".join(f"{topic} ({reason})" for topic, reason in sorted(why.items()))
            raise SourceError(
                f"no message of it can be read: {records.damage or unread or 'it is empty'}",
                where=self._path,
            )
        return count

    def _open(self, channel: Any, schema: str) -> None:
        if channel.id in self._channels or channel.topic in self._unread:
            return
        known = schema in (*_IMAGES, *_POSES, _SOUND)
        if channel.message_encoding != "protobuf" or not known:
            self._unread[channel.topic] = f"{schema or 'no schema'}, {channel.message_encoding}"
            return
        self._channels[channel.id] = _Channel(channel.topic, schema)

    def _topic_of(self, record: Any, message: Any) -> _Topic:
        """Return the topic of a message; of transforms, each pair of frames is one."""
        channel = self._channels[record.channel_id]
        frames = _frames_of(message) if channel.schema in _POSES else None
        key = (record.channel_id, frames)
        if key not in self._topics:
            if len(self._topics) >= _MOST_STREAMS:
                msg = f"more than {_MOST_STREAMS} topics and frames"
                raise ValueError(msg)
            kind = "pose" if frames else "audio" if channel.schema == _SOUND else "rgb"
            if kind == "rgb" and channel.topic in self._tactile:
                kind = "tactile"
            second = any(number == record.channel_id for number, _ in self._topics)
            wanted = f"{channel.topic}_{frames[1]}" if frames and second else channel.topic
            self._topics[key] = _Topic(self._name(wanted), channel.schema, kind)
        return self._topics[key]

    def _name(self, topic: str) -> str:
        """Make a stream's name of a topic's."""
        name = re.sub(r"[^a-z0-9]+", "_", topic.lower()).strip("_")
        name = (name if name[:1].isalpha() else f"topic_{name}")[:_LONGEST_NAME].rstrip("_")
        taken = {known.name for known in self._topics.values()}
        number, free = 2, name
        while free in taken:
            free, number = f"{name}_{number}", number + 1
        return free

    def _take(self, channel: _Channel, record: Any) -> None:
        topic: _Topic | None = None
        try:
            message = _parsed(channel.schema, record.data)
            topic = self._topic_of(record, message)
            value = _VALUES[channel.schema](message)
            at = self._time_of(topic, message, record)
            if topic.stream is None:
                topic.stream = self._add_stream(topic, value, message)
            _check_fits(topic.stream, value, message)
            if topic.kind == "tactile":
                topic.analysis.add(_grey(value))
                topic.taken.add(channel.seen)
            self._append(topic, at, value)
        except (ValueError, DamagedDataError) as error:
            reason = error.what if isinstance(error, ExumiError) else str(error).split("\n")[0]
            self._drop(topic, channel, reason)
        channel.seen += 1

    def _drop(self, topic: _Topic | None, channel: _Channel, reason: str) -> None:
        name = channel.topic if topic is None else topic.name
        dropped = self._dropped.setdefault(name, _Dropped())
        dropped.count += 1
        if len(dropped.reasons) < _MOST_REASONS:
            dropped.reasons.add(reason)

    def _time_of(self, topic: _Topic, message: Any, record: Any) -> int:
        """Return when a message was made, since the first of the file.

        Stamps of another clock than the first one's, such as one that counts from when a device
        was switched on, are shifted: the first of them is put where it was logged.
        """
        stamp = _stamp_of(message) or record.log_time
        if stamp >= _LAST_NS:
            msg = "a time that no clock shows"
            raise ValueError(msg)
        if self._start_ns is None:
            self._start_ns, self._start_log_ns = stamp, record.log_time
            if stamp > _YEAR_2000_NS:
                self._writer.metadata.start = format_utc(stamp)
        at: int = stamp - self._start_ns
        if topic.last_ns is None and abs(at) > _DAY_NS:
            topic.shift_ns = record.log_time - self._start_log_ns - at
            topic.shifted = True
        at += topic.shift_ns
        if abs(at) > _DAY_NS:
            msg = "a time more than a day from the first"
            raise ValueError(msg)
        if topic.last_ns is not None and at < topic.last_ns:
            msg = "a time before that of the one before"
            raise ValueError(msg)
        return at

    def _append(self, topic: _Topic, at: int, value: Any) -> None:
        flags = 0
        if at == topic.last_ns:
            at, flags = at + 1, standard_flags()["time_nudged"].mask
        topic.last_ns = at
        topic.count += 1
        topic.stream.append(at, value, flags=flags)

    def _add_stream(self, topic: _Topic, value: Any, message: Any) -> Any:
        fields: dict[str, Any] = {}
        if topic.kind in {"rgb", "tactile"}:
            fields["images"] = _images_of(value)
        elif topic.kind == "pose":
            parent, child = _frames_of(message)
            fields["frames"] = Frames(parent=parent, child=child)
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
        for name, dropped in self._dropped.items():
            reasons = "; ".join(sorted(dropped.reasons))
            message = f"{dropped.count} messages of {name} were left out: {reasons}"
            notes.append(QualityNote(code="dropped", message=message))
        for topic in self._topics.values():
            if topic.shifted and topic.count:
                message = (
                    f"stamps of {topic.name} are more than a day from those of the first message: "
                    "they were shifted so that its first stands where it was logged"
                )
                notes.append(QualityNote(code="other-clock", message=message, stream=topic.name))
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
    """Return a JPEG as it is; PNG and WebP become pixels."""
    data = bytes(message.data)
    if jpeg.is_jpeg(data):
        height, width, _ = jpeg.size_of(data)
        check_size(height, width)
        return data
    return decode_picture(data)


_CHANNELS = {"rgb8": 3, "bgr8": 3, "mono8": 1, "8UC1": 1, "8UC3": 3}


def _raw(message: Any) -> np.ndarray:
    channels = _CHANNELS.get(message.encoding)
    if channels is None:
        msg = f"raw images of the encoding {message.encoding!r}"
        raise ValueError(msg)
    check_size(message.height, message.width)
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
    if not (np.isfinite(values).all() and 0.5 < norm < math.inf):  # less is no rotation at all
        msg = "a pose holds no rotation, or no finite numbers"
        raise ValueError(msg)
    values[3:] /= norm
    return values


def _audio(message: Any) -> np.ndarray:
    if message.format != "pcm-s16" or message.number_of_channels < 1 or message.sample_rate < 1:
        msg = f"sound of the format {message.format!r}, or without rate or channels"
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


def _check_fits(stream: Any, value: Any, message: Any) -> None:
    """Check that a value is like those before it.

    Raises
    ------
    ValueError
        It is not.
    """
    model = stream.model
    if model.kind == "audio":
        like = (Fraction(message.sample_rate), value.shape[1]) == (
            parse_rate(model.rate),
            model.channels,
        )
    elif model.kind == "pose":
        return
    else:
        images = model.images
        size = (images.height, images.width, images.channels)
        found = jpeg.size_of(value) if isinstance(value, bytes) else value.shape
        kind = "encoded" if isinstance(value, bytes) else "array"
        like = (images.encoding, size) == (kind, found)
    if not like:
        msg = "another size, rate or encoding than the first"
        raise ValueError(msg)


def _stamp_of(message: Any) -> int:
    """Return a message's own time; 0: it has none, or one that cannot be."""
    try:
        stamp: int = message.timestamp.ToNanoseconds()
    except ValueError:
        return 0
    return stamp if 0 <= stamp < _LAST_NS else 0


def _frames_of(message: Any) -> _FramePair:
    """Return parent and child of a transform or pose."""
    parent = getattr(message, "parent_frame_id", "") or getattr(message, "frame_id", "")
    child = getattr(message, "child_frame_id", "")
    return parent or "unknown", child or "unknown"
