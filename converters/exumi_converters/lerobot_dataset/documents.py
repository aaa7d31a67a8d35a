"""What a LeRobotDataset says of itself: ``info.json``, tasks, episodes, and our own file."""

import json
import re
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path, PurePosixPath
from typing import Annotated, Any, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from exumi_converters.lerobot_dataset.layout import (
    DATA_PATH,
    DECLARATION,
    EPISODES_FOLDER,
    INFO,
    TASKS,
    VIDEO_PATH,
    Declaration,
    fps_of,
)
from exumi_converters.lerobot_dataset.parquet_files import (
    numbers_of,
    open_parquet,
    read_columns,
    texts_of,
)
from exumi_data.errors import SourceError
from exumi_data.model.json_limits import is_too_deep, size_mistake

__all__ = [
    "EpisodeRow",
    "Feature",
    "Info",
    "episode_tables",
    "file_name",
    "is_dataset",
    "read_declaration",
    "read_episodes",
    "read_info",
    "read_tasks",
]

_MAX_BYTES = 16 << 20
_MAX_EPISODES = 1_000_000
_MOST_NUMBERS = 1_000_000  # of a feature
_PLACE = re.compile(r"\{(?P<name>video_key|chunk_index|file_index)(?::0(?P<digits>[1-9])d)?\}")
_UPGRADE = (
    "Let LeRobot bring it up to v3.0 first: "
    "python -m lerobot.datasets.v30.convert_dataset_v21_to_v30 --repo-id=..."
)

Document = TypeVar("Document", bound=BaseModel)


class Feature(BaseModel):
    """One feature of ``info.json``."""

    model_config = ConfigDict(extra="ignore")

    dtype: str
    shape: list[Annotated[int, Field(ge=0, le=_MOST_NUMBERS)]]
    names: Any = None
    info: dict[str, Any] | None = None

    @property
    def is_image(self) -> bool:
        """Whether it holds pictures."""
        return self.dtype in {"video", "image"}

    @property
    def is_depth(self) -> bool:
        """Whether its pictures are distances, coded as colours."""
        said = self.info or {}
        return bool(said.get("video.is_depth_map") or said.get("is_depth_map"))

    def labels(self) -> list[str] | None:
        """Return a name for each of its numbers; None where there are none, or not as many."""
        found: Any = self.names
        if isinstance(found, dict):  # such as {"motors": [...]}
            parts = list(found.values())
            found = parts[0] if len(parts) == 1 else None
        count = self.shape[0] if len(self.shape) == 1 else -1
        if not isinstance(found, list) or len(found) != count:
            return None
        return found if all(isinstance(name, str) for name in found) else None


class Info(BaseModel):
    """What is read of ``info.json``."""

    model_config = ConfigDict(extra="ignore")

    codebase_version: str
    fps: Annotated[float, Field(ge=0.001, le=100_000, allow_inf_nan=False)]
    features: dict[str, Feature]
    data_path: str = DATA_PATH
    video_path: str | None = VIDEO_PATH
    robot_type: str | None = None
    total_episodes: int | None = None
    total_frames: int | None = None

    @property
    def rate(self) -> Fraction:
        """Frames a second."""
        return fps_of(self.fps)

    def of_images(self) -> dict[str, Feature]:
        """Return the features that hold pictures."""
        return {key: feature for key, feature in self.features.items() if feature.is_image}


@dataclass(frozen=True, slots=True)
class EpisodeRow:
    """One row of the table of episodes.

    Attributes
    ----------
    index, length : int
    tasks : tuple of str
    first, stop : int
        Its rows in the whole dataset, as the table says.
    data : (int, int)
        Chunk and file of its rows.
    videos : dict of str to (int, int, float)
        Chunk, file and begin (s) of each video.
    """

    index: int
    length: int
    tasks: tuple[str, ...]
    first: int
    stop: int
    data: tuple[int, int]
    videos: dict[str, tuple[int, int, float]] = field(default_factory=dict)


def is_dataset(source: Path) -> bool:
    """Whether a folder says that it is a LeRobotDataset, of whatever version."""
    try:
        document = json.loads(_read(source / INFO))
    except (OSError, ValueError, SourceError, RecursionError):
        return False
    return isinstance(document, dict) and {"codebase_version", "features"} <= set(document)


def _read(path: Path) -> bytes:
    # Links are followed: in the cache of the Hugging Face Hub all files are links.
    with path.open("rb") as file:
        raw = file.read(_MAX_BYTES + 1)
    if len(raw) > _MAX_BYTES:
        raise SourceError(f"has more than {_MAX_BYTES:,} bytes", where=path)
    return raw


def _parse(path: Path, model: type[Document]) -> Document:
    try:
        raw = _read(path)
        mistake = size_mistake(raw)
        value = None if mistake else json.loads(raw)
        if mistake or is_too_deep(value, raw):
            raise SourceError(mistake or "is nested too deeply", where=path)
        json.dumps(value, ensure_ascii=False).encode()  # half characters cannot be kept
        return model.model_validate(value)
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
    except ValidationError as error:
        first = error.errors()[0]
        name = ".".join(str(part) for part in first["loc"])
        raise SourceError(f"{name or 'it'}: {first['msg']}", where=path) from None
    except (ValueError, RecursionError) as error:
        raise SourceError(f"is no JSON ({error})", where=path) from None


