"""What a release will be, decided before anything is written; all that forbids it, at once."""

from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from exumi_data.dataset import open_dataset
from exumi_data.editing.copying import Chosen, chosen_of
from exumi_data.errors import DamagedDataError, ExumiError, UsageError
from exumi_data.manifest import check_listable
from exumi_data.model.dataset import DatasetMetadata, Release, SplitDocument
from exumi_data.model.documents import MAX_DOCUMENT_BYTES
from exumi_data.release.changelog import CHANGELOG_NAME
from exumi_data.release.changes import Changes, compare
from exumi_data.release.citation import Edition
from exumi_data.release.judging import Judge, Judgement
from exumi_data.release.licence import NO_LICENCE, canonical_licence, find_licence_text
from exumi_data.release.markdown import amount
from exumi_data.release.preview import choose_preview
from exumi_data.release.privacy import (
    KINDS,
    PrivateItem,
    Removal,
    check_kinds,
    counted,
    dataset_without_private,
    find_private,
    people_of,
    unresolved,
)
from exumi_data.release.privacy.patches import CLEANING_COMMAND
from exumi_data.release.verifying import verify_release
from exumi_data.release.versions import AUTO, decide_version
from exumi_data.splits import Level, leaks_of, make_split
from exumi_data.store.plain_files import read_plain

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset

__all__ = ["Plan", "SplitWish", "Wishes", "plan_release"]

_SPLIT = "default"


@dataclass(frozen=True, slots=True)
class SplitWish:
    """A split to be made.

    Attributes
    ----------
    level : {"episode", "object", "part"}
    lists : dict of str to int
        Names of lists and their shares.
    seed : int
    """

    level: Level = "episode"
    lists: Mapping[str, int] = field(default_factory=lambda: {"train": 15, "val": 1})
    seed: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class Wishes:
    """What the user wants of a release.

    Attributes
    ----------
    licence : str or None
        SPDX expression; None: that of ``dataset.json``. There is no other default.
    licence_file : pathlib.Path or None
        Its text; None: the file beside the data.
    version : str
        ``major.minor.patch``, or ``auto``.
    previous : pathlib.Path or None
        The release before it, which has to be as it was released.
    split : SplitWish or None
        A split to be made; None: those that there are.
    preview_bytes : int
        Of the preview, at most; 0: none.
    keep, remove : tuple of str
        Kinds of what may be private. What is found has to be in one of them.
    pseudonym_key : bytes or None
        With it, names that are removed become pseudonyms.
    published : str or None
        The day, ``YYYY-MM-DD``; it is not taken from the clock, or no two releases were alike.
    authors : tuple of str
        Whom to cite; none: what ``dataset.json`` says, as of the next two.
    description : str or None
        What the data are, in Markdown.
    citation : str or None
        How to cite them: BibTeX, or a text.
    url : str or None
        Where the release can be had.
    """

    licence: str | None = None
    licence_file: Path | None = None
    version: str = AUTO
    previous: Path | None = None
    split: SplitWish | None = None
    preview_bytes: int = 50_000_000
    keep: tuple[str, ...] = ()
    remove: tuple[str, ...] = ()
    pseudonym_key: bytes | None = None
    published: str | None = None
    authors: tuple[str, ...] = ()
    description: str | None = None
    citation: str | None = None
    url: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Plan:
    """A release that may be built, or what forbids it.

    Attributes
    ----------
    source, target : pathlib.Path
    problems : tuple of str
        What forbids it, all of it.
    judgement : Judgement
        What the validator found in the source.
    metadata : DatasetMetadata
        ``dataset.json`` of the release.
    licence_text : bytes
    splits : dict of str to SplitDocument
    chosen : list of Chosen
        The episodes.
    preview_bytes : int
    preview : tuple of str
        Ids of the episodes that the preview will show, by their sizes before packing.
    changes : Changes or None
        Against the release before; None of a first one.
    older_changelog : str or None
    previous : pathlib.Path or None
    notices : tuple of str
        What the user should know.
    private : list of PrivateItem
        What may be private, of the kinds that are kept and of those that are removed.
    removal : Removal or None
        What is taken out; None: nothing.
    hidden : Removal or None
        What the changelog does not tell: it speaks of the release before as well. None of a first
        one.
    """

    source: Path
    target: Path
    problems: tuple[str, ...]
    judgement: Judgement
    metadata: DatasetMetadata
    licence_text: bytes = b""
    splits: Mapping[str, SplitDocument] = field(default_factory=dict)
    chosen: list[Chosen] = field(default_factory=list)
    preview_bytes: int = 0
    preview: tuple[str, ...] = ()
    changes: Changes | None = None
    older_changelog: str | None = None
    previous: Path | None = None
    notices: tuple[str, ...] = ()
    private: list[PrivateItem] = field(default_factory=list)
    removal: Removal | None = None
    hidden: Removal | None = None


