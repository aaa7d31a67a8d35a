"""Format ``oxt``, read: stores of Open-X-Tactile, as folders or zips, one or many."""

import os
import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.frame_files import add_lossy
from exumi_converters.identity import relative_name
from exumi_converters.oxt.contract import CAMERAS, INSTRUCTION, TIMESTAMPS, key_of
from exumi_converters.oxt.layout import Layout, find_layout, read_mark
from exumi_converters.oxt.numbers import add_pose, add_width, add_words
from exumi_converters.oxt.options import OxtReadOptions
from exumi_converters.oxt.pictures import add_camera
from exumi_converters.oxt.stamps import Unit, find_unit, read_timeline
from exumi_converters.oxt.touch import Names, add_group
from exumi_converters.report import Failure
from exumi_converters.zarr2_files.buffer import open_buffer
from exumi_converters.zarr2_files.documents import EPISODE_ENDS
from exumi_converters.zarr2_files.rows import Rows
from exumi_converters.zarr2_files.zip_index import is_zip, iter_names
from exumi_data.errors import ExumiError, SourceError, UsageError
from exumi_data.model import LossyStep, QualityNote, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import format_utc

__all__ = ["OxtConverter"]

_DEEPEST = 3
_DIGITS = 6
_SEARCHED_BYTES = 64 << 20
_SHARE = 0.6  # of the pixels, about
_MEMBER = re.compile(r"(?:.*/)?(data|meta)/([^/]+)/\.zarray")


