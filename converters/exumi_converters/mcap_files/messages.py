"""The messages of one stream, in the order of its samples: each a time, a topic and bytes."""

import json
import math
from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np

from exumi_converters.mcap_files.topics import SAMPLE_SCHEMA, topic_of
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import SourceError
from exumi_data.store import jpeg

__all__ = ["BESIDE", "Message", "messages_of", "schemas_of"]

BESIDE = ("raw", "time_host", "time_device", "sequence", "flags")
"""Arrays of one value a sample that stand beside a stream's data."""
_BLOCK = 256
_NS = 1_000_000_000
_QUALITY = 95


class Message(NamedTuple):
    """One message; they sort by time, then by topic."""

    time_ns: int
    topic: str
    data: bytes


def schemas_of(stream: StreamView, *, video_as_jpeg: bool) -> dict[str, str]:
    """Return topic to schema of what `messages_of` yields.

    Parameters
    ----------
    stream : StreamView
    video_as_jpeg : bool
    """
    topic = topic_of(stream.name)
    own = {
        "pose": "foxglove.FrameTransform",
        "audio": "foxglove.RawAudio",
        "rgb": _image_schema(stream),
        "tactile": _image_schema(stream),
    }.get(stream.kind, f"exumi.{stream.kind.capitalize()}")
    if stream.is_image and not video_as_jpeg and _encoding(stream) == "video":
        return {}
    found = {topic: own}
    if own.startswith("foxglove.") and _beside(stream):
        found[f"{topic}/sample"] = SAMPLE_SCHEMA
    return found


def _encoding(stream: StreamView) -> str:
    return str(stream.metadata.images.encoding)  # type: ignore[attr-defined]  # an image stream


def _image_schema(stream: StreamView) -> str:
    if not stream.is_image:
        return ""
    return "foxglove.RawImage" if _encoding(stream) == "array" else "foxglove.CompressedImage"


def _beside(stream: StreamView) -> list[str]:
    return [name for name in BESIDE if name in stream.metadata.arrays]


def messages_of(
    episode: Episode, stream: StreamView, base_ns: int, *, video_as_jpeg: bool
) -> Iterator[Message]:
    """Yield a stream's messages.

    Parameters
    ----------
    episode : Episode
    stream : StreamView
    base_ns : int
        What is added to the episode's times.
    video_as_jpeg : bool
        Whether frames of video files become JPEGs; else there is no message for them.

    Raises
    ------
    SourceError
        A value cannot be written (an infinite number).
    """
    topic = topic_of(stream.name)
    beside = _beside(stream)
    schemas = schemas_of(stream, video_as_jpeg=video_as_jpeg)
    if not schemas:  # its files are attached
        return
    is_json = schemas[topic].startswith("exumi.")
    samples = _samples(episode, stream)
    time_ns = stream.time
    for start in range(0, len(time_ns), _BLOCK):
        stop = min(start + _BLOCK, len(time_ns))
        extra = {name: stream.rows(name, start, stop).tolist() for name in beside}
        for index in range(start, stop):
            at = int(time_ns[index]) + base_ns
            more = {name: values[index - start] for name, values in extra.items()}
            value = next(samples)
            if is_json:
                yield Message(at, topic, _json({**value, **more}, stream))
            else:
                yield Message(at, topic, _stamped(value, at))
                if more:
                    yield Message(at, f"{topic}/sample", _json(more, stream))


def _stamped(message: Any, at: int) -> bytes:
    message.timestamp.FromNanoseconds(at)
    data: bytes = message.SerializeToString(deterministic=True)
    return data


def _json(values: dict[str, Any], stream: StreamView) -> bytes:
    try:
        return json.dumps(_finite(values), separators=(",", ":"), allow_nan=False).encode()
    except ValueError:
        raise SourceError(
            f"stream {stream.name!r} holds an infinite value, for which JSON has no word"
        ) from None


def _finite(value: Any) -> Any:
    """Return a value with null where it is no number."""
    if isinstance(value, float):
        return None if math.isnan(value) else value
    if isinstance(value, list):
        return [_finite(part) for part in value]
    if isinstance(value, dict):
        return {key: _finite(part) for key, part in value.items()}
    return value


def _samples(episode: Episode, stream: StreamView) -> Iterator[Any]:
    """Yield what one message says of each sample: a message of Foxglove's, or JSON values."""
    if stream.is_image:
        yield from _images(stream)
    elif stream.kind == "pose":
        yield from _transforms(stream)
    elif stream.kind == "audio":
        yield from _sounds(stream)
    else:
        key = "width_m" if stream.kind == "width" else "values"
        for block in _blocks(stream):
            for value in block.tolist():
                yield {key: value}


def _blocks(stream: StreamView) -> Iterator[np.ndarray]:
    for start in range(0, len(stream), _BLOCK):
        yield stream.rows("data", start, min(start + _BLOCK, len(stream)))


def _images(stream: StreamView) -> Iterator[Any]:
    from foxglove_schemas_protobuf.CompressedImage_pb2 import CompressedImage
    from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

    encoding = _encoding(stream)
    if encoding == "encoded":
        for index in range(len(stream)):
            yield CompressedImage(frame_id=stream.name, data=stream.encoded(index), format="jpeg")
        return
    for frame in stream.frames:
        if encoding == "video":
            data = jpeg.encode(frame, _QUALITY)
            yield CompressedImage(frame_id=stream.name, data=data, format="jpeg")
        else:
            height, width, channels = frame.shape
            yield RawImage(
                frame_id=stream.name,
                width=width,
                height=height,
                encoding="mono8" if channels == 1 else "rgb8",
                step=width * channels,
                data=frame.tobytes(),
            )


def _transforms(stream: StreamView) -> Iterator[Any]:
    from foxglove_schemas_protobuf.FrameTransform_pb2 import FrameTransform
    from foxglove_schemas_protobuf.Quaternion_pb2 import Quaternion
    from foxglove_schemas_protobuf.Vector3_pb2 import Vector3

    frames = stream.metadata.frames  # type: ignore[attr-defined]  # a pose stream
    for block in _blocks(stream):
        for x, y, z, qx, qy, qz, qw in block.tolist():
            yield FrameTransform(
                parent_frame_id=frames.parent,
                child_frame_id=frames.child,
                translation=Vector3(x=x, y=y, z=z),
                rotation=Quaternion(x=qx, y=qy, z=qz, w=qw),
            )


def _sounds(stream: StreamView) -> Iterator[Any]:
    from foxglove_schemas_protobuf.RawAudio_pb2 import RawAudio

    from exumi_data.time import parse_rate

    offset = stream.array("offset")
    rate = parse_rate(stream.metadata.rate)  # type: ignore[attr-defined]  # an audio stream
    for start, stop in zip(offset[:-1].tolist(), offset[1:].tolist(), strict=True):
        block = stream.samples(start, stop)
        yield RawAudio(
            data=block.astype("<i2").tobytes(),
            format="pcm-s16",
            sample_rate=round(rate),
            number_of_channels=block.shape[1],
        )
