"""Which layout a file has, and the episodes in it. Reads names, shapes and attributes only."""

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal

import numpy as np

from exumi_converters.hdf5_files.contents import (
    Contents,
    blocks,
    child,
    count_numbers,
    damage_named,
    opened,
    read_whole,
    walk,
)
from exumi_converters.names import one_line
from exumi_data.errors import ExumiError, SourceError
from exumi_data.model.documents import load_json

if TYPE_CHECKING:
    import h5py

__all__ = [
    "OBSERVATIONS",
    "Demonstration",
    "Found",
    "Hdf5Members",
    "demonstrations",
    "group_of",
    "is_image",
    "layout_of",
]

Layout = Literal["robomimic", "freetacman"]
OBSERVATIONS = {"robomimic": "obs/", "freetacman": "observations/"}
"""Where the observations of an episode are."""

_DEMO = re.compile(r"demo_(\d{1,9})")
_COLOURS = (1, 3)
_LONGEST_NAME = 256


@dataclass(frozen=True, slots=True)
class Demonstration:
    """One episode of a file.

    Attributes
    ----------
    path : pathlib.Path
    group : str
        Where it is in the file; empty for the whole file.
    number : int
    layout : {"robomimic", "freetacman"}
    images : tuple of str
        Keys of its images.
    stored_bytes : int
        How much of the file it takes.
    rate : str or None
        As the file states it, a rational number.
    task : str or None
    split : str or None
        Mask of robomimic that it is in.
    """

    path: Path
    group: str
    number: int
    layout: Layout
    images: tuple[str, ...]
    stored_bytes: int
    rate: str | None = None
    task: str | None = None
    split: str | None = None


@dataclass(slots=True)
class Found:
    """What a file holds.

    Attributes
    ----------
    layout : {"robomimic", "freetacman"}
    episodes : list of Demonstration
    failed : list of (str, str)
        What cannot be one: its name in the file, and why.
    notices : list of str
    """

    layout: Layout
    episodes: list[Demonstration] = field(default_factory=list)
    failed: list[tuple[str, str]] = field(default_factory=list)
    notices: list[str] = field(default_factory=list)


