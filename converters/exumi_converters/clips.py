"""Format ``clips``: any folder of videos, each with an optional table of the same stem."""

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from exumi_converters.clip_table import (
    ClipTable,
    describe_unknown,
    read_header,
    read_table,
    unknown_columns,
)
from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.exumi_session.layout import holds_session
from exumi_converters.format_options import FormatOptions
from exumi_converters.frame_files import add_lossy
from exumi_converters.identity import relative_name
from exumi_converters.image_stream import AddedStream, StreamSpec
from exumi_converters.lerobot_dataset.documents import is_dataset
from exumi_converters.names import one_line
from exumi_converters.source_folder import count_names, source_files
from exumi_converters.video_episode import add_video
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import Annotations, LossyStep, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.video import probe_video

__all__ = ["ClipsConverter"]

_TABLE = ".csv"
# such as bolt__t=2 and golf_ball_3
_NAMES = (
    re.compile(r"(?P<object>.+)__t=(?P<trial>\d{1,9})"),
    re.compile(r"(?P<object>.+)_(?P<trial>\d{1,9})"),
)


class ClipsConverter:
    """Videos become image streams, verbatim; a table's columns become streams of force and width.

    The object and trial are taken from names like ``golf_ball_3`` and ``bolt__t=2``.
    """

    name = "clips"
    version = "1"
    id_version = 1
    describes = "any folder of videos, each with an optional CSV of one row a frame"
    keeps: tuple[str, ...] = (
        "the videos' bytes: MJPEG frame by frame, other codecs as the whole file",
        "times of the frames, as the container gives them",
        "force and width of each frame",
        "object and trial, from the file's name",
    )
    loses: tuple[str, ...] = (
        "sound, and other streams of an MJPEG file",
        "columns whose kind or unit is not known (each is named)",
    )
    options = FormatOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise a folder by its videos, unless it says that they are part of something."""
        if not source.is_dir() or is_dataset(source) or holds_session(source):
            return None
        found = next((path for path in source_files(source) if probe_video(path.name)), None)
        return None if found is None else f"a folder of videos, such as {found.name}"

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find videos and their tables, in all folders below `source`."""
        if options.labels is not None:
            raise UsageError("the format clips takes no table of labels", where=options.labels)
        files = list(source_files(source))
        videos = [path for path in files if probe_video(path.name)]
        if not videos:
            raise SourceError(
                f"no video found among {len(files)} file(s)",
                where=source,
                fix="Name a folder that holds .avi, .mov, .mp4, .mkv or .webm files.",
            )
        tables = {path for path in files if path.suffix.lower() == _TABLE}
        pairs = {video: _table_of(video, tables) for video in videos}
        used = {table for table in pairs.values() if table is not None}
        items = tuple(_item(video, pairs[video], source, options) for video in videos)
        notices = [*_table_notices(used), *_orphan_notices(source, files, videos, tables - used)]
        return Discovery(
            layout=f"clips: {len(videos)} video(s), {len(used)} of them with a table",
            items=items,
            notices=tuple(notices),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write one clip and its table."""
        spec = StreamSpec(**item.settings["stream"])
        table = read_table(item.files[1].path) if len(item.files) > 1 else None
        inputs = writer.metadata.source.inputs or []
        images = add_video(writer, spec, item.files[0].path, inputs[0])
        if table is not None:
            _add_table(writer, item.files[1], table, images)
        return images.stream.count


def _table_of(video: Path, tables: set[Path]) -> Path | None:
    same = (video.with_suffix(suffix) for suffix in (_TABLE, _TABLE.upper()))
    return next((table for table in same if table in tables), None)


def _item(video: Path, table: Path | None, root: Path, options: ConvertOptions) -> EpisodeSource:
    key = relative_name(video, root)
    files = [SourceFile(video, key)]
    if table is not None:
        files.append(SourceFile(table, relative_name(table, root), identifies=False))
    return EpisodeSource(
        key=key,
        files=tuple(files),
        task=Task(name=options.task),
        licence=options.licence,
        annotations=_annotations(video.stem, options),
        settings={
            "stream": {"name": options.stream, "kind": options.kind, "sensor": options.sensor}
        },
    )


def _annotations(stem: str, options: ConvertOptions) -> Annotations | None:
    match = next((found for name in _NAMES if (found := name.fullmatch(stem))), None)
    values: dict[str, object] = {}
    if match is not None:
        values = {"object_id": one_line(match["object"]), "trial": int(match["trial"])}
    if options.pad_type is not None:
        values["pad_type"] = options.pad_type
    return Annotations.model_validate(values) if values else None


def _table_notices(tables: set[Path]) -> Iterator[str]:
    """Name the columns that are not understood, each once, with how many tables have it."""
    counts: dict[str, int] = {}
    for table in sorted(tables):
        try:
            header = read_header(table)
        except SourceError:
            continue  # the conversion of its clip will fail, and say so
        for name in unknown_columns(header):
            counts[name] = counts.get(name, 0) + 1
    if counts:
        yield describe_unknown([f"{name} ({n} tables)" for name, n in counts.items()])


def _orphan_notices(
    root: Path, files: list[Path], videos: list[Path], orphans: set[Path]
) -> Iterator[str]:
    if orphans:
        yield count_names("table(s) without a video of the same name", root, sorted(orphans))
    known = {*videos, *orphans}
    other = [path for path in files if path not in known and path.suffix.lower() != _TABLE]
    if other:
        yield count_names("file(s) that are no video and no table, not read", root, other)


def _add_table(
    writer: EpisodeWriter, file: SourceFile, table: ClipTable, images: AddedStream
) -> None:
    if table.rows != len(images.times):
        raise SourceError(
            f"the table has {table.rows} rows, the video {len(images.times)} frames: nothing says "
            "which rows belong to which frames",
            where=file.path,
            fix="Mend the table (one row a frame), or take it away to convert the video alone.",
        )
    model = images.stream.model
    for stream in table.streams:
        fields: dict[str, Any] = {}
        if stream.components:
            fields["components"] = list(stream.components)
        if model.nominal_rate is not None:
            fields["nominal_rate"] = model.nominal_rate
        # Rows were written with the frames, so they share the frames' clock.
        target = writer.add_stream(stream.name, kind=stream.kind, clock=model.clock, **fields)
        target.append(images.times, stream.data)
    if table.dropped:
        add_lossy(writer, LossyStep(step="drop-columns", detail=describe_unknown([*table.dropped])))
    if table.rounded:
        detail = f"numbers of {', '.join(table.rounded)} were rounded to float32"
        add_lossy(writer, LossyStep(step="round-float32", detail=detail))
