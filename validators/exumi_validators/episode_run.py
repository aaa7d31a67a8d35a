"""Validating one episode: in this process or in another."""

from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from types import ModuleType
from typing import Any

from exumi_data.errors import ExumiError
from exumi_data.model.description import Annotations
from exumi_data.standard import LEVELS, Level
from exumi_data.store.access import FolderStore, ZipStore
from exumi_data.store.digest import digest_of
from exumi_validators.archive import ArchiveContext, read_archive
from exumi_validators.checks import (
    arrays,
    calibration,
    chunks,
    derived,
    document,
    hierarchy,
    images,
    labels,
    motion,
    packing,
    root,
    streams,
    sync,
    time,
    timing,
    touch,
    video,
)
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import Collector
from exumi_validators.listing import Listing, list_folder, list_zip
from exumi_validators.registry import Check, checks_of
from exumi_validators.report import Problem, Skipped, Unchecked

__all__ = [
    "EpisodeFacts",
    "EpisodeResult",
    "archive_checks",
    "episode_checks",
    "root_checks",
    "validate_episode",
]

_EPISODE_MODULES: tuple[ModuleType, ...] = (
    document,
    streams,
    hierarchy,
    arrays,
    time,
    images,
    video,
    derived,
    chunks,
    timing,
    motion,
    calibration,
    labels,
    touch,
    sync,
)
# What ZipStore refuses to open.
_UNOPENABLE = frozenset(
    ("PACK-001", "PACK-002", "PACK-003", "PACK-004", "PACK-007", "SAFE-001", "SAFE-002")
)


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeFacts:
    """What a dataset needs to know of an episode, as far as it can be known."""

    id: str | None = None
    revision: int | None = None
    root_sha256: str | None = None
    digest: str | None = None
    object_id: str | None = None
    part_id: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """Problems of one episode, and how much was looked at."""

    problems: tuple[Problem, ...]
    not_listed: dict[str, int] = field(default_factory=dict)
    unchecked: tuple[Unchecked, ...] = ()
    skipped: tuple[Skipped, ...] = ()
    facts: EpisodeFacts = EpisodeFacts()
    streams: int = 0
    arrays: int = 0
    samples: int = 0
    frames: int = 0


@cache
def archive_checks() -> tuple[Check[ArchiveContext], ...]:
    """Return the checks of packed episodes."""
    return checks_of((packing,))


@cache
def root_checks() -> tuple[Check[EpisodeContext], ...]:
    """Return the checks without which nothing else can be judged."""
    return checks_of((root,))


@cache
def episode_checks() -> tuple[Check[EpisodeContext], ...]:
    """Return all other checks of episodes, the cheap levels first."""
    found: tuple[Check[EpisodeContext], ...] = checks_of(_EPISODE_MODULES)
    return tuple(sorted(found, key=lambda check: LEVELS.index(check.level)))


def validate_episode(
    path: str, levels: frozenset[Level], *, with_digest: bool = False
) -> EpisodeResult:
    """Validate one episode; never raises for what is in it.

    Parameters
    ----------
    path : str
        Folder or zip.
    levels : frozenset of str
    with_digest : bool
        Compute the episode's digest, which a catalog is compared with.

    Returns
    -------
    EpisodeResult
        Locations are relative to the episode.

    Raises
    ------
    OSError
        The file itself cannot be opened.
    """
    found = Collector()
    unchecked: list[Unchecked] = []
    store: FolderStore | ZipStore
    if Path(path).is_file():
        archive = read_archive(path)
        _judge(archive_checks(), archive, levels, found, unchecked)
        # Which rules were asked for does not change what can be opened.
        if _is_unopenable(archive):
            return _result(found, unchecked, None, levels)
        try:
            archive_store = store = ZipStore(path)
        except ExumiError as error:
            unchecked.append(Unchecked(".", "opening the zip", error.what))
            return _result(found, unchecked, None, levels)
        episode = EpisodeContext(store, list_zip(archive_store))
    else:
        store = FolderStore(path)
        listing = list_folder(path)
        episode = EpisodeContext(store, listing)
        unchecked += [Unchecked(*item) for item in _closed(listing)]
    try:
        _judge(root_checks(), episode, levels, found, unchecked)
        if episode.judgeable:
            _judge(episode_checks(), episode, levels, found, unchecked)
        result = _result(found, unchecked, episode, levels)
        return _with_digest(result, episode) if with_digest else result
    finally:
        store.close()


def _closed(listing: Listing) -> list[tuple[str, str, str]]:
    """Folders that cannot be looked into: (path, what, reason)."""
    return [(path, "the folder", why) for path, why in sorted(listing.closed.items())]


def _with_digest(result: EpisodeResult, episode: EpisodeContext) -> EpisodeResult:
    if episode.listing.links or episode.listing.unsafe or not episode.judgeable:
        return result
    try:
        return replace(result, facts=replace(result.facts, digest=digest_of(episode.store)))
    except (ExumiError, OSError):
        return result  # bytes that cannot be read are the matter of other rules


def _is_unopenable(archive: ArchiveContext) -> bool:
    telling = (check for check in archive_checks() if _UNOPENABLE.intersection(check.rules))
    return any(True for check in telling for _ in check(archive))


def _judge(
    checks: tuple[Check[Any], ...],
    context: Any,
    levels: frozenset[Level],
    found: Collector,
    unchecked: list[Unchecked],
) -> None:
    for check in checks:
        if check.level not in levels:
            continue
        try:
            for problem in check(context):
                found.add(problem)
        except Exception as error:  # noqa: BLE001  # a check that fails must not hide the others
            reason = f"{type(error).__name__}: {error}"
            unchecked.append(Unchecked(".", ", ".join(check.rules), reason[:500]))


def _result(
    found: Collector,
    unchecked: list[Unchecked],
    episode: EpisodeContext | None,
    levels: frozenset[Level],
) -> EpisodeResult:
    result = EpisodeResult(
        problems=found.problems,
        not_listed=dict(found.not_listed),
        unchecked=tuple(unchecked),
        skipped=found.skipped,
    )
    if episode is None or not episode.judgeable:
        return result
    deep = bool(levels & {"arrays", "data"})
    counts = [episode.count(name) for name in episode.streams] if deep else []
    return replace(
        result,
        facts=_facts(episode),
        streams=len(episode.streams),
        arrays=len(episode.array_nodes),
        samples=sum(count for count in counts if count is not None),
        frames=episode.frames,
    )


def _facts(episode: EpisodeContext) -> EpisodeFacts:
    notes: Annotations | None = episode.section("annotations")
    return EpisodeFacts(
        id=episode.section("id"),
        revision=episode.section("revision"),
        root_sha256=episode.root_sha256(),
        object_id=notes.object_id if notes else None,
        part_id=notes.part_id if notes else None,
    )
