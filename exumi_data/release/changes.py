"""What differs between two datasets, episode by episode, and what it means for the version."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

from exumi_data.dataset import open_dataset
from exumi_data.editing.revising import differences
from exumi_data.engine import map_items
from exumi_data.episode import open_episode
from exumi_data.manifest import MANIFEST_NAME
from exumi_data.model.dataset import DatasetMetadata, SplitDocument
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, dump, parse_episode, parse_manifest
from exumi_data.release.privacy import Removal, without_private
from exumi_data.release.versions import STEPS, Step
from exumi_data.store.access import Store
from exumi_data.store.digest import digest_of, sha256_store_file
from exumi_data.store.plain_files import read_plain

__all__ = ["Changes", "EpisodeChange", "Kind", "SplitChange", "compare"]

Kind = Literal["added", "removed", "reserialised", "relabelled", "changed"]
_ROOT = "zarr.json"
_EMPTY: tuple[object, ...] = (None, [], {})
_OWN_KEYS = ("splits", "release")


@dataclass(frozen=True, slots=True)
class EpisodeChange:
    """What became of an episode.

    Attributes
    ----------
    id : str
    kind : {"added", "removed", "reserialised", "relabelled", "changed"}
        Reserialised: the same recording in other bytes. Relabelled: the same samples, of which
        something else is said. Changed: other samples.
    fields : dict of str to (object, object)
        Of what is said of it, what it was and what it is; None: absent.
    """

    id: str
    kind: Kind
    fields: Mapping[str, tuple[object, object]]

    @property
    def step(self) -> Step:
        """What it calls for."""
        if self.kind == "reserialised":
            return "patch"
        if self.kind == "added":
            return "minor"
        only_more = all(before is None for before, _ in self.fields.values())
        return "minor" if self.kind == "relabelled" and only_more else "major"


@dataclass(frozen=True, slots=True)
class SplitChange:
    """What became of a split.

    Attributes
    ----------
    name : str
    kind : {"added", "removed", "changed"}
        Changed: an episode that both datasets have is in another list, or in one and not before.
    episodes : tuple of str
        Which.
    """

    name: str
    kind: Literal["added", "removed", "changed"]
    episodes: tuple[str, ...] = ()

    @property
    def step(self) -> Step:
        """What it calls for."""
        return "minor" if self.kind == "added" else "major"


@dataclass(frozen=True, slots=True)
class Changes:
    """What differs between two datasets.

    Attributes
    ----------
    unchanged : int
        Episodes that are the same.
    episodes : tuple of EpisodeChange
        The others, by id.
    splits : tuple of SplitChange
    document : dict of str to (object, object)
        Of what ``dataset.json`` says, what it was and what it is.
    """

    unchanged: int
    episodes: tuple[EpisodeChange, ...]
    splits: tuple[SplitChange, ...]
    document: Mapping[str, tuple[object, object]]

    @property
    def step(self) -> Step | None:
        """The version step that all of it calls for; None where nothing differs."""
        steps = [*(one.step for one in self.episodes), *(one.step for one in self.splits)]
        steps += ["major" if key == "licence" else "patch" for key in self.document]
        return max(steps, key=STEPS.index, default=None)

    def of(self, kind: Kind) -> list[EpisodeChange]:
        """Return the episodes that something became of.

        Parameters
        ----------
        kind : str
        """
        return [one for one in self.episodes if one.kind == kind]

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {
            "step": self.step,
            "unchanged": self.unchanged,
            "episodes": [
                {"id": one.id, "kind": one.kind, "step": one.step, "fields": _listed(one.fields)}
                for one in self.episodes
            ],
            "splits": [
                {
                    "name": one.name,
                    "kind": one.kind,
                    "step": one.step,
                    "episodes": list(one.episodes),
                }
                for one in self.splits
            ],
            "dataset": _listed(self.document),
        }


def compare(
    before: Path,
    after: Path,
    *,
    after_metadata: DatasetMetadata | None = None,
    after_splits: Mapping[str, SplitDocument] | None = None,
    removal: Removal | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Changes:
    """Find what differs between two datasets.

    Episodes are told apart by their digests, which do not depend on packing. Only those whose
    digests differ are read.

    Parameters
    ----------
    before, after : pathlib.Path
        Folders of datasets, released or not.
    after_metadata : DatasetMetadata, optional
    after_splits : mapping of str to SplitDocument, optional
        What the second will say, where that is not yet written.
    removal : Removal, optional
        What will be taken out of the episodes of the second.
    workers : int, optional
        Processes; default all cores.
    on_progress : callable
        Told how many of the episodes to be read are done, and of how many.

    Raises
    ------
    NotAnEpisodeError
        One of them is no dataset.
    DamagedDataError
        An episode cannot be read.
    """
    first, second = open_dataset(before), open_dataset(after)
    rows = [{row["id"]: row for row in one.catalog.to_pylist()} for one in (first, second)]
    common = sorted(rows[0].keys() & rows[1].keys())
    found = [EpisodeChange(one, "added", {}) for one in rows[1].keys() - rows[0].keys()]
    found += [EpisodeChange(one, "removed", {}) for one in rows[0].keys() - rows[1].keys()]
    files = [_packed(before), _packed(after)]
    unlike = []
    for one in common:
        old, new = rows[0][one], rows[1][one]
        if old["digest"] != new["digest"]:
            unlike.append((one, str(old["path"]), str(new["path"])))
        elif old["derived_digest"] != new["derived_digest"] or (
            # What is not released may be packed or not: that says nothing.
            files[0] is not None
            and files[1] is not None
            and files[0].get(old["path"]) != files[1].get(new["path"])
        ):
            found.append(EpisodeChange(one, "reserialised", {}))
    work = partial(_compare_two, before=before, after=after, removal=removal)
    # A few episodes are read faster than processes start.
    outcomes = map_items(work, unlike, workers=1 if len(unlike) < 64 else workers)
    for done, outcome in enumerate(outcomes):
        if outcome.error is not None:
            raise outcome.error
        if outcome.value is not None:
            found.append(outcome.value)
        on_progress(done + 1, len(unlike))
    changed = {one.id for one in found}
    return Changes(
        unchanged=sum(one not in changed for one in common),
        episodes=tuple(sorted(found, key=lambda one: one.id)),
        splits=tuple(
            _splits(
                first.splits,
                second.splits if after_splits is None else after_splits,
                set(common),
            )
        ),
        document=_document(first.metadata, after_metadata or second.metadata),
    )


def _packed(root: Path) -> Mapping[str, str] | None:
    """Return the checksums of a release's files by path; None of what is no release."""
    try:
        raw = read_plain(root / MANIFEST_NAME, MAX_DOCUMENT_BYTES)
    except FileNotFoundError:
        return None
    return {one.path: one.sha256 for one in parse_manifest(raw, root / MANIFEST_NAME).files}


