"""``--from hdf5``: demonstrations of robomimic and FreeTacMan become episodes."""

from collections.abc import Iterator, Mapping
from fractions import Fraction
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from exumi_converters.converter import (
    ConvertOptions,
    Discovery,
    EpisodeSource,
    NamedSplit,
    SourceFile,
)
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.frame_files import add_lossy
from exumi_converters.hdf5_files.contents import blocks, opened, read_whole, walk
from exumi_converters.hdf5_files.layout import (
    OBSERVATIONS,
    Demonstration,
    Found,
    Hdf5Members,
    demonstrations,
    group_of,
    is_image,
    layout_of,
)
from exumi_converters.identity import relative_name
from exumi_converters.names import free_stream_name
from exumi_converters.report import Failure
from exumi_converters.source_folder import source_files
from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.errors import ExumiError, SourceError, UsageError
from exumi_data.geometry import make_sign_continuous
from exumi_data.model import (
    ArrayImages,
    Clock,
    Frames,
    LossyStep,
    QualityNote,
    Task,
)
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey
from exumi_data.time import nominal_times, parse_rate

__all__ = ["Hdf5Converter", "Hdf5Options"]

_SUFFIXES = (".hdf5", ".h5")
_RATES = {"robomimic": "20/1", "freetacman": "30/1"}
_COLOURS = 3
_TOUCH = ("tactile", "gelsight", "digit", "tac")
_ASKED = 10  # files by which a folder is recognised
_PICTURES = "observations/images/"
_UNIT_WITHIN = 0.05  # what interpolating by component leaves of a length of 1
_SHORT_NORM = 0.9  # of a quaternion: what mixing two by component leaves of their length


class Hdf5Options(FormatOptions):
    """What only this format can be told."""

    tactile: str = Field(
        "", description="Keys of tactile images, separated by commas. Default: those named so."
    )
    channels: Literal["auto", "rgb", "bgr"] = Field(
        "auto",
        description="Order of the colours. auto: RGB for robomimic, BGR for FreeTacMan, whose "
        "program writes OpenCV's frames as they are.",
    )
    quaternion: Literal["xyzw", "wxyz"] = Field(
        "xyzw", description="Order of quaternions; the files do not say."
    )


class Hdf5Converter:
    """Images become pixels without loss; poses and widths streams; all of it at one stated rate."""

    name = "hdf5"
    version = "1"
    id_version = 1
    describes = "HDF5 of robomimic (data/demo_<n>/obs) or FreeTacMan (observations/images)"
    keeps: tuple[str, ...] = (
        "every image, pixel by pixel",
        "end poses, and the opening of the gripper",
        "robomimic's masks as a split",
    )
    loses: tuple[str, ...] = (
        "actions, rewards, states, joint angles and other keys (each is named)",
        "attributes of the file but the task's name and the rate",
    )
    options: type[FormatOptions] = Hdf5Options

    def recognise(self, source: Path) -> str | None:
        """Recognise a file by the groups in it."""
        try:
            paths = [source] if source.is_file() else _files(source)
        except (ExumiError, OSError):
            return None
        for path in paths[:_ASKED]:
            try:
                layout = layout_of(path)
            except (ExumiError, OSError):
                continue  # one file that is cut short does not hide the others
            if layout is not None:
                return f"{path.name} is laid out as {layout} does it"
        return None

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find the demonstrations in all files."""
        told = parse_options(Hdf5Options, options.settings, self.name)
        root = source.parent if source.is_file() else source
        paths = [source] if source.is_file() else _files(source)
        if not paths:
            raise SourceError("there is no .hdf5 or .h5 file", where=source)
        found: dict[str, Found] = {}
        failed: list[Failure] = []
        for path in paths:
            name = relative_name(path, root)
            try:
                found[name] = demonstrations(path)
            except (ExumiError, OSError) as error:
                failed.append(Failure(name, str(error)))
        _check_tactile(found, told, source)
        items = [
            _item(demo, name, options, told) for name, one in found.items() for demo in one.episodes
        ]
        layouts = sorted({one.layout for one in found.values()})
        splits = (NamedSplit("robomimic", "episode", "mask/train and mask/valid of the file"),)
        for name, one in found.items():
            failed += [Failure(f"{name}/{inside}", reason) for inside, reason in one.failed]
        return Discovery(
            layout=f"{len(paths)} file(s) of {' and '.join(layouts) or 'no known layout'}",
            items=tuple(items),
            notices=tuple(f"{name}: {text}" for name, one in found.items() for text in one.notices),
            failed=tuple(failed),
            splits=splits if any(item.splits for item in items) else (),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write the streams of one demonstration."""
        with opened(item.files[0].path) as file:
            group = group_of(file, item.settings["group"])
            return _Conversion(item, writer, group).write()


