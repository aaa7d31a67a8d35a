"""``--from lerobot``: datasets of LeRobot v3, ours and others'."""

from collections import Counter
from collections.abc import Iterator, Sequence
from itertools import pairwise
from pathlib import Path

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.identity import relative_name
from exumi_converters.lerobot_dataset.documents import (
    EpisodeRow,
    Info,
    file_name,
    is_dataset,
    read_declaration,
    read_episodes,
    read_info,
    read_tasks,
)
from exumi_converters.lerobot_dataset.episode import LeRobotEpisode
from exumi_converters.lerobot_dataset.layout import INFO, Declaration, label
from exumi_converters.lerobot_dataset.mapping import FeatureMap, map_features
from exumi_converters.lerobot_dataset.options import LeRobotReadOptions
from exumi_converters.report import Failure
from exumi_converters.source_folder import count_names, source_files
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import UNKNOWN_LICENCE, Annotations, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.time import format_rate

__all__ = ["LeRobotConverter"]

_META = "meta/"
_LATEST_S = 1e8
_BESIDE = ("README.md", "exumi_export.json")


class LeRobotConverter:
    """An episode an episode: its videos verbatim, and the numbers whose names say what they are."""

    name = "lerobot"
    version = "1"
    id_version = 1
    describes = "datasets of LeRobot v3.0, such as exumi convert --to lerobot writes"
    keeps: tuple[str, ...] = (
        "videos: the file byte for byte where an episode has one of its own, else its packets "
        "copied; as JPEG only where frames cannot be decoded without those of other episodes",
        "pictures in the tables: JPEG byte for byte, PNG without loss",
        "poses and widths whose names say what they are (x y z qx qy qz qw, width_m), or -o does",
        "tasks; where they change within an episode, as segments",
    )
    loses: tuple[str, ...] = (
        "actions, and numbers of which nothing says what they are (each is named)",
        "statistics, depth coded as colours, language columns",
        "timestamps other than the frame's number by the rate (said where they differ)",
    )
    options: type[FormatOptions] = LeRobotReadOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise a folder by its ``meta/info.json``."""
        if not source.is_dir() or not is_dataset(source):
            return None
        return f"{INFO} names a codebase_version and features"

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Read the documents and the table of episodes."""
        if options.labels is not None:
            raise UsageError("the format lerobot takes no table of labels", where=options.labels)
        told = parse_options(LeRobotReadOptions, options.settings, self.name)
        if not (source / INFO).is_file():
            raise SourceError(
                f"there is no {INFO}", where=source, fix="Name the folder of a LeRobotDataset v3.0."
            )
        info = read_info(source)
        notices: list[str] = []
        declaration = _declaration(source, notices)
        mapped = map_features(info, declaration, told)
        finder = _Finder(source, info, mapped, declaration, options)
        items = list(finder.items(read_episodes(source, info)))
        notices += [f"not read: {key} ({why})" for key, why in mapped.unread.items()]
        notices += finder.notices()
        return Discovery(
            layout=f"LeRobotDataset {info.codebase_version}: {finder.total} episodes at "
            f"{info.fps:g} fps",
            items=tuple(items),
            notices=tuple(notices),
            failed=tuple(finder.failed),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write the streams of one episode."""
        return LeRobotEpisode(item, writer).write()


def _declaration(source: Path, notices: list[str]) -> Declaration | None:
    try:
        return read_declaration(source)
    except SourceError as error:
        notices.append(f"what exUMI declared is not used: {error}")
        return None


class _Finder:
    """Makes items of the rows of the table of episodes."""

    def __init__(
        self,
        root: Path,
        info: Info,
        mapped: FeatureMap,
        declaration: Declaration | None,
        options: ConvertOptions,
    ) -> None:
        self._root = root
        self._info = info
        self._mapped = mapped
        self._options = options
        self._declaration = declaration
        self._tasks = read_tasks(root)
        self._sizes: dict[str, int] = {}
        self._used: dict[str, int] = {}
        self.failed: list[Failure] = []
        self.total = 0

    def items(self, rows: Sequence[EpisodeRow]) -> Iterator[EpisodeSource]:
        """Yield an item for each episode that can be read; note the others as failed."""
        self.total = len(rows)
        named = {row.index: self._files(row) for row in rows}
        wrong = self._faults(rows)
        for files in named.values():
            for name in files.values() if isinstance(files, dict) else ():
                self._used[name] = self._used.get(name, 0) + 1
        seen = set()
        for row in sorted(rows, key=lambda row: row.index):
            key = f"episode_{row.index:06d}"
            files = named[row.index]
            why = wrong.get(row.index) or (files if isinstance(files, str) else None)
            if why is None and isinstance(files, dict):
                yield self._item(key, row, files)
            elif row.index not in seen:
                self.failed.append(Failure(key, why or ""))
            seen.add(row.index)

    def _files(self, row: EpisodeRow) -> dict[str, str] | str:
        """Return the files of an episode by feature (rows: an empty name), else what is missing."""
        try:
            found = {"": file_name(self._info.data_path, *row.data)}
            for key in row.videos:
                if self._info.video_path is None:
                    return "info.json names no video_path"
                chunk, file, _ = row.videos[key]
                found[key] = file_name(self._info.video_path, chunk, file, key)
        except SourceError as error:
            return str(error)
        missing = [name for name in found.values() if not (self._root / name).is_file()]
        return f"{missing[0]} is missing" if missing else found

    def _faults(self, rows: Sequence[EpisodeRow]) -> dict[int, str]:
        """Find episodes that the table itself shows to be wrong, as after a merge that failed."""
        found: dict[int, str] = {}
        counted = Counter(row.index for row in rows)
        for row in rows:
            if counted[row.index] > 1:
                found[row.index] = f"{counted[row.index]} rows of the table bear its number"
            elif row.index < 0 or row.length < 1:
                found[row.index] = f"the table gives it {row.length} frames"
            elif row.stop - row.first != row.length:
                found[row.index] = (
                    f"the table gives it {row.length} frames and rows {row.first} to {row.stop}"
                )
            elif not all(0 <= begin <= _LATEST_S for _, _, begin in row.videos.values()):
                found[row.index] = "the table gives no time at which it begins in its videos"
        for key in self._info.features:
            found.update(self._overlaps(rows, key))
        return found

    def _overlaps(self, rows: Sequence[EpisodeRow], key: str) -> Iterator[tuple[int, str]]:
        half = 0.5 / float(self._info.rate)
        places = sorted(
            (*row.videos[key], row.index, row.length) for row in rows if key in row.videos
        )
        for before, after in pairwise(places):
            end = before[2] + before[4] / float(self._info.rate)
            if before[:2] == after[:2] and after[2] < end - half:
                why = (
                    f"episodes {before[3]} and {after[3]} claim the same frames of file "
                    f"{before[1]} of {key}: one of them has the wrong pictures"
                )
                yield before[3], why
                yield after[3], why

    def _item(self, key: str, row: EpisodeRow, files: dict[str, str]) -> EpisodeSource:
        names = list(dict.fromkeys(files.values()))
        text = (row.tasks or (self._options.task,))[0].strip()
        pad = self._options.pad_type
        return EpisodeSource(
            key=key,
            files=tuple(SourceFile(self._root / name, name) for name in names),
            task=Task(name=label(text), instruction=text),
            licence=self._licence(),
            annotations=None if pad is None else Annotations(pad_type=pad),
            regime=(self._declaration and self._declaration.regime) or "demonstration",
            settings={
                "episode": row.index,
                "length": row.length,
                "first": row.first,
                "fps": format_rate(self._info.rate),
                "robot_type": self._info.robot_type,
                "sensor": self._options.sensor,
                "tasks": self._texts(row),
                "rows": files[""],
                "videos": {
                    image.feature: {
                        "file": files[image.feature],
                        "begin_s": row.videos[image.feature][2],
                        "alone": self._used[files[image.feature]] == 1,
                    }
                    for image in self._mapped.images
                    if image.feature in row.videos
                },
                "map": self._mapped.as_json(),
            },
            estimated_bytes=self._share(names),
        )

    def _licence(self) -> str:
        given = self._options.licence
        if given == UNKNOWN_LICENCE and self._declaration is not None:
            return self._declaration.licence
        return given

    def _texts(self, row: EpisodeRow) -> dict[str, str]:
        """Return the texts of an episode's tasks by their numbers, where it has several."""
        if len(row.tasks) < 2:
            return {}
        return {str(number): text for number, text in self._tasks.items() if text in row.tasks}

    def _share(self, names: Sequence[str]) -> int:
        """Return an episode's part of the files that it shares."""
        return sum(self._size(name) // self._used[name] for name in names)

    def _size(self, name: str) -> int:
        if name not in self._sizes:
            self._sizes[name] = (self._root / name).stat().st_size
        return self._sizes[name]

    def notices(self) -> Iterator[str]:
        """Say what does not fit together, and which files nobody asked for."""
        said = self._info.total_episodes
        if said is not None and said != self.total:
            yield f"{INFO} says {said} episodes, the table has {self.total}"
        used = set(self._used)
        other = [
            path
            for path in source_files(self._root)
            if not (name := relative_name(path, self._root)).startswith(_META)
            and name not in used
            and name not in _BESIDE
        ]
        if other:
            yield count_names("file(s) that no episode uses, not read", self._root, other)
        if not self._tasks:
            yield "the table of tasks is empty"