def _compare_two(
    paths: tuple[str, str, str], *, before: Path, after: Path, removal: Removal | None
) -> EpisodeChange | None:
    """Compare episodes of unlike digests; None: they are the same without what is taken out."""
    episode_id, first, second = paths
    with open_episode(before / first) as old, open_episode(after / second) as new:
        store: Store = new.store
        if removal is not None:
            store = without_private(store, removal).store
            if digest_of(store) == digest_of(old.store):
                return None
        said = parse_episode(store.read(_ROOT), f"{store.location}/{_ROOT}")
        fields = _said(differences(dump(old.metadata), dump(said)))
        fields.pop("revision", None)
        if not _same_samples(old.store, store):
            return EpisodeChange(episode_id, "changed", fields)
        return EpisodeChange(episode_id, "relabelled" if fields else "reserialised", fields)


def _same_samples(first: Store, second: Store) -> bool:
    """Whether two episodes have the same files, but for what is said and what is derived."""
    members = [sorted(filter(_is_data, one.paths())) for one in (first, second)]
    return members[0] == members[1] and all(
        first.size(path) == second.size(path)
        and sha256_store_file(first, path) == sha256_store_file(second, path)
        for path in members[0]
    )


def _is_data(path: str) -> bool:
    return path != _ROOT and not path.startswith("derived/")


def _splits(
    first: Mapping[str, SplitDocument], second: Mapping[str, SplitDocument], common: set[str]
) -> Iterable[SplitChange]:
    for name in first:
        if name not in second:
            yield SplitChange(name, "removed")
    for name, after in second.items():
        if name not in first:
            yield SplitChange(name, "added")
            continue
        lists = [
            {one: part for part, ids in each.lists.items() for one in ids if one in common}
            for each in (first[name], after)
        ]
        moved = [one for one in sorted(common) if lists[0].get(one) != lists[1].get(one)]
        if moved:
            yield SplitChange(name, "changed", tuple(moved))


def _document(first: DatasetMetadata, second: DatasetMetadata) -> dict[str, tuple[object, object]]:
    documents = [dump(one) for one in (first, second)]
    for document in documents:
        for key in _OWN_KEYS:
            document.pop(key, None)
    return _said(differences(documents[0], documents[1]))


def _said(fields: dict[str, tuple[object, object]]) -> dict[str, tuple[object, object]]:
    """Leave out what was absent and is empty, or the other way round: both say nothing."""
    return {key: both for key, both in fields.items() if any(one not in _EMPTY for one in both)}


def _listed(fields: Mapping[str, tuple[object, object]]) -> dict[str, dict[str, object]]:
    return {key: {"before": before, "after": after} for key, (before, after) in fields.items()}