def _files(source: Path) -> list[Path]:
    return [path for path in source_files(source) if path.suffix.lower() in _SUFFIXES]


def _listed(told: Hdf5Options) -> list[str]:
    return sorted(filter(None, (key.strip() for key in told.tactile.split(","))))


def _check_tactile(found: Mapping[str, Found], told: Hdf5Options, source: Path) -> None:
    """Refuse a key of tactile images that no episode has."""
    there = {key for one in found.values() for demo in one.episodes for key in demo.images}
    for key in _listed(told):
        if there and not any(_is_called(one, key) for one in there):
            raise UsageError(
                f"no images are called {key!r} (-o tactile)",
                where=source,
                fix=f"There are: {', '.join(sorted(there))}.",
            )


def _is_called(key: str, wanted: str) -> bool:
    """Whether a key is what the user wrote: with or without the groups that it is in."""
    return wanted in (key, key.rpartition("/")[2])


def _item(
    demo: Demonstration, name: str, options: ConvertOptions, told: Hdf5Options
) -> EpisodeSource:
    colours = told.channels
    if colours == "auto":
        colours = "bgr" if demo.layout == "freetacman" else "rgb"
    rate = options.rate or demo.rate or _RATES[demo.layout]
    default = ConvertOptions().task
    return EpisodeSource(
        key=f"{name}/{demo.number:09d}" if demo.group else name,
        files=(SourceFile(demo.path, name, members=Hdf5Members(demo.path, demo.group)),),
        task=Task(name=options.task if options.task != default else demo.task or default),
        licence=options.licence,
        regime="demonstration",
        settings={
            "group": demo.group,
            "layout": demo.layout,
            "rate": rate,
            "rate_is_assumed": options.rate is None and demo.rate is None,
            "channels": colours,
            "quaternion": told.quaternion,
            "tactile": _listed(told),
            "sensor": options.sensor,
        },
        splits={} if demo.split is None else {"robomimic": demo.split},
        estimated_bytes=demo.stored_bytes,
    )


