"""Validating one episode: in this process or in another."""

import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from functools import cache, partial
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from exumi_data.catalog import metadata_columns
from exumi_data.errors import ExumiError
from exumi_data.model.description import Annotations, Label
from exumi_data.standard import LEVELS, Level
from exumi_data.stopping import Stopped
from exumi_data.store.access import FolderStore, ZipStore
from exumi_data.store.digest import digest_of
from exumi_validators.archive import ArchiveContext, read_archive
from exumi_validators.checks import (
    arrays,
    calibration,
    chunks,
    clocks,
    coverage,
    derived,
    document,
    hierarchy,
    images,
    labels,
    motion,
    packing,
    root,
    sound,
    streams,
    sync,
    time,
    timing,
    touch,
    video,
)
from exumi_validators.config import Config
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import Collector, show
from exumi_validators.listing import Listing, list_folder, list_zip
from exumi_validators.plugins import installed
from exumi_validators.registry import Check, checks_of, reason_of
from exumi_validators.report import Problem, Skipped, Unchecked
from exumi_validators.touch_measures import coarse

__all__ = [
    "EpisodeFacts",
    "EpisodeResult",
    "LabelFact",
    "ReferenceFacts",
    "archive_checks",
    "episode_checks",
    "in_brief",
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
    coverage,
    sound,
    timing,
    clocks,
    motion,
    calibration,
    labels,
    touch,
    sync,
)
# Of one episode: more than anybody writes.
_MOST_LETTERS = 100
_MOST_LABELS = 100
# What ZipStore refuses to open.
_UNOPENABLE = frozenset(
    ("PACK-001", "PACK-002", "PACK-003", "PACK-004", "PACK-007", "SAFE-001", "SAFE-002")
)


class LabelFact(NamedTuple):
    """What a label says, in words; all labels of all episodes are in memory at once."""

    property: str
    source: str
    value: str


@dataclass(frozen=True, slots=True, kw_only=True)
class ReferenceFacts:
    """The reference of a tactile stream whose sensor is known by its serial number."""

    stream: str
    model: str
    serial: str
    coarse: bytes
    """See `exumi_validators.touch_measures.coarse`."""


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeFacts:
    """What a dataset needs to know of an episode, as far as it can be known."""

    id: str | None = None
    revision: int | None = None
    root_sha256: str | None = None
    digest: str | None = None
    object_id: str | None = None
    part_id: str | None = None
    start: str | None = None
    references: tuple[ReferenceFacts, ...] = ()
    """Known once frames were decoded."""
    instance_id: str | None = None
    regime: str | None = None
    labels: tuple[LabelFact, ...] = ()
    columns: Mapping[str, str] = field(default_factory=dict)
    """Of the catalog, as `in_brief` has them; none where something is wrong with the metadata."""


def in_brief(value: object) -> str:
    """Return a value as JSON; of what is long, its digest.

    Parameters
    ----------
    value : object
        Of a column of the catalog.

    Returns
    -------
    str
        Equal values have equal ones.
    """
    text = "nothing" if value is None else json.dumps(value, ensure_ascii=False, default=str)
    if len(text) <= _MOST_LETTERS:
        return text
    return f"what has sha-256 {hashlib.sha256(text.encode(errors='replace')).hexdigest()}"


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeResult:
    """Problems of one episode, and how much was looked at."""

    problems: tuple[Problem, ...]
    not_listed: dict[str, int] = field(default_factory=dict)
    suppressed_not_listed: dict[str, int] = field(default_factory=dict)
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
    path: str,
    levels: frozenset[Level],
    *,
    with_digest: bool = False,
    config: Config | None = None,
    member: str | None = None,
) -> EpisodeResult:
    """Validate one episode; never raises for what is in it.

    Parameters
    ----------
    path : str
        Folder or zip.
    levels : frozenset of str
    with_digest : bool
        Compute the episode's digest, which a catalog is compared with.
    config : Config, optional
        Default: every rule as the standard has it.
    member : str, optional
        The episode's path in its dataset, by which a configuration may name it.

    Returns
    -------
    EpisodeResult
        Locations are relative to the episode.

    Raises
    ------
    OSError
        The file itself cannot be opened.
    """
    found = Collector(None if config is None else partial(config.revised, episode=member))
    limits = None if config is None else config.limits
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
        episode = EpisodeContext(store, list_zip(archive_store), limits)
    else:
        store = FolderStore(path)
        listing = list_folder(path)
        episode = EpisodeContext(store, listing, limits)
        unchecked += [Unchecked(*item) for item in _closed(listing)]
    try:
        _judge(root_checks(), episode, levels, found, unchecked)
        if episode.judgeable:
            _judge(episode_checks(), episode, levels, found, unchecked)
            _judge(installed().episode_checks, episode, levels, found, unchecked)
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
        digest = digest_of(episode.store, paths=episode.listing.files)
        return replace(result, facts=replace(result.facts, digest=digest))
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
        except Stopped:
            raise
        except (Exception, SystemExit) as error:  # noqa: BLE001  # a check that fails must not hide the others
            unchecked.append(Unchecked(".", ", ".join(check.rules), reason_of(error)))


def _result(
    found: Collector,
    unchecked: list[Unchecked],
    episode: EpisodeContext | None,
    levels: frozenset[Level],
) -> EpisodeResult:
    result = EpisodeResult(
        problems=found.problems,
        not_listed=dict(found.not_listed),
        suppressed_not_listed=dict(found.suppressed_not_listed),
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
    labels = (notes.labels or []) if notes else []
    return EpisodeFacts(
        id=episode.section("id"),
        revision=episode.section("revision"),
        root_sha256=episode.root_sha256(),
        object_id=notes.object_id if notes else None,
        part_id=notes.part_id if notes else None,
        start=episode.section("start"),
        references=tuple(_references(episode)),
        instance_id=notes.instance_id if notes else None,
        regime=episode.section("regime"),
        labels=tuple(_label_fact(label) for label in labels[:_MOST_LABELS]),
        columns=_columns(episode),
    )


def _columns(episode: EpisodeContext) -> dict[str, str]:
    if episode.metadata is None:
        return {}
    return {name: in_brief(value) for name, value in metadata_columns(episode.metadata).items()}


def _references(episode: EpisodeContext) -> Iterator[ReferenceFacts]:
    grid = [max(1, int(episode.limit("TACT-012", side))) for side in ("columns", "rows")]
    for name, statistics in episode.frame_statistics.items():
        sensor = episode.streams[name].sensor
        if statistics.reference is not None and sensor is not None and sensor.serial:
            yield ReferenceFacts(
                stream=name,
                model=sensor.model,
                serial=sensor.serial,
                coarse=coarse(statistics.reference, *grid),
            )


def _label_fact(label: Label) -> LabelFact:
    source = f"{label.provenance}: {label.origin or ''}"
    return LabelFact(show(label.property), show(source), show(label.value))
