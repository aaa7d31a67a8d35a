"""Episodes become a training set: the same format, frames resized once, provenance kept."""

import hashlib
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from exumi_converters.conversion import TOOL
from exumi_converters.destination import write_splits
from exumi_converters.identity import episode_id, settings_digest
from exumi_converters.prepare_settings import DEFAULT_FOV_DEG, PrepareSettings
from exumi_converters.prepared_episode import derived_afterwards, write_prepared
from exumi_converters.report import PrepareReport, Progress
from exumi_converters.run import Done, Run, attempt, make_episode, opened_run
from exumi_data import __version__
from exumi_data.catalog import list_episodes, read_catalog
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.engine import Engine, warm_up
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.model import (
    UNKNOWN_LICENCE,
    DatasetMetadata,
    EpisodeMetadata,
    MadeBy,
    Source,
    SplitDocument,
)
from exumi_data.model.documents import parse_dataset, parse_split
from exumi_data.store.digest import digest_of

__all__ = ["prepare"]

_CONVERTER = "prepare/1"
_ID_SCHEME = "prepare/1"
_SIZES = range(8, 4097)
_QUALITIES = range(1, 101)
_TACTILE = ("separate", "combined")
_RGB = ("resize", "rectify")
_LEAST_FOV_DEG, _MOST_FOV_DEG = 1.0, 170.0
_MOST_APART_S = 10.0


@dataclass(frozen=True, slots=True)
class _Parent:
    """An episode to prepare.

    Attributes
    ----------
    name : str
        Its id, or the file's name.
    path : str
    root_sha256, digest : str or None
        As the catalog says: the digest is taken from there if the root document is that one.
    """

    name: str
    path: str
    root_sha256: str | None = None
    digest: str | None = None