class _Conversion:
    """One demonstration that is being written."""

    def __init__(self, item: EpisodeSource, writer: EpisodeWriter, group: Any) -> None:
        self._settings = item.settings
        self._writer = writer
        self._where = item.files[0].path
        contents = walk(group)
        self._prefix = OBSERVATIONS[item.settings["layout"]]
        self._observed = {
            key.removeprefix(self._prefix): data
            for key, data in contents.numbers.items()
            if key.startswith(self._prefix) and data.shape[0]
        }
        self._all = {*contents.numbers, *contents.others}
        self._rate: Fraction = parse_rate(item.settings["rate"])
        self._used: set[str] = set()
        self._names: set[str] = set()

    def write(self) -> int:
        """Write all streams; return the number of samples."""
        if not self._observed:
            raise SourceError("the demonstration holds no sample", where=self._where)
        self._note_lengths({key: int(data.shape[0]) for key, data in self._observed.items()})
        # Poses and widths first: their names are not for images.
        total = self._add_poses() + self._add_widths()
        for key, data in self._observed.items():
            if is_image(data):
                total += self._add_images(key, data)
        if total == 0:
            raise SourceError("no image, pose or width was found", where=self._where)
        self._note_source()
        return total

    def _name(self, wanted: str) -> str:
        name = free_stream_name(wanted, self._names)
        self._names.add(name)
        return name

    def _times(self, count: int) -> np.ndarray:
        return nominal_times(count, self._rate)

    def _clock(self) -> dict[str, Any]:
        return {
            "clock": Clock(source="none", stamp_point="nominal_rate"),
            "nominal_rate": self._settings["rate"],
        }

    def _add_images(self, key: str, data: Any) -> int:
        """Store the frames as they are."""
        self._used.add(key)
        named = self._settings["tactile"]
        touch = any(_is_called(key, one) for one in named) or (
            not named and any(word in key.lower() for word in _TOUCH)
        )
        count, height, width, channels = data.shape
        extra: dict[str, Any] = {}
        if touch and self._settings["sensor"]:
            extra["sensor"] = {"model": self._settings["sensor"]}
        stream = self._writer.add_stream(
            self._name(key.rpartition("/")[2]),
            kind="tactile" if touch else "rgb",
            images=ArrayImages(encoding="array", height=height, width=width, channels=channels),
            **self._clock(),
            **extra,
        )
        times, analysis = self._times(count), TactileAnalysis()
        for start, block in self._frames(data):
            stream.append(times[start : start + len(block)], block)
            if touch:
                for frame in block:
                    analysis.add(_grey(frame))
        if touch:
            analysis.finish(self._writer, stream, _FrameReader(lambda: self._frames(data)))
        return int(count)

    def _frames(self, data: Any) -> Iterator[tuple[int, np.ndarray]]:
        flip = self._settings["channels"] == "bgr" and data.shape[3] == _COLOURS
        for start, block in blocks(data):
            yield start, np.ascontiguousarray(block[..., ::-1]) if flip else block

    def _add_poses(self) -> int:
        if self._settings["layout"] == "freetacman":
            key = next((key for key in ("end_pose", "qpos") if self._holds_poses(key)), None)
            if key is None:
                return 0
            self._used.add(key)
            return self._add_pose("pose", read_whole(self._observed[key]), key)
        total = 0
        for key, positions in self._observed.items():
            if not key.endswith("_eef_pos") or positions.shape[1:] != (3,):
                continue
            partner = f"{key.removesuffix('_pos')}_quat"
            turns = self._observed.get(partner)
            if turns is None or turns.shape[1:] != (4,) or turns.shape[0] != positions.shape[0]:
                continue
            self._used |= {key, partner}
            robot = key.removesuffix("_eef_pos")
            name = "pose" if robot == "robot0" else f"pose_{robot}"
            poses = np.hstack([read_whole(positions), read_whole(turns)])
            total += self._add_pose(name, poses, key)
        return total

    def _holds_poses(self, key: str) -> bool:
        """Whether FreeTacMan's program wrote poses under a key.

        With ``qpos_mode`` set to poses, `qpos` holds them, and its last number is no opening but
        the real part of a quaternion: then four of its numbers are of length 1 throughout.
        """
        data = self._observed.get(key)
        if data is None or data.shape[1:] != (7,):
            return False
        if key == "end_pose":
            return True
        norms = np.linalg.norm(read_whole(data)[:, 3:], axis=1)
        return bool((np.abs(norms - 1.0) < _UNIT_WITHIN).all())

    def _add_pose(self, name: str, poses: np.ndarray, key: str) -> int:
        name, poses = self._name(name), poses.astype(np.float64)
        if self._settings["quaternion"] == "wxyz":
            poses = poses[:, [0, 1, 2, 4, 5, 6, 3]]
        norms = np.linalg.norm(poses[:, 3:], axis=1)
        bad = ~np.isfinite(poses).all(axis=1) | (norms < 1e-6)  # no rotation
        if bad.any():
            raise SourceError(
                f"{key}: row {int(np.flatnonzero(bad)[0])} holds no pose", where=self._where
            )
        if (norms < _SHORT_NORM).any():
            self._note(
                "mixed-quaternions",
                f"{int((norms < _SHORT_NORM).sum())} quaternions of {key} are far from length 1 "
                "(the shortest "
                f"{norms.min():.2f}): they were interpolated component by component, and their "
                "rotation is not what was measured",
                name,
            )
        poses[:, 3:] = make_sign_continuous(poses[:, 3:] / norms[:, None])
        stream = self._writer.add_stream(
            name,
            kind="pose",
            frames=Frames(parent="world", child="tcp"),
            **self._clock(),
        )
        stream.append(self._times(len(poses)), poses)
        return len(poses)

    def _add_widths(self) -> int:
        """Take the opening from where the layout has it."""
        if self._settings["layout"] == "freetacman":
            data = self._observed.get("qpos")
            # 6 joint angles and it: other numbers are of other robots.
            if data is None or data.shape[1:] != (7,) or "qpos" in self._used:
                return 0
            return self._add_width("width", read_whole(data)[:, 6], "qpos, column 6")
        total = 0
        for key, data in self._observed.items():
            if key.endswith("_gripper_qpos") and data.shape[1:] == (2,):
                self._used.add(key)
                robot = key.removesuffix("_gripper_qpos")
                name = "width" if robot == "robot0" else f"width_{robot}"
                fingers = read_whole(data)
                total += self._add_width(name, np.abs(fingers[:, 0] - fingers[:, 1]), key)
        return total

    def _add_width(self, name: str, widths: np.ndarray, key: str) -> int:
        if not np.isfinite(widths).all():
            raise SourceError(f"{key} holds values that are no numbers", where=self._where)
        stream = self._writer.add_stream(self._name(name), kind="width", **self._clock())
        stream.append(self._times(len(widths)), widths.astype(np.float32))
        return len(widths)

    def _note_lengths(self, lengths: dict[str, int]) -> None:
        """Say where counts differ: nothing is cut to the shortest."""
        if len(set(lengths.values())) > 1:
            named = ", ".join(f"{key} {count}" for key, count in sorted(lengths.items()))
            self._note("lengths", f"the keys have different numbers of samples: {named}")

    def _note_source(self) -> None:
        if self._settings["rate_is_assumed"]:
            self._note(
                "assumed-rate",
                f"the source does not say its rate; {self._settings['rate']} a second was assumed",
            )
        used = {f"{self._prefix}{key}" for key in self._used}
        left = sorted(self._all - used)
        unread = [key for key in left if key.startswith(_PICTURES)]
        if unread:
            self._note(
                "pictures-not-read",
                f"{', '.join(unread)}: no arrays of 8-bit pixels, such as frames that were "
                "compressed one by one",
            )
        if left:
            self._note("not-converted", f"keys that were not read: {', '.join(left)}", info=True)
        if self._settings["layout"] == "freetacman":
            add_lossy(
                self._writer,
                LossyStep(
                    step="resample",
                    detail="the program that wrote the file may have added frames between the "
                    "recorded ones by mixing neighbours, and interpolated poses by component; the "
                    "file does not say whether it did",
                    by="process_data.py of FreeTacMan",
                ),
            )

    def _note(
        self, code: str, message: str, stream: str | None = None, *, info: bool = False
    ) -> None:
        self._writer.metadata.quality.append(
            QualityNote(
                code=code,
                message=message,
                stream=stream,
                severity="info" if info else "warning",
            )
        )


class _FrameReader:
    """Frames of one key, again."""

    def __init__(self, read: Any) -> None:
        self._read = read

    def _all(self) -> Iterator[np.ndarray]:
        for _, block in self._read():
            yield from block

    def greys(self) -> Iterator[np.ndarray]:
        """Yield every frame, (H, W) uint8."""
        return map(_grey, self._all())

    def pictures(self, indices: Any) -> list[np.ndarray]:
        """Return some frames, ascending."""
        wanted = set(indices)
        return [frame for index, frame in enumerate(self._all()) if index in wanted]


def _grey(frame: np.ndarray) -> np.ndarray:
    return to_grey(frame) if frame.shape[2] == _COLOURS else frame[..., 0]
