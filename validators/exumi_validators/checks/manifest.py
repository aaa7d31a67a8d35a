"""The manifest of a released dataset, against its files and episodes."""

from collections.abc import Iterator, Sequence

from exumi_data.errors import DamagedDataError
from exumi_data.manifest import MANIFEST_NAME, is_listed, sha256_of
from exumi_data.model.manifest import ManifestEpisode, ManifestFile
from exumi_data.store.paths import check_member_path
from exumi_validators.dataset_context import DatasetContext
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = [
    "checksums",
    "episode_digests",
    "episodes",
    "nothing_else",
    "paths",
    "sizes",
    "there",
]


@check("MAN-007")
def paths(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that paths lead to one place each, inside the dataset."""
    if dataset.manifest is None:
        return
    lists: dict[str, Sequence[ManifestFile | ManifestEpisode]] = {
        "files": dataset.manifest.files,
        "episodes": dataset.manifest.episodes,
    }
    for key, entries in lists.items():
        seen: set[str] = set()
        for index, entry in enumerate(entries):
            detail = None
            if not _is_safe(entry.path):
                detail = "unsafe path"
            elif entry.path in seen:
                detail = "a path that stands twice"
            seen.add(entry.path)
            if detail:
                pointer = (key, index, "path")
                yield problem(
                    "MAN-007", MANIFEST_NAME, pointer=pointer, found=entry.path, detail=detail
                )


def _is_safe(path: str) -> bool:
    try:
        check_member_path(path, MANIFEST_NAME)
    except DamagedDataError:
        return False
    return True


@check("MAN-001")
def there(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that what is listed is there."""
    if dataset.manifest is None:
        return
    listed = (entry.path for entry in dataset.manifest.files)
    gone = [path for path in listed if path not in dataset.files]
    if gone:
        yield problem("MAN-001", MANIFEST_NAME, found=len(gone), detail=gone[0])


@check("MAN-002")
def nothing_else(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that what is there is listed."""
    if dataset.manifest is None:
        return
    listed = {entry.path for entry in dataset.manifest.files}
    extra = sorted(path for path in dataset.files if is_listed(path) and path not in listed)
    if extra:
        yield problem("MAN-002", MANIFEST_NAME, found=len(extra), detail=extra[0])


@check("MAN-003")
def sizes(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge sizes."""
    for entry in dataset.manifest.files if dataset.manifest else ():
        size = dataset.files.get(entry.path)
        if size is not None and size != entry.bytes:
            yield problem("MAN-003", entry.path, expected=entry.bytes, found=size)


@check("MAN-004")
def checksums(dataset: DatasetContext) -> Iterator[Problem]:
    """Read every file whose size is right, in pieces."""
    for entry in dataset.manifest.files if dataset.manifest else ():
        if dataset.files.get(entry.path) != entry.bytes:
            continue
        try:
            found, _ = sha256_of(dataset.root / entry.path)
        except (DamagedDataError, FileNotFoundError) as error:
            found = str(getattr(error, "what", "not there any more"))
        if found != entry.sha256:
            yield problem("MAN-004", entry.path, expected=entry.sha256, found=found)


@check("MAN-005")
def episodes(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that the episodes are those of the dataset."""
    if dataset.manifest is None:
        return
    present = set(dataset.episodes)
    for index, entry in enumerate(dataset.manifest.episodes):
        facts = dataset.facts.get(entry.path)
        detail, key = None, "path"
        if entry.path not in present:
            detail = f"no episode is at {entry.path}"
        elif facts and facts.id and facts.id != entry.id:
            detail, key = f"the id is {facts.id}, the manifest says {entry.id}", "id"
        if detail:
            yield problem("MAN-005", MANIFEST_NAME, pointer=("episodes", index, key), detail=detail)
    extra = sorted(present - {entry.path for entry in dataset.manifest.episodes})
    if extra:
        detail = f"{len(extra)} episodes are not listed, the first is {extra[0]}"
        yield problem("MAN-005", MANIFEST_NAME, detail=detail)


@check("MAN-006")
def episode_digests(dataset: DatasetContext) -> Iterator[Problem]:
    """Judge that the episodes' digests are those of their bytes."""
    for index, entry in enumerate(dataset.manifest.episodes if dataset.manifest else ()):
        facts = dataset.facts.get(entry.path)
        if facts and facts.digest and facts.digest != entry.digest:
            pointer = ("episodes", index, "digest")
            yield problem(
                "MAN-006", MANIFEST_NAME, pointer=pointer, expected=entry.digest, found=facts.digest
            )