def prepare(  # noqa: PLR0913  # options, all by keyword
    source: str | Path,
    destination: str | Path,
    *,
    size: int = 224,
    gray: bool = False,
    quality: int = 95,
    lossless: bool = False,
    tactile: Literal["separate", "combined"] = "separate",
    rgb: Literal["resize", "rectify"] = "resize",
    fov_deg: float = DEFAULT_FOV_DEG,
    pair_within_s: float | None = None,
    workers: int | None = None,
    engine: Engine | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> PrepareReport:
    """Make a training set of native episodes, in the same format.

    Frames of all image streams are resized to squares and stored as JPEG; reference images go
    through the same steps. Where an episode holds a rectification map of a tactile sensor
    (`exumi_data.calibration`), its frames are rectified and cropped by it first. Activity is
    measured where there is none, or where frames are rectified; otherwise it, salient frames,
    labels and every other stream are carried along as they are. Calibration is changed as the
    images are. Each step at which something is lost is named in the episode. A second run skips
    what is complete, and makes again what has changed.

    Parameters
    ----------
    source : path-like
        A dataset, or one episode.
    destination : path-like
        The training set: a new or empty folder, or one that an earlier run has made.
    size : int
        Edge of the frames, pixels, 8 to 4096.
    gray : bool
        Keep only the luma of tactile streams.
    quality : int
        Of the JPEGs, 1 to 100.
    lossless : bool
        Store resized pixels without loss instead (`quality` plays no part).
    tactile : {"separate", "combined"}
        ``combined``: one stream ``<name>_combined`` takes the place of ``<name>_left`` and
        ``<name>_right``. The left finger's frames are turned left by 90 degrees, the right one's
        right, and stand side by side; each left frame is paired with the nearest right frame.
        Activity is that of the combined image, its threshold 5e-4.
    rgb : {"resize", "rectify"}
        ``rectify``: camera frames lose the distortion that the stored intrinsics describe.
    fov_deg : float
        Field of view of rectified camera frames across and down, degrees.
    pair_within_s : float, optional
        How far apart the frames of two fingers may be, seconds; left frames without a right one
        are dropped and counted. Default: the right finger's median frame interval.
    workers : int, optional
        Processes; default all cores.
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_progress : callable, optional
        Called after each episode.

    Returns
    -------
    PrepareReport
        Failures are in it: everything else is prepared nevertheless.

    Raises
    ------
    UsageError, NotAnEpisodeError
        An option, the source or the destination makes no sense as a whole.
    """
    began = time.perf_counter()
    settings = _settings(
        size=size,
        gray=gray,
        quality=None if lossless else quality,
        tactile=tactile,
        rgb=rgb,
        fov_deg=fov_deg,
        pair_within_s=pair_within_s,
    )
    source, destination = Path(source), Path(destination)
    if destination.exists() and source.resolve() == destination.resolve():
        raise UsageError(
            "source and destination are the same", where=source, fix="Name another destination."
        )
    warm_up(__name__, workers=workers, engine=engine)
    parents = _find_parents(source)
    splits = _read_splits(source)
    metadata = _dataset_metadata(source, destination, settings)
    _refuse_other_settings(destination, settings)
    with opened_run(destination, metadata, workers, on_progress, began, engine=engine) as run:
        function = partial(_prepare_one, root=run.root, settings=settings)
        run.work(function, parents, _name)
        _write_splits(run, splits)
        unexplained = run.finish()
        return PrepareReport(
            source=str(source),
            destination=str(destination),
            total=run.converted + run.skipped + len(run.failed),
            converted=run.converted,
            skipped=run.skipped,
            flagged=tuple(run.flagged),
            failed=tuple(run.failed),
            notices=tuple(run.notices),
            unexplained=unexplained,
            frames=run.frames,
            seconds=run.seconds,
            settings=settings.to_json(),
        )


def _settings(
    *,
    size: int,
    gray: bool,
    quality: int | None,
    tactile: Literal["separate", "combined"],
    rgb: Literal["resize", "rectify"],
    fov_deg: float,
    pair_within_s: float | None,
) -> PrepareSettings:
    if size not in _SIZES:
        raise UsageError(f"Invalid size ({size}). Supported values are 8 to 4096 pixels")
    if quality is not None and quality not in _QUALITIES:
        raise UsageError(f"Invalid quality ({quality}). Supported values are 1 to 100")
    for name, value, known in (("tactile", tactile, _TACTILE), ("rgb", rgb, _RGB)):
        if value not in known:
            raise UsageError(
                f"Invalid {name} ({value!r}). Supported values are {' and '.join(known)}"
            )
    if not _LEAST_FOV_DEG <= fov_deg <= _MOST_FOV_DEG:
        raise UsageError(
            f"Invalid fov_deg ({fov_deg}). Supported values are {_LEAST_FOV_DEG:g} to "
            f"{_MOST_FOV_DEG:g} degrees"
        )
    if pair_within_s is not None and not 0 <= pair_within_s <= _MOST_APART_S:
        raise UsageError(
            f"Invalid pair_within_s ({pair_within_s}). Supported values are 0 to "
            f"{_MOST_APART_S:g} seconds"
        )
    return PrepareSettings(
        size=size,
        gray=gray,
        quality=quality,
        tactile=tactile,
        rgb=rgb,
        fov_deg=float(fov_deg),
        pair_within_ns=None if pair_within_s is None else round(pair_within_s * 1e9),
    )


def _refuse_other_settings(destination: Path, settings: PrepareSettings) -> None:
    """Keep one training set to one sort of frames: every clip would be in it twice."""
    document = destination / DATASET_DOCUMENT
    if not document.is_file():
        return
    made_by = parse_dataset(document.read_bytes(), document).made_by
    found = (made_by.settings if made_by else None) or {}
    wanted: dict[str, Any] = {"converter": _CONVERTER, **settings.to_json()}
    if found.get("converter") == _CONVERTER and found != wanted:
        differing = [key for key in {**wanted, **found} if found.get(key) != wanted.get(key)]
        said = ", ".join(f"{key} {found.get(key)} (now {wanted.get(key)})" for key in differing)
        raise UsageError(
            f"was prepared with other settings: {said}",
            where=destination,
            fix="Name another folder, or remove this one first.",
        )


def _name(parent: _Parent) -> str:
    return parent.name


def _is_dataset(source: Path) -> bool:
    return (source / DATASET_DOCUMENT).is_file()


def _find_parents(source: Path) -> list[_Parent]:
    if not _is_dataset(source):
        if not source.is_file() and not (source / "zarr.json").is_file():
            raise NotAnEpisodeError(
                "neither a dataset (no dataset.json) nor an episode (no zarr.json)",
                where=source,
                fix="Convert other data first, with: exumi convert SRC DST",
            )
        return [_Parent(source.name, str(source))]
    table = read_catalog(source)
    rows = {} if table is None else {row["path"]: row for row in table.to_pylist()}
    parents = []
    for path in list_episodes(source):
        row = rows.get(path, {})
        parents.append(
            _Parent(
                Path(path).name.partition(".")[0],
                str(source / path),
                row.get("root_sha256"),
                row.get("digest"),
            )
        )
    return parents


def _dataset_metadata(
    source: Path, destination: Path, settings: PrepareSettings
) -> DatasetMetadata:
    made_by = MadeBy(
        tool=TOOL,
        tool_version=__version__,
        settings={"converter": _CONVERTER, **settings.to_json()},
    )
    name = destination.resolve().name
    if not _is_dataset(source):
        with open_episode(source) as episode:
            licence = episode.metadata.licence or UNKNOWN_LICENCE
        return DatasetMetadata(name=name, licence=licence, made_by=made_by)
    document = source / DATASET_DOCUMENT
    parent = parse_dataset(document.read_bytes(), document)
    # A copy: what describes the data stays, and so do keys that we do not know.
    metadata = parent.model_copy(deep=True)
    metadata.name, metadata.made_by, metadata.splits = name, made_by, []
    return metadata


def _read_splits(source: Path) -> list[SplitDocument]:
    if not _is_dataset(source):
        return []
    document = source / DATASET_DOCUMENT
    names = parse_dataset(document.read_bytes(), document).splits
    paths = [source / "splits" / f"{name}.json" for name in names]
    return [parse_split(path.read_bytes(), path) for path in paths if path.is_file()]


def _write_splits(run: Run[_Parent], splits: Sequence[SplitDocument]) -> None:
    """Write the parent's splits with the ids of the prepared episodes."""
    lists = {
        split.name: {
            name: [run.ids[episode] for episode in ids if episode in run.ids]
            for name, ids in split.lists.items()
        }
        for split in splits
    }
    write_splits(run.root, splits, lists)


def _prepare_one(item: _Parent, *, root: Path, settings: PrepareSettings) -> Done:
    """Prepare one episode; runs in a worker."""
    opened: list[Episode] = []

    def describe() -> EpisodeMetadata:
        parent = open_episode(item.path)
        opened.append(parent)
        parent.check_complete()
        return _metadata(parent, item, settings)

    def make(metadata: EpisodeMetadata) -> Done:
        parent = opened[0]
        return make_episode(
            root,
            item.name,
            metadata,
            lambda writer: write_prepared(parent, writer, settings),
            durable=True,
            derived=derived_afterwards(parent, settings),
        )

    try:
        return attempt(item.name, describe, make)
    finally:
        for parent in opened:
            parent.close()


def _metadata(parent: Episode, item: _Parent, settings: PrepareSettings) -> EpisodeMetadata:
    own = settings.to_json()
    metadata = parent.metadata.model_copy(deep=True)
    metadata.id = episode_id(_ID_SCHEME, settings_digest(own), parent.id)
    metadata.revision = 1
    metadata.streams = {}
    # Derived arrays are outside the digest, and are carried along: they count as well.
    derived = digest_of(parent.store, derived=True) if parent.derived else None
    own["parent_source_type"] = parent.metadata.source.type
    own["parent_derived"] = derived
    metadata.source = Source(
        type="converted",
        tool=TOOL,
        tool_version=__version__,
        converter=_CONVERTER,
        key=parent.id,
        settings=own,
        settings_sha256=settings_digest(own),
        lossy=list(parent.metadata.source.lossy or []),
        parent_id=parent.id,
        parent_digest=_digest(parent, item),
    )
    return metadata


def _digest(parent: Episode, item: _Parent) -> str:
    root = hashlib.sha256(parent.store.read("zarr.json")).hexdigest()
    known = item.digest if root == item.root_sha256 else None
    return known or parent.digest()
