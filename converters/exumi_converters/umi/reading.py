"""Format ``umi``, read: replay buffers of UMI and exUMI, a Zarr v2 folder or zip."""

import re
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

from pydantic import Field

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.frame_files import add_lossy
from exumi_converters.report import Failure
from exumi_converters.umi.images import ImageSettings, add_camera, add_tactile
from exumi_converters.umi.layout import TACTILE_COMBINED, Layout, find_layout
from exumi_converters.umi.numbers import add_pose, add_sound, add_width
from exumi_converters.zarr2_files.buffer import Buffer, open_buffer
from exumi_converters.zarr2_files.documents import EPISODE_ENDS
from exumi_converters.zarr2_files.rows import Rows
from exumi_converters.zarr2_files.zip_index import is_zip, iter_names
from exumi_data.errors import ExumiError, SourceError, UsageError
from exumi_data.model import Frames, LossyStep, QualityNote, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import format_rate, parse_rate

__all__ = ["DEFAULT_RATE", "MARK", "UmiConverter", "UmiReadOptions"]

DEFAULT_RATE = Fraction(60000, 1001)
"""Rows a second: frames of a GoPro."""

MARK = "exumi"
"""Key of the root's attributes by which a buffer that we wrote says so."""

_NAMED_ARRAY = re.compile(r"(.*/)?data/(robot\d+_eef_pos|camera\d+_rgb|tactile_combined)/\.zarray")
_ENDS_ARRAY = re.compile(r"(.*/)?meta/episode_ends/\.zarray")
_SEARCHED_BYTES = 64 << 20
_DIGITS = 6
_JPEG_SHARE, _ARRAY_SHARE = 0.08, 0.6  # of the pixels, about
_BY = {True: "exUMI's released pipeline", False: "UMI's pipeline"}


class UmiReadOptions(FormatOptions):
    """What only this format can be told."""

    images: Literal["jpeg", "lossless"] = Field(
        "jpeg", description="Camera images: JPEG, or pixels. Tactile images are always pixels."
    )
    quality: int = Field(95, ge=1, le=100, description="Quality of JPEG.")
    tactile: Literal["auto", "channels", "pictures"] = Field(
        "auto",
        description="What tactile images of three channels hold: exUMI's concave, convex and grey, "
        "or red, green and blue.",
    )
    regime: Literal["demonstration", "play"] = Field(
        "demonstration", description="What the episodes are."
    )
    parent: str = Field("world", description="Reference frame that poses are in.")
    child: str = Field("tcp", description="Reference frame that poses are of.")


