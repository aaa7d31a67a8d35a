"""``--to mcap``: each episode a file that Foxglove opens, and that becomes an episode again."""

import heapq
import io
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np
from pydantic import Field

from exumi_converters.exporter import ExportItem, ExportOptions, ExportPlan, Loss, Part
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.mcap_files.messages import BESIDE, messages_of, schemas_of
from exumi_converters.mcap_files.topics import (
    ARRAYS_FOLDER,
    DOCUMENT_RECORD,
    JSON_SCHEMAS,
    SAMPLE_SCHEMA,
    json_schema,
    require_mcap,
    topic_of,
    video_piece,
)
from exumi_data.calibration import intrinsics_of
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import ExumiError, UsageError
from exumi_data.time import parse_utc

if TYPE_CHECKING:
    from mcap.writer import Writer

__all__ = ["McapExporter", "McapOptions"]

_CHUNK_BYTES = 4 * 1024 * 1024
_PROFILE = ""
_LIBRARY = "exumi-data"
_KINDS = ("rgb", "tactile", "pose", "audio", *JSON_SCHEMAS)
_PIECE_BYTES = 32 * 1024 * 1024  # of an attached video: the library wants each in memory
_PER_EPISODE = 12_000  # bytes of schemas and documents
_PER_SAMPLE = 60  # bytes of a message of one pose or width, compressed
_JPEG_BYTES_PER_PIXEL = 0.15


class McapOptions(FormatOptions):
    """What only this format can be told."""

    video: Literal["jpeg", "attach"] = Field(
        "jpeg",
        description="Frames of video files: jpeg (decoded and encoded again, so that they are "
        "seen) or attach (the files byte for byte, as attachments that are not shown).",
    )


