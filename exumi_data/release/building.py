"""A planned release built: under a partial name, which becomes the final one when all is there.

What a killed run packed is taken up by the next. Nothing that is written depends on the clock, the
machine or the number of processes: the same dataset gives the same bytes.
"""

import shutil
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from exumi_data.catalog import EPISODES_FOLDER, list_episodes, rows_to_table, write_catalog
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.destination import only_run
from exumi_data.editing.documents import document_bytes, write_splits
from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.leftovers import clean_leftovers
from exumi_data.manifest import MANIFEST_NAME, sha256_of, write_manifest
from exumi_data.model.documents import dump
from exumi_data.release.changelog import CHANGELOG_NAME, changelog_of
from exumi_data.release.changes import Changes, compare
from exumi_data.release.describing import describe
from exumi_data.release.judging import Judge
from exumi_data.release.licence import LICENCE_NAME
from exumi_data.release.packing import JOURNAL_NAME, Packed, pack_episodes
from exumi_data.release.planning import Plan
from exumi_data.release.preview import PREVIEW_FOLDER, choose_preview, write_preview
from exumi_data.store.files import sync_folder, write_atomic

__all__ = ["Built", "build_release", "partial_folder"]


@dataclass(frozen=True, slots=True)
class Built:
    """A release that was built.

    Attributes
    ----------
    path : pathlib.Path
    version : str
    fingerprint : str
        SHA-256 of its manifest: by it, anybody can tell this very release from others.
    episodes, files, bytes : int
    preview : tuple of str
        Ids of the episodes in the preview.
    preview_bytes : int
    changes : Changes or None
    """

    path: Path
    version: str
    fingerprint: str
    episodes: int
    files: int
    bytes: int
    preview: tuple[str, ...]
    preview_bytes: int
    changes: Changes | None


@dataclass(frozen=True, slots=True)
class Told:
    """What the validator found by one rule, as the card tells it."""

    code: str
    severity: str
    message: str
    count: int


def partial_folder(target: Path) -> Path:
    """Return the name under which a release is built.

    Parameters
    ----------
    target : pathlib.Path
        Its final name.
    """
    return target.with_name(f".partial-{target.name}")


def build_release(
    plan: Plan,
    judge: Judge,
    *,
    workers: int | None = None,
    on_progress: Callable[[int, int], None] = lambda _done, _total: None,
) -> Built:
    """Build a release.

    Parameters
    ----------
    plan : Plan
        Without problems.
    judge : callable
        The validator, which also judges what was written.
    workers : int, optional
        Processes; default all cores.
    on_progress : callable
        Told how many episodes are packed, and of how many.

    Returns
    -------
    Built

    Raises
    ------
    UsageError
        The plan has problems, or another run builds the same release.
    DamagedDataError
        An episode cannot be packed, or what was written is not valid.
    """
    if plan.problems or plan.judgement.errors or plan.metadata.release is None:
        raise UsageError("this release has problems that forbid it", where=plan.source)
    target = plan.target.absolute()
    work = partial_folder(target)
    if work.is_symlink():
        raise UsageError("is a link: nothing is written there", where=work, fix="Remove it.")
    work.mkdir(parents=True, exist_ok=True)
    with only_run(work):
        _clear(work, plan)
        packed = pack_episodes(
            plan.chosen, work, removal=plan.removal, workers=workers, on_progress=on_progress
        )
        changes = _write_documents(work, plan, packed, workers)
        preview = _write_preview(work, plan, packed)
        describe(work, _findings(plan), workers=workers)
        manifest = write_manifest(work, {one.path: one.listed for one in packed})
        _check(work, judge)
        built = Built(
            plan.target,
            plan.metadata.release.version,
            sha256_of(manifest)[0],
            len(packed),
            *_size(work),
            preview,
            _size(work / PREVIEW_FOLDER)[1],
            changes,
        )
        (work / JOURNAL_NAME).unlink()
        _finish(work, target)
    return built


def _findings(plan: Plan) -> list[Told] | None:
    """Return what the card tells of the findings, which were made before anything was taken out."""
    report = plan.judgement.report
    if report is None:
        return None
    # Of each rule the first findings are listed; the others are only counted.
    counts = Counter[str](report.not_listed)
    counts.update(one.code for one in report.counted)
    first = {one.code: one for one in reversed(report.counted)}
    cleaned = (lambda text: text) if plan.removal is None else plan.removal.cleaned
    return [
        Told(code, one.severity, cleaned(one.message), counts[code]) for code, one in first.items()
    ]


def _clear(work: Path, plan: Plan) -> None:
    """Remove what an earlier run wrote for another plan; the packed episodes stay."""
    clean_leftovers(work)
    for entry in work.iterdir():
        if entry.name in (EPISODES_FOLDER, JOURNAL_NAME):
            continue
        if entry.is_dir() and not entry.is_symlink():
            shutil.rmtree(entry)
        else:
            entry.unlink()
    wanted = {one.id for one in plan.chosen}
    for path in list_episodes(work):
        if Path(path).name.partition(".")[0] not in wanted:
            (work / path).unlink()
    for folder in sorted((work / EPISODES_FOLDER).glob("*/")):
        if not any(folder.iterdir()):
            folder.rmdir()


def _write_documents(
    work: Path, plan: Plan, packed: list[Packed], workers: int | None
) -> Changes | None:
    metadata = plan.metadata.model_copy(deep=True)
    metadata.splits = []
    write_atomic(work / DATASET_DOCUMENT, document_bytes(dump(metadata)))
    write_splits(work, plan.splits)
    write_catalog(work, rows_to_table([one.row for one in packed]))
    write_atomic(work / LICENCE_NAME, plan.licence_text)
    changes = None
    if plan.previous is not None:
        # Now it is known in which bytes each episode is written; that changes no version.
        write_manifest(work, {one.path: one.listed for one in packed})
        changes = compare(plan.previous, work, workers=workers)
        (work / MANIFEST_NAME).unlink()
    release = plan.metadata.release
    assert release is not None  # noqa: S101  # whoever calls has looked
    text = changelog_of(
        metadata.name,
        release.version,
        release.previous,
        changes,
        plan.older_changelog,
        plan.hidden,
    )
    write_atomic(work / CHANGELOG_NAME, text.encode())
    return changes


def _write_preview(work: Path, plan: Plan, packed: list[Packed]) -> tuple[str, ...]:
    sizes = {str(one.row["id"]): one.bytes for one in packed}
    rows = [one.row for one in packed]
    chosen = choose_preview(rows, sizes, plan.preview_bytes, plan.splits)
    if chosen:
        write_preview(work, chosen, packed, plan.metadata, plan.splits)
    return tuple(chosen)


def _check(work: Path, judge: Judge) -> None:
    """Look at what was written with the validator's eyes; its data were looked at before."""
    for folder in (work, work / PREVIEW_FOLDER):
        errors = judge(folder, False).errors if folder.is_dir() else ()
        if errors:
            listed = "\n".join(f"  {error}" for error in errors)
            raise DamagedDataError(
                f"the release would not be valid:\n{listed}",
                where=folder,
                fix="This is a bug in exUMI Data, or the disk is at fault. Please report it.",
            )


def _size(folder: Path) -> tuple[int, int]:
    files = [one for one in folder.rglob("*") if one.is_file() and one.name != JOURNAL_NAME]
    return len(files), sum(one.stat().st_size for one in files)


def _finish(work: Path, target: Path) -> None:
    if target.is_dir():
        target.rmdir()  # an empty one, or another run was faster: then it stays, and this fails
    work.rename(target)
    sync_folder(target.parent)