def plan_release(
    source: Path, target: Path, wishes: Wishes, judge: Judge, *, workers: int | None = None
) -> Plan:
    """Decide what a release will be. Nothing is written.

    Parameters
    ----------
    source : pathlib.Path
        A dataset.
    target : pathlib.Path
        The folder of the release, which must not be there yet.
    wishes : Wishes
    judge : callable
        The validator.
    workers : int, optional
        Processes; default all cores.

    Returns
    -------
    Plan
        With all problems, of the wishes, of the splits and of the data.

    Raises
    ------
    NotAnEpisodeError
        `source` is no dataset.
    """
    problems: list[str] = []
    notices: list[str] = []

    def tried(step: Callable[[], Any], otherwise: Any) -> Any:
        try:
            return step()
        except ExumiError as error:
            problems.append(str(error))
            return otherwise

    dataset = open_dataset(source)
    tried(lambda: _check_target(source, target), None)
    metadata = dataset.metadata.model_copy(deep=True)
    licence = tried(lambda: canonical_licence(wishes.licence or metadata.licence), None)
    metadata.licence = licence or metadata.licence
    text = tried(lambda: _licence_text(source, wishes, licence), b"")
    problems += _unlicensed(dataset, licence)
    notices += _other_licences(dataset, licence)
    private = tried(lambda: find_private(source, workers=workers), [])
    problems += tried(lambda: _undecided(private, wishes), [])
    removal = tried(lambda: _removal(source, private, wishes, workers), None)
    if removal is not None:
        metadata = dataset_without_private(metadata, removal)[0]
    _describe(metadata, wishes)
    splits = tried(lambda: _splits(dataset, wishes.split), {})
    keys = _keys(dataset)
    problems += [leak for one in splits.values() for leak in leaks_of(one, keys)]
    metadata.splits = list(splits)
    if not splits and not problems:
        notices.append(
            "there is no split, so everybody will make their own: --split episode makes one"
        )
    before, version, changes, hidden = None, wishes.version, None, None
    if wishes.previous is not None:
        previous = wishes.previous
        before = tried(lambda: _version_of(previous, workers), None)
        if before is not None:
            changes, hidden = (
                tried(
                    lambda: _changes(previous, dataset, splits, metadata, removal, workers), None
                ),
                tried(lambda: _hidden(source, previous, wishes, workers), None),
            )
    if before is None or changes is not None:
        step = changes.step if changes is not None else None
        version = tried(lambda: decide_version(wishes.version, before, step), None)
        if version is not None:
            metadata.release = Release(version=version)
            if before is not None:
                metadata.release.previous = before
            tried(lambda: _publish(metadata, wishes), None)
    tried(lambda: check_listable(len(dataset), source), None)
    if not dataset.ids:
        problems.append(f"{source}: there are no episodes")
    preview = _preview(dataset, wishes, splits)
    if wishes.preview_bytes and not preview and dataset.ids:
        notices.append(f"no episode fits into a preview of {wishes.preview_bytes:,} bytes")
    notices += _unsaid(metadata, wishes)
    return Plan(
        source=source,
        target=target,
        problems=tuple(dict.fromkeys(problems)),
        judgement=judge(source, True),
        metadata=metadata,
        licence_text=text,
        splits=splits,
        chosen=chosen_of(dataset),
        preview_bytes=wishes.preview_bytes,
        preview=tuple(preview),
        changes=changes,
        older_changelog=_older(wishes.previous),
        previous=wishes.previous,
        notices=tuple(notices),
        private=private,
        removal=removal,
        hidden=hidden,
    )