class OxtConverter:
    """Every episode of every store becomes one of ours; memory does not grow with the store."""

    name = "oxt"
    version = "1"
    id_version = 1
    describes = "Open-X-Tactile / FTP-1: Zarr v2 stores, folders or .zarr.zip"
    keeps: tuple[str, ...] = (
        "images of cameras and visuo-tactile sensors, pixel by pixel (cameras as JPEG with "
        "-o images=jpeg)",
        "timestamps, in the unit that is stated, told or found",
        "poses of wrists and the ego camera; a gripper's width, where its unit is known",
        "grids of tactile cells",
        "the instruction; where it changes, as segments",
    )
    loses: tuple[str, ...] = (
        "joints of arms and hands",
        "forces and torques, and cells of several numbers, as their order and units are not stated",
        "other arrays (each is named)",
    )
    options: type[FormatOptions] = OxtReadOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise a store by the timestamps and instructions that all have."""
        try:
            for path in _stores(source):
                found = _names(path)
                if {f"data/{TIMESTAMPS}", f"data/{INSTRUCTION}", EPISODE_ENDS} <= found:
                    named = next((c for c in CAMERAS if f"data/{c}" in found), INSTRUCTION)
                    return f"{path.name} holds {EPISODE_ENDS}, data/{TIMESTAMPS}, data/{named}"
                if not found and path == source:
                    return None
        except (ExumiError, OSError):
            return None
        return None

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Read the directory of each store, its timestamps, and where its episodes end."""
        told = parse_options(OxtReadOptions, options.settings, self.name)
        if options.labels is not None:
            raise UsageError("the format oxt takes no table of labels", where=options.labels)
        if not source.exists():
            raise SourceError("no such file or folder", where=source)
        items: list[EpisodeSource] = []
        failed: list[Failure] = []
        left_out: dict[tuple[str, str], int] = {}
        errors: list[ExumiError] = []
        stores = list(_stores(source))
        for path in stores:
            name = path.name if path == source else relative_name(path, source)
            try:
                found = _Store(path, name, options, told)
            except ExumiError as error:
                errors.append(error)
                failed.append(Failure(name, str(error)))
                continue
            items += found.items
            failed += found.failed
            for array, reason in found.layout.left_out.items():
                left_out[array, reason] = left_out.get((array, reason), 0) + 1
        if not items:
            raise _nothing(source, errors, failed)
        return Discovery(
            layout=f"{len(stores)} store(s) of Open-X-Tactile, {len(items)} episode(s)",
            items=tuple(items),
            failed=tuple(failed),
            notices=tuple(
                f"data/{array} is left out{f' ({n} stores)' if n > 1 else ''}: {reason}"
                for (array, reason), n in left_out.items()
            ),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write one episode."""
        rows = {f.members.name: f.members for f in item.files if isinstance(f.members, Rows)}
        told, layout = item.settings, Layout(**item.settings["layout"])
        unit = Unit(**told["timestamps"])
        timeline = read_timeline(rows[TIMESTAMPS].read(fill=True).reshape(-1), unit)
        if timeline.start_ns is not None:
            writer.metadata.start = format_utc(timeline.start_ns)
        if timeline.nudged.any():
            _note(writer, "time-nudged", f"{np.count_nonzero(timeline.nudged)} timestamp(s) do not "
                  "come after the one before and were moved")  # fmt: skip
        add_words(writer, rows[INSTRUCTION], timeline)
        quality = told["quality"] if told["images"] == "jpeg" else None
        names = Names(layout)
        count = 0
        for key, name in layout.cameras.items():
            count += add_camera(writer, name, rows[key], timeline, quality)
        for key in layout.tactile:
            group = {what: rows[key_of(key, what)] for what in ("data", "area", "sensor", "type")}
            count += add_group(writer, group, timeline, layout.about.get(key, {}), names)
        for key, name in layout.poses.items():
            add_pose(writer, name, rows[key], timeline, layout.about.get(key, {}))
        for key, name in layout.widths.items():
            slots = rows.get(f"{key}_idx")
            add_width(writer, name, rows[key], slots, timeline, layout.scales[key])
        _note_source(writer, layout, told)
        return count or len(timeline.time_ns)


def _nothing(source: Path, errors: list[ExumiError], failed: list[Failure]) -> ExumiError:
    if len(errors) == 1 and len(failed) == 1:
        return errors[0]
    if failed:
        named = "; ".join(f"{failure.name}: {failure.reason}" for failure in failed[:5])
        return SourceError(f"no episode can be converted: {named}", where=source)
    return SourceError(
        "there is no store in it",
        where=source,
        fix="Name a .zarr folder or .zarr.zip, or a folder that holds some; unpack a .tar first.",
    )


def _note(writer: EpisodeWriter, code: str, message: str, **fields: Any) -> None:
    writer.metadata.quality.append(QualityNote(code=code, message=message, **fields))


def _stores(source: Path) -> Iterator[Path]:
    """Yield the stores at or below a path, in a stable order; nothing in them is listed."""
    if source.is_file():
        if is_zip(source):
            yield source
        return
    if (source / EPISODE_ENDS / ".zarray").is_file():
        yield source
        return
    yield from _below(source, _DEEPEST)


def _below(folder: Path, levels: int) -> Iterator[Path]:
    if not folder.is_dir():
        return
    with os.scandir(folder) as entries:
        found = sorted(entries, key=lambda entry: entry.name)
    for entry in found:
        path = folder / entry.name
        if entry.name.startswith("."):
            continue
        if entry.name.endswith(".zarr") and path.is_dir():
            if (path / EPISODE_ENDS / ".zarray").is_file():
                yield path
        elif entry.name.endswith(".zarr.zip") and path.is_file() and is_zip(path):
            yield path
        elif levels > 1 and entry.is_dir(follow_symlinks=False):
            yield from _below(path, levels - 1)


def _names(path: Path) -> set[str]:
    """Return the arrays of a store."""
    if path.is_dir():
        arrays = [EPISODE_ENDS, *(f"data/{n}" for n in (TIMESTAMPS, INSTRUCTION, *CAMERAS))]
        return {name for name in arrays if (path / name / ".zarray").is_file()}
    matches = map(_MEMBER.fullmatch, iter_names(path, _SEARCHED_BYTES))
    return {f"{match[1]}/{match[2]}" for match in matches if match}


class _Store:
    """The episodes of one store.

    Raises
    ------
    ExumiError
        None of them can be converted.
    """

    def __init__(
        self, path: Path, name: str, options: ConvertOptions, told: OxtReadOptions
    ) -> None:
        self._buffer = open_buffer(path)
        self._name = name
        self._options = options
        self._told = told
        self._mark = read_mark(self._buffer.attributes)
        self._check_required()
        self.layout = find_layout(self._buffer, self._mark, told)
        if not (self.layout.images or self.layout.poses or self.layout.widths):
            named = "; ".join(f"{key}: {why}" for key, why in self.layout.left_out.items())
            raise SourceError(f"nothing of it can be converted ({named})", where=path)
        self._settings: dict[str, Any] = {
            "timestamps": self._unit(told).json(),
            "images": told.images,
            "quality": told.quality,
            "made_by": self._mark.exporter,
            "layout": self.layout.json(),
        }
        self.items: list[EpisodeSource] = []
        self.failed: list[Failure] = []
        self._find_episodes()

    def _check_required(self) -> None:
        """Check what every store has to have.

        Raises
        ------
        SourceError
            With what to do.
        """
        for name, kinds in ((TIMESTAMPS, "iuf"), (INSTRUCTION, "SU")):
            meta = self._buffer.arrays.get(name)
            if meta is None or meta.dtype.kind not in kinds or meta.shape[1:] not in ((), (1,)):
                reason = self._buffer.refused.get(name)
                if reason is None:
                    reason = "is missing" if meta is None else f"is {meta.shape} {meta.dtype}"
                reason = reason.rstrip(".")
                fix = "The contract asks for it: one number a step."
                if name == INSTRUCTION:
                    fix = "Write it again as strings of fixed width: numpy's astype('U')."
                raise SourceError(f"data/{name}: {reason}", where=self._buffer.path, fix=fix)

    def _unit(self, told: OxtReadOptions) -> Unit:
        """Find the unit of the timestamps, from the first episode that is long enough."""
        stated = self._mark.arrays.get(TIMESTAMPS, {}).get("unit")
        found = self._buffer.episodes([TIMESTAMPS])
        usable = [rows for rows in found if rows.fault is None]
        if not usable:
            fault = next(self._buffer.episodes([TIMESTAMPS])).fault
            raise SourceError(
                f"no episode has its rows; the first: {fault}", where=self._buffer.path
            )
        start, stop, _ = max(usable, key=lambda rows: rows.stop - rows.start)
        stamps = self._buffer.rows(TIMESTAMPS, start, stop).read(fill=True).reshape(-1)
        try:
            return find_unit(stamps, told.timestamps, self._options.rate, stated)
        except SourceError as error:
            raise SourceError(error.what, where=self._buffer.path, fix=error.fix) from None

    def _find_episodes(self) -> None:
        found = self._buffer.episodes(self.layout.arrays)
        for number, (start, stop, fault) in enumerate(found):
            key = f"{self._name}/{number:0{_DIGITS}d}"
            parent = self._parent(number)
            if parent is not None:
                key += f"-{parent}"
            if fault is not None:
                self.failed.append(Failure(key, fault))
                continue
            self.items.append(self._item(key, start, stop, parent))

    def _parent(self, number: int) -> str | None:
        """Return the id of the episode that was exported, if the store says it for all."""
        episodes = self._mark.episodes
        return episodes[number] if len(episodes) == len(self._buffer.ends) else None

    def _item(self, key: str, start: int, stop: int, parent: str | None) -> EpisodeSource:
        buffer, options = self._buffer, self._options
        sizes = {name: buffer.arrays[name].row_bytes for name in self.layout.arrays}
        images = set(self.layout.images)
        size = sum(b * (_SHARE if name in images else 1) for name, b in sizes.items())
        return EpisodeSource(
            key=key,
            files=tuple(
                SourceFile(
                    buffer.path,
                    f"{self._name}/data/{name}",
                    members=buffer.rows(name, start, stop),
                )
                for name in self.layout.arrays
            ),
            task=Task(name=self._task()),
            licence=options.licence,
            regime=self._told.regime,
            settings={"rows": [start, stop], **self._settings},
            quality=_known(self._settings["timestamps"]),
            estimated_bytes=round((stop - start) * size),
            parent_id=parent,
        )

    def _task(self) -> str:
        if self._options.task != ConvertOptions().task:
            return self._options.task
        stem = Path(self._name).name.removesuffix(".zip").removesuffix(".zarr")
        return " ".join((self._mark.task or stem).split())[:255].strip() or "manipulation"


def _known(unit: Mapping[str, Any]) -> tuple[QualityNote, ...]:
    if unit["assumed"] is None:
        return ()
    what = {"number": "numbers of steps"}.get(unit["name"], f"in {unit['name']}")
    return (
        QualityNote(
            code="assumed-unit",
            message=f"the store does not state the unit of its timestamps; they were taken to be "
            f"{what}, as {unit['assumed']}",
            severity="info",
        ),
    )


def _note_source(writer: EpisodeWriter, layout: Layout, told: Mapping[str, Any]) -> None:
    """Put on record what was lost before this conversion and in it, as far as the store shows."""
    if layout.left_out:
        add_lossy(
            writer,
            LossyStep(
                step="left-out",
                detail="arrays of the store have no place in an episode",
                parameters=dict(layout.left_out),
            ),
        )
    if told["made_by"] is not None:
        add_lossy(
            writer,
            LossyStep(
                step="resample",
                detail="all streams were put on one timeline; numbers were interpolated there and "
                "rounded to float32, frames are the nearest",
                by=f"exumi-data {told['made_by']}",
            ),
        )