class McapExporter:
    """One file an episode: messages in Foxglove's schemas, the rest as records beside them."""

    name = "mcap"
    version = "1"
    describes = "MCAP files with Foxglove's schemas, one an episode"
    keeps: tuple[str, ...] = (
        "every sample of every stream, at its own rate and time, bit for bit",
        "the episode's own document, so that the file becomes the episode again",
    )
    loses: Mapping[str, str] = {
        "identity": "the id is kept as parent_id when the file is converted back",
        "source": "converted back, it names the file; its lossy steps stay",
        "streams": "streams of extension kinds are left out",
        "frame-bytes": "video files become JPEG frames, unless -o video=attach",
        "pixels": "of video files, as they are encoded again, unless -o video=attach",
    }
    options: type[FormatOptions] = McapOptions

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Every episode is written; extension kinds are left out."""
        require_mcap()
        told = parse_options(McapOptions, options.settings, self.name)
        one_file = destination.suffix == ".mcap"
        if one_file and len(dataset) != 1:
            raise UsageError(
                f"{len(dataset)} episodes do not go into one file",
                where=destination,
                fix="Name a folder: it gets a file for each.",
            )
        losses: dict[tuple[str, str], Loss] = {}
        size = 0
        for episode in dataset:
            with episode:
                size += _PER_EPISODE
                for stream in episode.streams.values():
                    size += _estimated_bytes(stream, told)
                    for loss in _losses(stream, told):
                        losses.setdefault((loss.facet, stream.name), loss)
        return ExportPlan(
            layout="one MCAP file" if one_file else f"{len(dataset)} MCAP files, one an episode",
            items=tuple(ExportItem(id=name, index=i) for i, name in enumerate(dataset.ids)),
            writes="file" if one_file else "folder",
            shared={"video": told.video},
            losses=(
                *(Loss(facet=facet, detail=self.loses[facet]) for facet in ("identity", "source")),
                *losses.values(),
            ),
            estimated_bytes=size,
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write one file."""
        from mcap.writer import CompressionType, Writer

        with (folder / "episode.mcap").open("wb") as file:
            writer = Writer(
                file,
                chunk_size=_CHUNK_BYTES,
                compression=CompressionType.ZSTD,
                enable_data_crcs=True,
            )
            writer.start(profile=_PROFILE, library=_LIBRARY)
            count = _EpisodeFile(writer, episode, plan.shared["video"] == "jpeg").write()
            writer.finish()  # type: ignore[no-untyped-call]  # the library types most of itself
        return {"frames": count}

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Give the files their names."""
        for part in parts:
            name = target if plan.writes == "file" else target / f"{part.item.id}.mcap"
            (part.folder / "episode.mcap").rename(name)


def _estimated_bytes(stream: StreamView, told: McapOptions) -> int:
    if not stream.is_image:
        return _PER_SAMPLE * len(stream)
    images: Any = stream.metadata.images  # type: ignore[attr-defined]  # an image stream
    pixels = int(images.height * images.width)
    channels = int(images.channels)
    size = _PER_SAMPLE * len(stream)
    if "reference" in stream.metadata.arrays:
        size += round(1.3 * pixels * channels)  # attached, and compressed to be seen
    if images.encoding == "array":
        return size + len(stream) * pixels * channels
    if images.encoding == "video" and told.video == "jpeg":
        return size + round(len(stream) * pixels * _JPEG_BYTES_PER_PIXEL)
    if images.encoding == "video":
        return size + sum(int(file.bytes) for file in images.files)
    try:
        return size + int(stream.array("offset")[-1])
    except ExumiError:
        return size  # writing it says what is the matter


def _losses(stream: StreamView, told: McapOptions) -> list[Loss]:
    if stream.kind not in _KINDS:
        detail = f"the kind {stream.kind} has no schema there"
        return [Loss(facet="streams", detail=detail, stream=stream.name)]
    images = getattr(stream.metadata, "images", None)
    if images is not None and images.encoding == "video" and told.video == "jpeg":
        detail = "frames of the video are decoded and encoded as JPEG"
        return [Loss(facet=f, detail=detail, stream=stream.name) for f in ("frame-bytes", "pixels")]
    return []


class _EpisodeFile:
    """One episode that is being written."""

    def __init__(self, writer: "Writer", episode: Episode, video_as_jpeg: bool) -> None:
        self._writer = writer
        self._episode = episode
        self._video_as_jpeg = video_as_jpeg
        self._streams = [s for s in episode.streams.values() if s.kind in _KINDS]
        self._base_ns = _base_ns(episode, self._streams)
        self._schemas: dict[str, int] = {}
        self._channels: dict[str, int] = {}

    def write(self) -> int:
        """Write everything; return the number of samples."""
        for stream in self._streams:
            schemas = schemas_of(stream, video_as_jpeg=self._video_as_jpeg)
            for topic, schema in schemas.items():
                self._add_channel(topic, schema, stream)
        self._write_document()
        self._write_calibrations()
        self._write_references()
        own = {topic_of(stream.name) for stream in self._streams}
        count = 0
        messages = [
            messages_of(self._episode, s, self._base_ns, video_as_jpeg=self._video_as_jpeg)
            for s in self._streams
        ]
        with ExitStack() as stack:
            for source in messages:
                stack.callback(source.close)  # type: ignore[attr-defined]  # generators
            for number, (at, topic, data) in enumerate(heapq.merge(*messages)):
                self._writer.add_message(
                    channel_id=self._channels[topic],
                    log_time=at,
                    publish_time=at,
                    data=data,
                    sequence=number & 0xFFFFFFFF,
                )
                count += topic in own
        self._write_arrays()
        self._write_videos()
        return count

    def _add_channel(self, topic: str, schema: str, stream: StreamView | None = None) -> None:
        is_json = schema.startswith("exumi.")
        about = {} if stream is None else _about(stream)
        self._channels[topic] = self._writer.register_channel(
            topic=topic,
            message_encoding="json" if is_json else "protobuf",
            schema_id=self._schema(schema),
            metadata=about,
        )

    def _schema(self, name: str) -> int:
        if name not in self._schemas:
            if name.startswith("exumi."):
                kind = name.removeprefix("exumi.").lower()
                properties = {} if name == SAMPLE_SCHEMA else JSON_SCHEMAS[kind]
                self._schemas[name] = self._writer.register_schema(
                    name=name, encoding="jsonschema", data=json_schema(name, properties)
                )
            else:
                self._schemas[name] = _register_protobuf(self._writer, name)
        return self._schemas[name]

    def _write_calibrations(self) -> None:
        """Let viewers know how the cameras see."""
        from foxglove_schemas_protobuf.CameraCalibration_pb2 import CameraCalibration

        for stream in self._streams:
            intrinsics = intrinsics_of(self._episode, stream.name)
            if intrinsics is None:
                continue
            topic = f"{topic_of(stream.name)}/calibration"
            self._add_channel(topic, "foxglove.CameraCalibration")
            fx, fy, cx, cy = intrinsics.fx, intrinsics.fy, intrinsics.cx, intrinsics.cy
            matrix = [fx, intrinsics.skew, cx, 0.0, fy, cy, 0.0, 0.0, 1.0]
            model = "kannala_brandt" if intrinsics.model == "fisheye" else "rational_polynomial"
            message = CameraCalibration(
                frame_id=stream.name,
                width=intrinsics.width,
                height=intrinsics.height,
                distortion_model=model if intrinsics.distortion else "",
                D=intrinsics.distortion,
                K=matrix,
                R=[1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0],
                P=[fx, intrinsics.skew, cx, 0.0, 0.0, fy, cy, 0.0, 0.0, 0.0, 1.0, 0.0],
            )
            self._add_still(topic, message)

    def _write_references(self) -> None:
        """Let viewers show the images without contact; the exact ones are attached."""
        from foxglove_schemas_protobuf.RawImage_pb2 import RawImage

        for stream in self._streams:
            if "reference" not in stream.metadata.arrays:
                continue
            image = stream.array("reference")
            topic = f"{topic_of(stream.name)}/reference"
            self._add_channel(topic, "foxglove.RawImage")
            height, width, channels = image.shape
            message = RawImage(
                frame_id=stream.name,
                width=width,
                height=height,
                encoding="mono8" if channels == 1 else "rgb8",
                step=width * channels,
                data=image.tobytes(),
            )
            self._add_still(topic, message)

    def _add_still(self, topic: str, message: Any) -> None:
        """Write what holds for a whole stream: before all samples, at the time of the first."""
        at = self._base_ns + _first_ns(self._streams)
        message.timestamp.FromNanoseconds(at)
        self._writer.add_message(
            channel_id=self._channels[topic],
            log_time=at,
            publish_time=at,
            data=message.SerializeToString(deterministic=True),
        )

    def _write_arrays(self) -> None:
        """Attach the arrays that have no message: references, masks, calibration, derived."""
        for stream in self._streams:
            for name in ("reference", "valid"):
                if name in stream.metadata.arrays:
                    self._attach(f"streams/{stream.name}/{name}", stream.array(name))
        for name, item in self._episode.metadata.calibration.items():
            if item.array is not None:
                self._attach(f"calibration/{name}", self._episode.calibration_array(name))
        kept = {stream.name for stream in self._streams}
        derived = self._episode.derived
        for key in derived.items if derived else {}:
            array = self._episode.derived_array(key)
            if key.partition("/")[0] in kept and array is not None:
                self._attach(f"derived/{key}", array)

    def _attach(self, path: str, array: np.ndarray) -> None:
        file = io.BytesIO()
        np.save(file, array, allow_pickle=False)
        self._writer.add_attachment(
            create_time=0,
            log_time=self._base_ns,
            name=f"{ARRAYS_FOLDER}{path}.npy",
            media_type="application/x-npy",
            data=file.getvalue(),
        )

    def _write_videos(self) -> None:
        if self._video_as_jpeg:
            return
        for stream in self._streams:
            images = getattr(stream.metadata, "images", None)
            if images is None or images.encoding != "video":
                continue
            for array in ("pts", "keyframe", "file", *BESIDE):
                if array in stream.metadata.arrays:
                    self._attach(f"streams/{stream.name}/{array}", stream.array(array))
            self._attach(f"streams/{stream.name}/time", stream.time)
            offset = stream.array("offset").tolist()
            for index, file in enumerate(images.files):
                self._attach_video(stream, index, file.media_type, offset[index : index + 2])

    def _attach_video(
        self, stream: StreamView, index: int, media_type: str, place: Sequence[int]
    ) -> None:
        """Attach a video file byte for byte: a large one in pieces."""
        starts = range(place[0], place[1], _PIECE_BYTES)
        for number, start in enumerate(starts):
            stop = min(start + _PIECE_BYTES, place[1])
            self._writer.add_attachment(
                create_time=0,
                log_time=self._base_ns,
                name=video_piece(stream.name, index, number if len(starts) > 1 else None),
                media_type=media_type,
                data=stream.rows("data", start, stop).tobytes(),
            )

    def _write_document(self) -> None:
        """Keep the episode's own words, so that nothing of them has to be guessed again."""
        store = self._episode.store
        derived = store.read("derived/zarr.json").decode() if self._episode.derived else ""
        record = {
            "document": store.read("zarr.json").decode(),
            "derived": derived,
            "base_ns": str(self._base_ns),
            "video": "jpeg" if self._video_as_jpeg else "attach",
        }
        self._writer.add_metadata(DOCUMENT_RECORD, record)