def _preview(dataset: "Dataset", wishes: Wishes, splits: Mapping[str, SplitDocument]) -> list[str]:
    rows = dataset.catalog.to_pylist()
    sizes = {str(row["id"]): int(row["bytes"]) for row in rows}
    return choose_preview(rows, sizes, wishes.preview_bytes, splits)


def _check_target(source: Path, target: Path) -> None:
    here, there = source.resolve(), target.resolve()
    if there == here or there.is_relative_to(here) or here.is_relative_to(there):
        raise UsageError("lies in the dataset, or around it", where=target, fix="Name another.")
    if target.is_symlink() or (target.exists() and (not target.is_dir() or any(target.iterdir()))):
        raise UsageError(
            "is there already: releases are not changed",
            where=target,
            fix="Name a new folder; the release before it is named with --previous.",
        )


def _undecided(private: list[PrivateItem], wishes: Wishes) -> list[str]:
    """Say what nobody has decided about, and what cannot be taken out; each thing once."""
    said = []
    left = unresolved(private, wishes.keep, wishes.remove)
    for (kind, value, why), items in counted(left).items():
        at = " ".join(filter(None, (items[0].episode, items[0].where)))
        told = f"{kind} {value!r} in {len(items):,} place(s), such as {at} ({why})"
        if kind in wishes.remove:
            said.append(f"{told} cannot be taken out: --keep {kind}, or {_by_hand(items[0].where)}")
        else:
            said.append(f"{told}: --keep {kind}, or --remove {kind}")
    said += [
        f"{one.kind} {one.value!r} in {one.where} cannot be taken out of a split: make it anew"
        for one in private
        if one.kind in wishes.remove and one.removable and one.where.startswith("splits/")
    ]
    return said


def _by_hand(where: str) -> str:
    """Say how what cannot be taken out here is taken out elsewhere."""
    if where.startswith("splits/"):
        return "make the split anew"
    if "#" in where:
        return "give it another name (exumi dataset relabel, or where it was made)"
    return f"take it out of the source file ({CLEANING_COMMAND}) and convert that"


def _describe(metadata: DatasetMetadata, wishes: Wishes) -> None:
    """Say of a dataset what the user says of it, and nobody else has to allow."""
    metadata.authors = list(wishes.authors) or metadata.authors
    metadata.description = wishes.description or metadata.description
    metadata.citation = wishes.citation or metadata.citation


def _publish(metadata: DatasetMetadata, wishes: Wishes) -> None:
    if metadata.release is None:
        return
    Edition(published=wishes.published, url=wishes.url)  # refuses what is no day and no address
    if wishes.published is not None:
        metadata.release.published = wishes.published
    if wishes.url is not None:
        metadata.release.url = wishes.url


def _unsaid(metadata: DatasetMetadata, wishes: Wishes) -> Iterator[str]:
    """Yield what a stranger will miss."""
    if not metadata.authors:
        yield "it names no authors, so nobody knows whom to cite: --author NAME"
    if not metadata.description:
        yield "it does not say what it is: --description TEXT"
    if wishes.published is None:
        yield "it does not say when it is published: --published YYYY-MM-DD"
    if wishes.url is None:
        yield "it does not say where it can be had: --url https://..."


def _removal(
    source: Path, private: list[PrivateItem], wishes: Wishes, workers: int | None
) -> Removal | None:
    """Return what is taken out, where something of it was found."""
    kinds = check_kinds(wishes.remove)
    check_kinds(wishes.keep)
    removal = Removal(kinds, wishes.pseudonym_key)
    if not any(one.kind in kinds for one in private):
        return None
    return replace(removal, names=people_of(source, workers=workers))


