"""A release published on the Hugging Face hub, or on another server that speaks as it does.

Large files are uploaded first, and can be seen by nobody; one commit at the end makes the release
appear whole. What was uploaded by a run that was cut is not uploaded again.
"""

import tempfile
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exumi_data._version import __version__
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.errors import DamagedDataError, ExumiError, MissingExtraError, UsageError
from exumi_data.manifest import MANIFEST_NAME, sha256_of
from exumi_data.model.dataset import Release
from exumi_data.model.documents import MAX_DOCUMENT_BYTES, parse_dataset, parse_manifest
from exumi_data.model.manifest import Manifest
from exumi_data.release.judging import Judge
from exumi_data.release.verifying import verify_release
from exumi_data.store.plain_files import read_plain

if TYPE_CHECKING:
    from huggingface_hub import CommitOperationAdd, CommitOperationDelete, HfApi

__all__ = ["Pushed", "check_repository", "push_release"]

_KIND = "dataset"
_BATCH_FILES = 64
_BATCH_BYTES = 256 << 20
_COMMIT_FILES = 10_000  # the hub takes 25 000 large files in one
_LAST = ("README.md", DATASET_DOCUMENT, MANIFEST_NAME)
_SHOWN = 5


@dataclass(frozen=True, slots=True)
class Pushed:
    """A release that is published.

    Attributes
    ----------
    url : str
        Of its page.
    commit : str
    tag : str
        Of its version: ``v1.0.0``.
    files : int
    removed : tuple of str
        Files of the release before it that are gone from the newest state. Its tag keeps them.
    replaced : tuple of str
        Files that were there and belonged to no release, such as a README written by hand: the
        release has its own of that name. The repository's history keeps them.
    others : tuple of str
        Files there that belong to no release, and stay.
    already : bool
        Whether this very release was published before, and nothing was done.
    """

    url: str
    commit: str
    tag: str
    files: int
    removed: tuple[str, ...]
    replaced: tuple[str, ...]
    others: tuple[str, ...]
    already: bool


def push_release(
    root: Path,
    repository: str,
    judge: Judge,
    *,
    public: bool = False,
    endpoint: str | None = None,
    workers: int | None = None,
    on_progress: Callable[[str, int, int], None] = lambda _what, _done, _total: None,
) -> Pushed:
    """Publish a release, after verifying it.

    The account is that of ``HF_TOKEN`` or of ``hf auth login``.

    Parameters
    ----------
    root : pathlib.Path
    repository : str
        ``owner/name``. It is made if it is not there.
    judge : callable
        The validator.
    public : bool
        Whether everybody sees a repository that is made. One that is there stays as it is.
    endpoint : str, optional
        The server; default that of ``HF_ENDPOINT``, or the hub.
    workers : int, optional
        Processes for verifying; default all cores.
    on_progress : callable
        Told what is done, how many bytes of it are, and of how many.

    Returns
    -------
    Pushed

    Raises
    ------
    DamagedDataError
        It is not as it was released, or not valid: nothing was sent.
    UsageError
        `repository` is no name of one. The release states no version; or another release of this
        version, a later one, or another dataset is published there.
    MissingExtraError
        ``huggingface_hub`` is not installed.
    ExumiError
        The server refuses, or cannot be reached.
    """
    check_repository(repository)
    version = _checked(root, judge, workers, on_progress)
    with _quiet_hub(), _reported(repository):
        from huggingface_hub import HfApi

        api = HfApi(endpoint=endpoint, library_name="exumi-data", library_version=__version__)
        url = api.create_repo(repository, repo_type=_KIND, private=not public, exist_ok=True)
        return _publish(api, root, repository, str(url), f"v{version}", on_progress)


def check_repository(repository: str) -> None:
    """Check that a name is one that a repository may have, without asking a server.

    Parameters
    ----------
    repository : str
        ``owner/name``.

    Raises
    ------
    UsageError
        It is none.
    MissingExtraError
        ``huggingface_hub`` is not installed.
    """
    _require_hub()
    from huggingface_hub.errors import HFValidationError
    from huggingface_hub.utils import validate_repo_id  # type: ignore[attr-defined]  # documented so

    # The library also takes a name without an owner, and means the account's own.
    good = repository.count("/") == 1
    try:
        validate_repo_id(repository)
    except HFValidationError:
        good = False
    if not good:
        raise UsageError(
            f"{repository!r} is no name of a repository",
            fix="Say owner/name, such as our-lab/my-dataset, of letters, digits, -, _ and . alone; "
            "neither begins or ends with - or ., has -- or .. in it, or ends with .git.",
        )


