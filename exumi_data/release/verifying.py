"""A copy of a release against its manifest: every file, and that its parts agree."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import asdict, dataclass, field
from functools import partial
from hashlib import sha256
from pathlib import Path
from typing import Any

from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.engine import map_items
from exumi_data.errors import ExumiError, NotAnEpisodeError, UsageError
from exumi_data.manifest import MANIFEST_NAME, list_files, sha256_of
from exumi_data.model.dataset import DatasetMetadata
from exumi_data.model.documents import (
    MAX_DOCUMENT_BYTES,
    parse_manifest,
)
from exumi_data.model.manifest import Manifest, ManifestFile
from exumi_data.release.verify_state import FileState, VerifyState, stamp_of
from exumi_data.release.verify_structure import PACKED, Finding, structure_of
from exumi_data.store.access import open_store
from exumi_data.store.digest import digest_of
from exumi_data.store.paths import check_member_path
from exumi_data.store.plain_files import is_plain_file, read_plain

__all__ = ["Finding", "Verification", "verify_release"]


@dataclass(frozen=True, slots=True, kw_only=True)
class Verification:
    """What a verification found, and how much it looked at.

    Attributes
    ----------
    path : str
    name, version : str or None
        As ``dataset.json`` says.
    fingerprint : str
        SHA-256 of the manifest.
    findings : tuple of Finding
        By path.
    files, bytes : int
        That the manifest lists.
    episodes : int
    quick : bool
        Whether only sizes and structure were looked at.
    resumed : int
        Files that an earlier run had read.
    """

    path: str
    name: str | None
    version: str | None
    fingerprint: str
    findings: tuple[Finding, ...] = field(default_factory=tuple)
    files: int
    bytes: int
    episodes: int
    quick: bool
    resumed: int

    @property
    def good(self) -> bool:
        """Whether everything that was looked at is as it was released."""
        return not self.findings

    def to_json(self) -> dict[str, Any]:
        """Return it as plain data."""
        return {"good": self.good, **asdict(self)}


def verify_release(
    root: Path,
    *,
    quick: bool = False,
    fingerprint: str | None = None,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Verification:
    """Compare a copy of a release with its manifest. Nothing is written into it.

    Parameters
    ----------
    root : pathlib.Path
    quick : bool
        Read no data: look at names, sizes and structure alone.
    fingerprint : str, optional
        SHA-256 that the manifest must have: without it, whoever changed the data could have
        changed the manifest, too.
    workers : int, optional
        Processes; default all cores.
    on_progress : callable
        Told how many bytes are read, and of how many. What a run that was killed within the last
        day had read, and what was not touched since, is not read again.

    Returns
    -------
    Verification

    Raises
    ------
    NotAnEpisodeError
        It is no dataset.
    UsageError
        It was never released: there is no manifest.
    """
    if not is_plain_file(root / DATASET_DOCUMENT) and not is_plain_file(root / MANIFEST_NAME):
        raise NotAnEpisodeError("neither dataset.json nor manifest.json is there", where=root)
    try:
        raw = read_plain(root / MANIFEST_NAME, MAX_DOCUMENT_BYTES)
    except FileNotFoundError:
        raise UsageError(
            "has no manifest.json: it is no release, or the manifest was lost",
            where=root,
            fix="Make a release of it with: exumi release SRC DST --licence SPDX",
        ) from None
    own = sha256(raw).hexdigest()
    findings: list[Finding] = []
    if fingerprint is not None and own != fingerprint.lower():
        findings.append(
            Finding("changed", MANIFEST_NAME, "is another manifest", fingerprint.lower(), own)
        )
    try:
        manifest = parse_manifest(raw, MANIFEST_NAME)
        _check_paths(manifest)
    except ExumiError as error:
        findings.append(Finding("unreadable", MANIFEST_NAME, error.what))
        return _result(root, None, own, findings, Manifest(files=[], episodes=[]), quick, 0)
    there = _present(root, findings)
    good = list(_same_size(manifest, there, findings))
    resumed = 0
    if not quick:
        with VerifyState.of(root, own) as state:
            read, resumed = _read_all(root, manifest, good, state, workers, on_progress)
        findings += _wrong_bytes(manifest, good, read)
    metadata = structure_of(root, manifest, findings)
    return _result(root, metadata, own, findings, manifest, quick, resumed)


def _result(
    root: Path,
    metadata: DatasetMetadata | None,
    fingerprint: str,
    findings: Iterable[Finding],
    manifest: Manifest,
    quick: bool,
    resumed: int,
) -> Verification:
    release = metadata.release if metadata else None
    return Verification(
        path=str(root),
        name=metadata.name if metadata else None,
        version=release.version if release else None,
        fingerprint=fingerprint,
        findings=tuple(sorted(findings, key=lambda one: (one.path, one.kind))),
        files=len(manifest.files),
        bytes=sum(one.bytes for one in manifest.files),
        episodes=len(manifest.episodes),
        quick=quick,
        resumed=resumed,
    )


def _check_paths(manifest: Manifest) -> None:
    """Check that no path of a manifest leads out of the folder."""
    for path in (*(one.path for one in manifest.files), *(one.path for one in manifest.episodes)):
        check_member_path(path, MANIFEST_NAME)


def _present(root: Path, findings: list[Finding]) -> dict[str, int | None]:
    """Return the size of each file that is there; None of what is no file."""
    found: dict[str, int | None] = {}

    def note(problem: ExumiError) -> None:
        findings.append(Finding("unreadable", str(problem.where), problem.what))

    # One odd name hides nothing of the rest.
    for path in list_files(root, note):
        there = root / path
        found[path] = there.lstat().st_size if is_plain_file(there) else None
    return found


def _same_size(
    manifest: Manifest, there: Mapping[str, int | None], findings: list[Finding]
) -> Iterator[ManifestFile]:
    for entry in manifest.files:
        size = there.get(entry.path, -1)
        if size == -1:
            findings.append(Finding("missing", entry.path, "is missing"))
        elif size is None:
            findings.append(Finding("changed", entry.path, "is a link or no file"))
        elif size != entry.bytes:
            findings.append(
                Finding("size", entry.path, "has another size", str(entry.bytes), str(size))
            )
        else:
            yield entry
    listed = {entry.path for entry in manifest.files}
    findings += [
        Finding("extra", path, "does not belong to the release") for path in there.keys() - listed
    ]


def _read_all(
    root: Path,
    manifest: Manifest,
    files: list[ManifestFile],
    state: VerifyState,
    workers: int | None,
    on_progress: Callable[[int, int], None],
) -> tuple[dict[str, FileState], int]:
    packed = {one.path for one in manifest.episodes if one.path.endswith(PACKED)}
    done = {}
    for entry in files:
        known = state.get(root, entry.path)
        if known is not None:
            done[entry.path] = known
    resumed = len(done)
    total = sum(entry.bytes for entry in files)
    count = sum(entry.bytes for entry in files if entry.path in done)
    todo = [(entry.path, entry.path in packed) for entry in files if entry.path not in done]
    sizes = {entry.path: entry.bytes for entry in files}
    on_progress(count, total)
    # A few files are read faster than processes start.
    little = total - count < 64 << 20
    outcomes = map_items(partial(_read, root=root), todo, workers=1 if little else workers)
    for outcome in outcomes:
        path = outcome.item[0]
        if outcome.value is None:
            now = FileState(path, 0, (), None, None, _reason(outcome.error))
        else:
            now = outcome.value
            state.put(now)
        done[path] = now
        count += sizes[path]
        on_progress(count, total)
    return done, resumed


def _reason(error: Exception | None) -> str:
    return error.what if isinstance(error, ExumiError) else str(error)


def _read(item: tuple[str, bool], *, root: Path) -> FileState:
    """Read a file, and of a packed episode also what is in it."""
    path, is_episode = item
    before = (root / path).lstat()
    checksum, size = sha256_of(root / path)
    digest, problem = None, None
    if is_episode:
        try:
            store = open_store(root / path)
            try:
                digest = digest_of(store)
            finally:
                store.close()
        except ExumiError as error:
            problem = error.what
    return FileState(path, size, stamp_of(before), checksum, digest, problem)


def _wrong_bytes(
    manifest: Manifest, files: list[ManifestFile], read: Mapping[str, FileState]
) -> Iterator[Finding]:
    as_listed = set()
    for entry in files:
        found = read[entry.path]
        if found.sha256 is None:
            yield Finding("unreadable", entry.path, found.problem or "cannot be read")
        elif found.sha256 != entry.sha256:
            yield Finding("changed", entry.path, "has other bytes", entry.sha256, found.sha256)
        else:
            as_listed.add(entry.path)
    for episode in manifest.episodes:
        if episode.path not in as_listed:
            continue  # it is a folder; or its file is another, which is said
        state = read[episode.path]
        if state.problem is not None:
            yield Finding("structure", episode.path, state.problem)
        elif state.digest != episode.digest:
            yield Finding(
                "structure",
                episode.path,
                "the manifest states another digest",
                episode.digest,
                state.digest,
            )