class UmiConverter:
    """Every episode of a buffer becomes one of ours; memory does not grow with the buffer."""

    name = "umi"
    version = "1"
    id_version = 1
    describes = "replay buffers of UMI and exUMI: a Zarr v2 folder or .zarr.zip"
    keeps: tuple[str, ...] = (
        "poses and widths of all grippers, number by number; start and end pose",
        "tactile images pixel by pixel, all channels",
        "images of all cameras (as JPEG; pixel by pixel with -o images=lossless)",
        "sound (mic_0)",
    )
    loses: tuple[str, ...] = (
        "arrays of other kinds, such as depth (each is named)",
        "the camera images' own coding, unless that is JPEG",
    )
    options: type[FormatOptions] = UmiReadOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise ``meta/episode_ends`` beside an array that only UMI has."""
        try:
            if source.is_dir():
                if not (source / EPISODE_ENDS / ".zarray").is_file():
                    return None
                paths = (source / "data").glob("*/.zarray")
                names: Iterator[str] = (f"data/{path.parent.name}/.zarray" for path in paths)
                ends = True
            elif is_zip(source):
                names, ends = iter_names(source, _SEARCHED_BYTES), False
            else:
                return None
            found = None
            for name in names:
                ends = ends or bool(_ENDS_ARRAY.fullmatch(name))
                found = found or _NAMED_ARRAY.fullmatch(name)
                if ends and found:
                    return f"meta/episode_ends and data/{found[2]}"
        except (ExumiError, OSError):
            return None
        return None

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Read the buffer's directory and where its episodes end."""
        told = parse_options(UmiReadOptions, options.settings, self.name)
        if options.labels is not None:
            raise UsageError("the format umi takes no table of labels", where=options.labels)
        if not source.exists():
            raise SourceError("no such file or folder", where=source)
        buffer = open_buffer(source)
        layout = find_layout(buffer.arrays, buffer.refused)
        if not layout.arrays:
            raise SourceError(
                f"no array can be converted ({_listed(layout.left_out) or 'there is none'})",
                where=source,
                fix="Name the .zarr folder or the .zarr.zip itself.",
            )
        items, failed = _episodes(buffer, layout, options, told)
        return Discovery(
            layout=f"replay buffer: {len(buffer.ends)} episode(s), "
            + ", ".join(sorted(layout.arrays)),
            items=tuple(items),
            notices=tuple(_notices(buffer, layout, options)),
            failed=tuple(failed),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write one episode."""
        rows = {
            file.members.name: file.members for file in item.files if isinstance(file.members, Rows)
        }
        told, layout = item.settings, Layout(**item.settings["streams"])
        rate = parse_rate(told["rate"])
        for name, parts in layout.poses.items():
            frames = Frames(parent=told["parent"], child=told["child"])
            add_pose(writer, name, {k: rows[array] for k, array in parts.items()}, rate, frames)
        for name, array in layout.widths.items():
            add_width(writer, name, rows[array], rate)
        settings = ImageSettings(
            rate=rate,
            lossless=told["images"] == "lossless",
            quality=told["quality"],
            content=told["tactile"],
            exported=told["tactile_made"],
        )
        count = 0
        for name, array in layout.cameras.items():
            count += add_camera(writer, name, rows[array], settings)
        for name, array in layout.tactile.items():
            count += add_tactile(writer, name, rows[array], settings)
        for name, array in layout.sound.items():
            add_sound(writer, name, rows[array], rate)
        _note_source(writer, layout, rows, told)
        return count or told["rows"][1] - told["rows"][0]


def _episodes(
    buffer: Buffer, layout: Layout, options: ConvertOptions, told: UmiReadOptions
) -> tuple[list[EpisodeSource], list[Failure]]:
    mark = buffer.attributes.get(MARK)
    mark = mark if isinstance(mark, dict) else {}
    settings = {
        **_rate(options, mark),
        "images": told.images,
        "quality": told.quality,
        "tactile": told.tactile,
        "parent": told.parent,
        "child": told.child,
        "made_by": mark.get("exporter") if isinstance(mark.get("exporter"), str) else None,
        "tactile_made": _tactile_made(mark),
        "streams": layout.json(),
        "codecs": {
            name: dict(buffer.arrays[name].compressor or {})
            for group in (layout.cameras, layout.tactile)
            for name in group.values()
        },
    }
    task = Task(name=_task(options))
    row_bytes = _row_bytes(buffer, layout, told)
    items: list[EpisodeSource] = []
    failed: list[Failure] = []
    for number, (start, stop, fault) in enumerate(buffer.episodes(layout.arrays)):
        key = f"{number:0{_DIGITS}d}"
        if fault is not None:
            failed.append(Failure(key, fault))
            continue
        items.append(
            EpisodeSource(
                key=key,
                files=_files(buffer, layout, start, stop),
                task=task,
                licence=options.licence,
                regime=told.regime,
                settings={"rows": [start, stop], **settings},
                quality=_known(settings),
                estimated_bytes=round((stop - start) * row_bytes),
            )
        )
    return items, failed


def _files(buffer: Buffer, layout: Layout, start: int, stop: int) -> tuple[SourceFile, ...]:
    """Name the part of each array that an episode is made from."""
    return tuple(
        SourceFile(buffer.path, f"data/{name}", members=buffer.rows(name, start, stop))
        for name in layout.arrays
    )


def _rate(options: ConvertOptions, mark: dict[str, Any]) -> dict[str, Any]:
    """Return the rate of the rows: told, stated by our own export, or that of a GoPro."""
    if options.rate is not None:
        return {"rate": format_rate(parse_rate(options.rate)), "rate_is_assumed": False}
    try:
        return {"rate": format_rate(parse_rate(mark["rate"])), "rate_is_assumed": False}
    except (KeyError, TypeError, ValueError):
        return {"rate": format_rate(DEFAULT_RATE), "rate_is_assumed": True}


def _tactile_made(mark: dict[str, Any]) -> bool:
    """Whether our own export made the tactile channels: clamped, with a reference it knew."""
    shared = mark.get("shared")
    return isinstance(shared, dict) and shared.get("tactile_made") is True


def _task(options: ConvertOptions) -> str:
    """Return the task's name: the general default says nothing of what was done with a gripper."""
    return "manipulation" if options.task == ConvertOptions().task else options.task


def _known(settings: dict[str, Any]) -> tuple[QualityNote, ...]:
    if not settings["rate_is_assumed"]:
        return ()
    return (
        QualityNote(
            code="assumed-rate",
            message=f"the source has no times and does not say its rate; {settings['rate']} "
            "rows/s were assumed, those of a GoPro",
            severity="info",
        ),
    )


def _row_bytes(buffer: Buffer, layout: Layout, told: UmiReadOptions) -> float:
    share = _JPEG_SHARE if told.images == "jpeg" else _ARRAY_SHARE
    size = 100.0
    for name in layout.cameras.values():
        size += share * buffer.arrays[name].row_bytes
    for name in layout.tactile.values():
        size += _ARRAY_SHARE * buffer.arrays[name].row_bytes
    for name in layout.sound.values():
        size += buffer.arrays[name].row_bytes
    return size


def _notices(buffer: Buffer, layout: Layout, options: ConvertOptions) -> Iterator[str]:
    for name, reason in layout.left_out.items():
        yield f"data/{name} is left out: {reason}"
    last = int(buffer.ends.max(initial=0))
    longer = [name for name in layout.arrays if buffer.arrays[name].shape[0] > last]
    if longer:
        yield f"rows from {last} on belong to no episode: {', '.join(longer)}"
    if options.sensor is not None or options.pad_type is not None:
        yield "--sensor and --pad-type have no part in this format"


def _listed(left_out: dict[str, str]) -> str:
    return "; ".join(f"{name}: {reason}" for name, reason in left_out.items())


def _note_source(
    writer: EpisodeWriter, layout: Layout, rows: dict[str, Rows], told: dict[str, Any]
) -> None:
    """Put on record what was lost before this conversion, as far as the buffer shows."""
    if layout.left_out:
        add_lossy(
            writer,
            LossyStep(
                step="left-out",
                detail="arrays of the buffer have no place in an episode",
                parameters=dict(layout.left_out),
            ),
        )
    by = told["made_by"] or _BY[TACTILE_COMBINED in layout.tactile]
    for name in (*layout.poses, *layout.widths):
        detail = "interpolated at the camera's frames, and rounded to float32"
        add_lossy(writer, LossyStep(step="resample", stream=name, detail=detail, by=by))
    for group in (layout.cameras, layout.tactile):
        for name, array in group.items():
            _note_image_codec(writer, name, rows[array], told["codecs"][array], by)


def _note_image_codec(
    writer: EpisodeWriter, name: str, rows: Rows, codec: dict[str, Any], by: str
) -> None:
    height, width = rows.meta.shape[1:3]
    resized = f"frames were resized to {width}x{height}"
    add_lossy(writer, LossyStep(step="resize", stream=name, detail=resized, by=by))
    form = str(codec.get("id", ""))
    if form.startswith("imagecodecs_") and not codec.get("lossless"):
        kept = {k: v for k, v in codec.items() if v is not None and k != "id"}
        add_lossy(
            writer,
            LossyStep(
                step="image-encode",
                stream=name,
                detail=f"frames were encoded with {form}",
                parameters=kept or None,
                by=by,
            ),
        )