def _checked(
    root: Path,
    judge: Judge,
    workers: int | None,
    on_progress: Callable[[str, int, int], None],
) -> str:
    """Return the version of a release of which everything is right."""
    found = verify_release(
        root,
        workers=workers,
        on_progress=lambda done, total: on_progress("Verifying", done, total),
    )
    if not found.good:
        problems = [f"{one.path} {one.message}" for one in found.findings]
        raise DamagedDataError(
            f"is not as it was released: {_some(problems)}",
            where=root,
            fix=f"See all with: exumi release verify {root}",
        )
    if found.version is None:
        raise UsageError(
            "states no version, and is no release", where=root, fix="Make one with: exumi release"
        )
    errors = judge(root, True).errors
    if errors:
        raise DamagedDataError(
            f"is not valid: {_some(errors)}",
            where=root,
            fix=f"See all with: exumi validate {root}",
        )
    return found.version


def _publish(
    api: "HfApi",
    root: Path,
    repository: str,
    url: str,
    tag: str,
    on_progress: Callable[[str, int, int], None],
) -> Pushed:
    from huggingface_hub import CommitOperationDelete

    manifest = _manifest(read_plain(root / MANIFEST_NAME, MAX_DOCUMENT_BYTES))
    tags = {one.name: one for one in api.list_repo_refs(repository, repo_type=_KIND).tags}
    names = [*(one.path for one in manifest.files), MANIFEST_NAME]
    if tag in tags:
        published = _remote(api, repository, tag)
        if published is None or published != (root / MANIFEST_NAME).read_bytes():
            raise UsageError(
                f"another release {tag} is published there",
                where=repository,
                fix="What is published under a version stays. Release it under a later one.",
            )
        commit = tags[tag].target_commit
        return Pushed(url, commit, tag, len(names), (), (), (), already=True)
    there = set(api.list_repo_files(repository, repo_type=_KIND))
    before = _remote(api, repository, "main") if MANIFEST_NAME in there else None
    if DATASET_DOCUMENT in there:
        _refuse_other_data(root, repository, _remote(api, repository, "main", DATASET_DOCUMENT))
    of_release = {MANIFEST_NAME, *_listed(before)}
    gone = sorted(there & of_release - set(names))
    replaced = sorted(there & set(names) - of_release)
    others = sorted(path for path in there - set(names) - set(gone) if not path.startswith("."))
    additions = _upload(api, root, repository, manifest, on_progress)
    deletions = [CommitOperationDelete(path) for path in gone]
    commit = _commit(api, repository, additions, deletions, f"Release {tag}")
    api.create_tag(repository, tag=tag, revision=commit, repo_type=_KIND)
    return Pushed(
        url, commit, tag, len(names), tuple(gone), tuple(replaced), tuple(others), already=False
    )


def _upload(
    api: "HfApi",
    root: Path,
    repository: str,
    manifest: Manifest,
    on_progress: Callable[[str, int, int], None],
) -> "list[CommitOperationAdd]":
    """Upload the large files; small ones travel with the commit."""
    from huggingface_hub import CommitOperationAdd

    sizes = {one.path: one.bytes for one in manifest.files}
    sizes[MANIFEST_NAME] = sha256_of(root / MANIFEST_NAME)[1]
    total, done = sum(sizes.values()), 0
    # What says that the release is there comes last.
    order = sorted(sizes, key=lambda path: (path in _LAST, path.encode()))
    additions = []
    for batch in _batches(order, sizes):
        operations = [CommitOperationAdd(path, str(root / path)) for path in batch]
        on_progress("Uploading", done, total)
        api.preupload_lfs_files(
            repository, operations, repo_type=_KIND, revision="main", free_memory=False
        )
        done += sum(sizes[path] for path in batch)
        additions += operations
    on_progress("Uploading", done, total)
    return additions


def _batches(paths: Sequence[str], sizes: dict[str, int]) -> Iterator[list[str]]:
    batch: list[str] = []
    weight = 0
    for path in paths:
        if batch and (len(batch) == _BATCH_FILES or weight + sizes[path] > _BATCH_BYTES):
            yield batch
            batch, weight = [], 0
        batch.append(path)
        weight += sizes[path]
    if batch:
        yield batch