def _base_ns(episode: Episode, streams: Sequence[StreamView]) -> int:
    """Return what makes the episode's times a clock's: its start, or 0 where that is not known.

    MCAP's times are not negative: times before an unknown start are moved.
    """
    first = _first_ns(streams)
    start = episode.metadata.start
    base = 0 if start is None else parse_utc(str(start))
    return max(base, -first)


def _first_ns(streams: Sequence[StreamView]) -> int:
    return min((int(s.time[0]) for s in streams if len(s)), default=0)


def _about(stream: StreamView) -> dict[str, str]:
    """Say in a channel's metadata what its stream is, and of which types the numbers were."""
    about = {"exumi.stream": stream.name, "exumi.kind": stream.kind}
    if stream.metadata.sensor is not None:
        about["sensor"] = stream.metadata.sensor.model
    for name in ("data", "raw"):
        if name in stream.metadata.arrays and not stream.is_image and stream.kind != "audio":
            about[f"exumi.dtype.{name}"] = stream.rows(name, 0, min(1, len(stream))).dtype.str
    return about


def _register_protobuf(writer: "Writer", name: str) -> int:
    from importlib import import_module

    from mcap_protobuf.schema import register_schema

    word = name.removeprefix("foxglove.")
    module = import_module(f"foxglove_schemas_protobuf.{word}_pb2")
    schema: int = register_schema(writer, getattr(module, word))
    return schema