@dataclass(frozen=True, slots=True)
class Hdf5Members:
    """The numbers of one episode, block by block: what its id is made from."""

    path: Path
    group: str

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and bytes of each block of each dataset."""
        with opened(self.path) as file:
            for name, data in walk(group_of(file, self.group)).numbers.items():
                yield f"{name} {data.dtype.str} {data.shape}", b""
                for start, block in blocks(data):
                    yield f"{name}[{start}]", block.tobytes()


def group_of(file: "h5py.File", path: str) -> "h5py.Group":
    """Return the group of an episode.

    Raises
    ------
    SourceError
        It is not there any more.
    """
    import h5py

    at: object = file
    for name in filter(None, path.split("/")):
        at = child(at, name)
    if not isinstance(at, h5py.Group):
        raise SourceError(
            f"{path} is no group of this file (links are not followed)", where=file.filename
        )
    return at


def is_image(data: "h5py.Dataset") -> bool:
    """Whether a dataset holds images: (N, H, W, 1 or 3) uint8."""
    return bool(
        data.dtype == np.uint8
        and len(data.shape) == 4
        and data.shape[3] in _COLOURS
        and count_numbers(data)
    )


def layout_of(path: Path) -> Layout | None:
    """Recognise the layout of a file; None if it has none of the two."""
    with opened(path) as file:
        return _layout(file)


def _layout(file: "h5py.File") -> Layout | None:
    import h5py

    data = child(file, "data")
    images = child(child(file, "observations"), "images")
    with damage_named(Path(file.filename)):
        if isinstance(data, h5py.Group) and any(map(_DEMO.fullmatch, data)):
            return "robomimic"
        if isinstance(images, h5py.Group) and len(images) > 0:
            return "freetacman"
    return None


def demonstrations(path: Path) -> Found:
    """List the episodes of a file.

    Raises
    ------
    SourceError
        It is damaged, or has none of the layouts.
    """
    with opened(path) as file:
        layout = _layout(file)
        if layout is None:
            raise SourceError(
                "has neither robomimic's data/demo_<n> nor FreeTacMan's observations/images",
                where=path,
            )
        found = Found(layout)
        if layout == "robomimic":
            _add_robomimic(path, file, found)
        else:
            found.episodes.append(_demonstration(path, "", 0, layout, walk(file)))
    return found


def _demonstration(
    path: Path, group: str, number: int, layout: Layout, contents: Contents, **about: str | None
) -> Demonstration:
    prefix = OBSERVATIONS[layout]
    images = [
        key.removeprefix(prefix)
        for key, data in contents.numbers.items()
        if key.startswith(prefix) and is_image(data)
    ]
    with damage_named(path):
        size = sum(int(data.id.get_storage_size()) for data in contents.numbers.values())
    return Demonstration(path, group, number, layout, tuple(images), size, **about)


def _add_robomimic(path: Path, file: "h5py.File", found: Found) -> None:
    data = child(file, "data")
    with damage_named(path):
        about = _environment(data)
        names = [name for name in data if _DEMO.fullmatch(name)]  # type: ignore[union-attr]  # a group: its layout was recognised
    splits = _masks(file, found)
    known: set[int] = set()
    for name in sorted(names, key=lambda name: (int(name.removeprefix("demo_")), name)):
        number = int(name.removeprefix("demo_"))
        try:
            if number in known:
                raise SourceError(f"there are two demonstrations {number}", where=path)
            known.add(number)
            contents = walk(group_of(file, f"data/{name}"))
            if not any(key.startswith("obs/") for key in contents.numbers):
                raise SourceError(
                    "the demonstration holds no observations",
                    where=path,
                    fix="robomimic's dataset_states_to_obs.py makes them from the states.",
                )
            found.episodes.append(
                _demonstration(
                    path,
                    f"data/{name}",
                    number,
                    "robomimic",
                    contents,
                    rate=about.get("rate"),
                    task=about.get("task"),
                    split=splits.get(name),
                )
            )
        except ExumiError as error:
            found.failed.append((f"data/{name}", str(error)))


def _environment(data: Any) -> dict[str, str]:
    """Return task and control rate, as ``env_args`` says them."""
    said = data.attrs.get("env_args")
    if not isinstance(said, str | bytes):
        return {}
    raw = said.encode("utf-8", "replace") if isinstance(said, str) else said
    try:
        document = load_json(raw, "env_args")
    except ExumiError:
        return {}
    found: dict[str, str] = {}
    named = document.get("env_name")
    task = one_line(named) if isinstance(named, str) else None
    if task is not None:
        found["task"] = task
    arguments = document.get("env_kwargs")
    rate: Any = arguments.get("control_freq") if isinstance(arguments, dict) else None
    if isinstance(rate, bool):
        rate = None
    if isinstance(rate, int | float) and 0 < rate < 10_000 and float(rate).is_integer():  # Hz
        found["rate"] = f"{int(rate)}/1"
    return found


def _masks(file: "h5py.File", found: Found) -> dict[str, str]:
    """Return demonstration to the list it is in: train or valid."""
    import h5py

    masks = child(file, "mask")
    lists: dict[str, str] = {}
    for word, name in (("train", "train"), ("valid", "val")):
        entries = child(masks, word)
        if entries is None:
            continue
        # Only what robomimic writes: a list of short words. Objects are never built.
        if (
            not isinstance(entries, h5py.Dataset)
            or len(entries.shape or ()) != 1
            or entries.dtype.kind != "S"
            or not entries.dtype.itemsize <= _LONGEST_NAME
        ):
            found.notices.append(f"mask/{word} is no list of names, not read")
            continue
        try:
            names = read_whole(entries).tolist()
        except ExumiError as error:
            found.notices.append(f"mask/{word} is not read: {error.what}")
            continue
        lists |= {entry.decode("utf-8", "replace"): name for entry in names}
    return lists