def _commit(
    api: "HfApi",
    repository: str,
    additions: "list[CommitOperationAdd]",
    deletions: "list[CommitOperationDelete]",
    message: str,
) -> str:
    """Make all appear at once; more files than one commit takes in several, the manifest last."""
    commit = ""
    for first in range(0, len(additions), _COMMIT_FILES):
        part = additions[first : first + _COMMIT_FILES]
        is_last = first + _COMMIT_FILES >= len(additions)
        made = api.create_commit(
            repository,
            [*part, *(deletions if is_last else [])],
            commit_message=message,
            repo_type=_KIND,
        )
        commit = made.oid
    return commit


def _refuse_other_data(root: Path, repository: str, published: bytes | None) -> None:
    """Refuse to take the place of another dataset, or of a later release of this one."""
    try:
        there = parse_dataset(published or b"", DATASET_DOCUMENT)
    except ExumiError:
        return  # whatever it is, it is none of ours
    here = parse_dataset(read_plain(root / DATASET_DOCUMENT, MAX_DOCUMENT_BYTES), root)
    if there.name != here.name:
        raise UsageError(
            f"another dataset is published there: {there.name!r}, and this is {here.name!r}",
            where=repository,
            fix="Name another repository.",
        )
    if there.release is None or here.release is None:
        return
    if _numbers(there.release) > _numbers(here.release):
        raise UsageError(
            f"a later release is published there: {there.release.version}, and this is "
            f"{here.release.version}",
            where=repository,
            fix="What is newest there stays so: release the data under a later version.",
        )


def _numbers(release: Release) -> tuple[int, ...]:
    return tuple(int(number) for number in release.version.split("."))


def _remote(
    api: "HfApi", repository: str, revision: str, name: str = MANIFEST_NAME
) -> bytes | None:
    from huggingface_hub.errors import EntryNotFoundError, LocalEntryNotFoundError

    with tempfile.TemporaryDirectory() as folder:
        try:
            path = api.hf_hub_download(
                repository, name, repo_type=_KIND, revision=revision, local_dir=folder
            )
        except LocalEntryNotFoundError:  # the server was not reached: who knows
            raise
        except EntryNotFoundError:
            return None
        return read_plain(Path(path), MAX_DOCUMENT_BYTES)


def _listed(raw: bytes | None) -> list[str]:
    """Return the files of the release that is there, or none where its manifest is unreadable."""
    try:
        return [] if raw is None else [one.path for one in _manifest(raw).files]
    except ExumiError:
        return []


def _manifest(raw: bytes) -> Manifest:
    return parse_manifest(raw, MANIFEST_NAME)


def _require_hub() -> None:
    try:
        import huggingface_hub  # noqa: F401  # to see whether it is there
    except ImportError:
        raise MissingExtraError(
            "publishing needs huggingface_hub",
            fix='Install it with: pip install "exumi-data[release]"',
        ) from None


@contextmanager
def _quiet_hub() -> Iterator[None]:
    """Keep the library from drawing a bar a file: ours counts them all."""
    from huggingface_hub.utils.tqdm import (
        are_progress_bars_disabled,
        disable_progress_bars,
        enable_progress_bars,
    )

    before = are_progress_bars_disabled()
    if not before:
        disable_progress_bars()
    try:
        yield
    finally:
        if not before:
            enable_progress_bars()


@contextmanager
def _reported(repository: str) -> Iterator[None]:
    """Turn the library's errors into ours."""
    from huggingface_hub.errors import HfHubHTTPError

    # The base of its HTTP library's errors; which library that is depends on the version.
    transport: type[Exception] = HfHubHTTPError.__bases__[0]
    try:
        yield
    except ExumiError:
        raise
    except (OSError, RuntimeError, ValueError, transport) as error:
        cause: BaseException = error
        while cause.__cause__ is not None and not isinstance(cause, HfHubHTTPError):
            cause = cause.__cause__
        status = getattr(getattr(cause, "response", None), "status_code", None)
        fix = "What was uploaded is kept. Run the same command again."
        if status == 429 or (status is not None and status >= 500):
            fix = f"The server is busy or broken: wait some minutes. {fix}"
        if status in (401, 403):
            fix = f"Log in with an account that may write there (hf auth login, or HF_TOKEN). {fix}"
        what = str(cause).strip().partition("\n")[0] or type(cause).__name__
        raise ExumiError(f"could not be published: {what}", where=repository, fix=fix) from error


def _some(texts: Sequence[str]) -> str:
    return "; ".join(texts[:_SHOWN]) + (
        f"; and {len(texts) - _SHOWN} more" if len(texts) > _SHOWN else ""
    )