def _hidden(source: Path, previous: Path, wishes: Wishes, workers: int | None) -> Removal:
    """Return what the changelog does not tell: all that was not explicitly kept."""
    kinds = frozenset(KINDS) - check_kinds(wishes.keep)
    people = people_of(previous, workers=workers) | people_of(source, workers=workers)
    return Removal(kinds, names={name: kind for name, kind in people.items() if kind in kinds})


def _licence_text(source: Path, wishes: Wishes, licence: str | None) -> bytes:
    """Return the text of the licence; where that is not known, look for the file at least."""
    file = wishes.licence_file
    if licence is not None:
        return find_licence_text(source, file, licence)
    if file is not None and not file.is_file():
        raise UsageError("no such file", where=file)
    return b""


def _unlicensed(dataset: "Dataset", licence: str | None) -> list[str]:
    """Say which episodes nobody may use: they keep what they say, whatever the release says."""
    return [
        f"{count:,} of {len(dataset):,} episodes say {one}, which is no licence: nobody may use "
        f"what is published so. Ask who owns them, and say it: {_relabel(dataset, one, licence)}"
        for one, count in _said_licences(dataset)
        if one in NO_LICENCE
    ]


def _other_licences(dataset: "Dataset", licence: str | None) -> list[str]:
    if licence is None:
        return []
    return [
        f"{count} episodes say {one} themselves, and keep it; to change that: "
        f"{_relabel(dataset, one, licence)}"
        for one, count in _said_licences(dataset)
        if one not in (licence, *NO_LICENCE)
    ]


def _said_licences(dataset: "Dataset") -> list[tuple[str, int]]:
    """Return what the episodes say themselves, and how many say it."""
    return sorted(Counter(map(str, dataset.catalog.column("licence").to_pylist())).items())


def _relabel(dataset: "Dataset", one: str, licence: str | None) -> str:
    chosen = "SPDX" if licence is None else f"'{licence}'"
    return f"exumi dataset relabel {dataset.path} --where licence={one} --licence {chosen}"


def _splits(dataset: "Dataset", wish: SplitWish | None) -> dict[str, SplitDocument]:
    splits = dict(dataset.splits)
    if wish is None:
        return splits
    if _SPLIT in splits:
        raise UsageError(
            f"there is a split {_SPLIT!r} already",
            where=dataset.path,
            fix="Leave --split out to release it as it is.",
        )
    made = make_split(dataset, level=wish.level, lists=wish.lists, seed=wish.seed, name=_SPLIT)
    return {**splits, _SPLIT: made}


def _keys(dataset: "Dataset") -> dict[str, dict[str, Any]]:
    columns = ("id", "object_id", "part_id")
    rows = dataset.catalog.select(columns).to_pylist()
    return {str(row["id"]): row for row in rows}


def _version_of(previous: Path, workers: int | None) -> str:
    """Return the version of the release before, which has to be as it was released.

    What is damaged there, or gone, would pass for a change.
    """
    found = verify_release(previous, workers=workers)
    if not found.good:
        first = found.findings[0]
        raise DamagedDataError(
            f"is not as it was released: {amount(len(found.findings), 'finding')}, the first: "
            f"{first.path} {first.message}",
            where=previous,
            fix=f"See exumi release verify {previous}",
        )
    if found.version is None:
        raise UsageError(
            "is no release: its dataset.json states no version",
            where=previous,
            fix="Name the folder that exumi release wrote.",
        )
    return found.version


def _changes(
    previous: Path,
    dataset: "Dataset",
    splits: Mapping[str, SplitDocument],
    metadata: DatasetMetadata,
    removal: Removal | None,
    workers: int | None,
) -> Changes:
    return compare(
        previous,
        Path(dataset.path),
        after_splits=splits,
        after_metadata=metadata,
        removal=removal,
        workers=workers,
    )


def _older(previous: Path | None) -> str | None:
    if previous is None or not (previous / CHANGELOG_NAME).is_file():
        return None
    try:
        return read_plain(previous / CHANGELOG_NAME, MAX_DOCUMENT_BYTES).decode()
    except (ExumiError, UnicodeDecodeError):
        return None