def read_info(root: Path) -> Info:
    """Read ``info.json``.

    Raises
    ------
    SourceError
        It is damaged, or of another version than v3.
    """
    info = _parse(root / INFO, Info)
    if not re.fullmatch(r"v?3\.\d{1,4}", info.codebase_version):
        raise SourceError(
            f"is of version {info.codebase_version!r}; v3.0 is read", where=root, fix=_UPGRADE
        )
    return info


def read_declaration(root: Path) -> Declaration | None:
    """Read what our exporter declared; None where somebody else wrote the dataset.

    Raises
    ------
    SourceError
        It is damaged.
    """
    path = root / DECLARATION
    return _parse(path, Declaration) if path.is_file() else None


def read_tasks(root: Path) -> dict[int, str]:
    """Read the tasks by their numbers: a column, or the index of a pandas table, holds the texts.

    Raises
    ------
    SourceError
    """
    path = root / TASKS
    with open_parquet(path) as file:
        texts = [name for name in file.schema_arrow.names if name != "task_index"]
    preferred = [name for name in ("task", "__index_level_0__", *texts) if name in texts]
    if not preferred:
        raise SourceError("holds no texts of tasks", where=path)
    table = read_columns(path, ["task_index", preferred[0]])
    numbers = numbers_of(table, "task_index", path).tolist()
    said = texts_of(table, preferred[0], path)
    return {int(number): text for number, text in zip(numbers, said, strict=True) if _is_text(text)}


def _is_text(value: object) -> bool:
    return isinstance(value, str) and bool(value.strip())


def episode_tables(root: Path) -> list[Path]:
    """Return the files of the table of episodes, in their order."""
    return sorted((root / EPISODES_FOLDER).glob("*/*.parquet"))


def read_episodes(root: Path, info: Info) -> list[EpisodeRow]:
    """Read the table of episodes.

    Raises
    ------
    SourceError
        It is missing or damaged.
    """
    paths = episode_tables(root)
    if not paths:
        raise SourceError("there is no table of episodes", where=root / EPISODES_FOLDER)
    videos = [key for key, feature in info.features.items() if feature.dtype == "video"]
    rows: list[EpisodeRow] = []
    for path in paths:
        rows += _episode_rows(path, videos)
        if len(rows) > _MAX_EPISODES:
            raise SourceError(f"more than {_MAX_EPISODES:,} episodes", where=root)
    return rows


def _episode_rows(path: Path, videos: list[str]) -> list[EpisodeRow]:
    whole = ["episode_index", "length", "data/chunk_index", "data/file_index"]
    whole += ["dataset_from_index", "dataset_to_index"]
    for key in videos:
        whole += [f"videos/{key}/chunk_index", f"videos/{key}/file_index"]
    begins = [f"videos/{key}/from_timestamp" for key in videos]
    table = read_columns(path, [*whole, *begins, "tasks"])
    columns = {name: numbers_of(table, name, path).tolist() for name in (*whole, *begins)}
    for name in whole:
        if not all(isinstance(value, int) for value in columns[name]):
            raise SourceError(f"{name!r} holds what is no whole number", where=path)
    tasks = texts_of(table, "tasks", path)
    found = []
    for row in range(table.num_rows):
        at = {name: values[row] for name, values in columns.items()}
        said = tasks[row] if isinstance(tasks[row], list) else [tasks[row]]
        found.append(
            EpisodeRow(
                index=int(at["episode_index"]),
                length=int(at["length"]),
                tasks=tuple(text for text in said if _is_text(text)),
                first=int(at["dataset_from_index"]),
                stop=int(at["dataset_to_index"]),
                data=(int(at["data/chunk_index"]), int(at["data/file_index"])),
                videos={
                    key: (
                        int(at[f"videos/{key}/chunk_index"]),
                        int(at[f"videos/{key}/file_index"]),
                        float(at[f"videos/{key}/from_timestamp"]),
                    )
                    for key in videos
                },
            )
        )
    return found


def file_name(template: str, chunk: int, file: int, video: str = "") -> str:
    """Return the name that a template of ``info.json`` stands for, within the dataset.

    Raises
    ------
    SourceError
        It leads out of the dataset, or is no such template.
    """
    numbers = {"chunk_index": chunk, "file_index": file}

    def fill(match: re.Match[str]) -> str:
        if match["name"] not in numbers:
            return video
        return f"{numbers[match['name']]:0{match['digits'] or 1}d}"

    name = _PLACE.sub(fill, template)
    parts = PurePosixPath(name).parts
    hostile = "{" in _PLACE.sub("", template) or "\0" in name or "\\" in name
    if hostile or not parts or name.startswith("/") or ".." in parts:
        raise SourceError(f"a path of info.json leads out of the dataset ({name!r})")
    return name
