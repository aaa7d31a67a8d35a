"""Episodes become files of another format: in parallel, resumable, whole or not at all.

Every episode is first written as a part of its own, beside the destination; when all are there,
they are put together and take the final name. What was stopped goes on with the parts it has.
"""

import hashlib
import json
import os
import shutil
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import asdict, dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

from exumi_converters.exporter import Exporter, ExportItem, ExportOptions, ExportPlan, Part
from exumi_converters.registry import exporters, find_exporter
from exumi_converters.report import ExportReport, Failure, Progress
from exumi_data import __version__
from exumi_data.catalog import build_catalog, catalog_row, rows_to_table
from exumi_data.dataset import Dataset
from exumi_data.destination import is_current, only_run
from exumi_data.engine import Engine, Outcome, default_workers, map_items, warm_up
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, ExumiError, UsageError
from exumi_data.model import DatasetMetadata
from exumi_data.opening import open as open_data
from exumi_data.store.files import sync_folder, sync_tree, write_atomic

__all__ = ["EXPORT_DOCUMENT", "export", "plan_export"]

EXPORT_DOCUMENT = "exumi_export.json"
"""What a folder that was exported says of where it came from."""

_PLAN = "plan.json"
_SHOWN = 5


def plan_export(
    source: str | Path,
    destination: str | Path,
    *,
    to_format: str,
    options: ExportOptions | None = None,
) -> ExportPlan:
    """Find out what an export would write, and what would be lost. Writes nothing.

    Parameters
    ----------
    source : path-like
        A dataset or an episode.
    destination : path-like
    to_format : str
    options : ExportOptions, optional

    Returns
    -------
    ExportPlan

    Raises
    ------
    UsageError
        An option makes no sense, or not one episode can be written.
    """
    exporter = _exporter(to_format)
    dataset, damaged = _readable(open_source(source))
    return _plan(exporter, dataset, damaged, Path(destination), options or ExportOptions())


def export(
    source: str | Path,
    destination: str | Path,
    *,
    to_format: str,
    options: ExportOptions | None = None,
    engine: Engine | None = None,
    on_plan: Callable[[ExportPlan], None] | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> ExportReport:
    """Write episodes in another format.

    Parameters
    ----------
    source : path-like
        A dataset or an episode.
    destination : path-like
        Must not exist yet. A folder that the same export of the same episodes has made is left as
        it is.
    to_format : str
        A key of `exporters`.
    options : ExportOptions, optional
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_plan : callable, optional
        Called with what will be written and lost, before anything is.
    on_progress : callable, optional
        Called after each episode.

    Returns
    -------
    ExportReport
        If an episode failed and `ExportOptions.keep_going` is not set, nothing was put under the
        final name; the parts are kept, and the next run goes on with them.

    Raises
    ------
    UsageError
        An option or the destination makes no sense, or episodes cannot be written and
        `ExportOptions.keep_going` is not set. Nothing was written.
    """
    began = time.perf_counter()
    options = options or ExportOptions()
    warm_up(__name__, workers=options.workers, engine=engine)
    exporter = _exporter(to_format)
    dataset, damaged = _readable(open_source(source))
    destination = Path(destination)
    plan = _plan(exporter, dataset, damaged, destination, options)
    if on_plan is not None:
        on_plan(plan)
    if plan.refused and not options.keep_going:
        raise UsageError(
            f"{len(plan.refused)} of {len(plan.items) + len(plan.refused)} episodes cannot be "
            f"written as {to_format}: " + _named(plan.refused),
            where=source,
            fix="Pass --keep-going to leave them out.",
        )
    about = _about(exporter, dataset, plan, options)
    report = partial(
        ExportReport,
        source=str(source),
        destination=str(destination),
        exporter=_versioned(exporter),
        layout=plan.layout,
        total=len(plan.items) + len(plan.refused),
        losses=plan.losses,
    )
    if _is_there(destination, about):
        return report(
            skipped=len(plan.items),
            failed=plan.refused,
            notices=plan.notices,
            seconds=time.perf_counter() - began,
        )
    with _work_folder(destination, about) as (work, notices):
        run = _Parts(exporter, dataset, plan, work, on_progress, began)
        failed = run.write_all(options.workers, engine)
        written = len(plan.items) - len(failed)
        finished = written > 0 and (not failed or options.keep_going)
        if finished:
            _finish(exporter, run.parts(), plan, about, work, destination, durable=options.durable)
        else:
            notices.append("nothing was written under the final name; run again to go on")
        return report(
            written=written if finished else 0,
            failed=(*plan.refused, *failed),
            notices=(*plan.notices, *notices),
            frames=run.frames,
            bytes=_size(destination) if finished else 0,
            seconds=time.perf_counter() - began,
        )


def open_source(source: str | Path) -> Dataset:
    """Open a dataset; an episode becomes a dataset of one.

    Raises
    ------
    NotAnEpisodeError
        Neither is there.
    """
    opened = open_data(source)
    if isinstance(opened, Dataset):
        return opened
    with opened:
        path = Path(opened.path).resolve()
        row = catalog_row(opened, path.name)
        metadata = DatasetMetadata(name=path.name, licence=opened.metadata.licence)
        return Dataset(str(path.parent), metadata, rows_to_table([row]))


def _readable(dataset: Dataset) -> tuple[Dataset, tuple[Failure, ...]]:
    """Return the episodes that can be read, with a catalog that is true, and the others.

    The result names digests: they must not be those of a catalog that was left behind.
    """
    rows = dataset.catalog.to_pylist()
    stale = [row["path"] for row in rows if not is_current(Path(dataset.path, row["path"]), row)]
    if not stale:
        return dataset, ()
    built, problems = build_catalog(Path(dataset.path), paths=stale)
    fresh = {row["path"]: row for row in built.to_pylist()}
    wrong = {problem.item: _reason(problem.error) for problem in problems if problem.error}
    kept = [fresh.get(row["path"], row) for row in rows if row["path"] not in wrong]
    failed = [Failure(row["id"], wrong[row["path"]]) for row in rows if row["path"] in wrong]
    return Dataset(dataset.path, dataset.metadata, rows_to_table(kept)), tuple(failed)


def _exporter(name: str) -> Exporter:
    known = exporters()
    if name not in known:
        raise UsageError(f"Invalid format ({name}). Supported values are {', '.join(known)}")
    return known[name]


def _versioned(exporter: Exporter) -> str:
    return f"{exporter.name}/{exporter.version}"


def _plan(
    exporter: Exporter,
    dataset: Dataset,
    damaged: tuple[Failure, ...],
    destination: Path,
    options: ExportOptions,
) -> ExportPlan:
    if len(dataset) + len(damaged) == 0:
        raise UsageError("there is no episode", where=dataset.path)
    planned = None
    if len(dataset):
        planned = exporter.plan(_in_order(dataset), destination, options)
    refused = (*damaged, *(planned.refused if planned else ()))
    if planned is None or not planned.items:
        raise UsageError(
            f"not one of {len(refused)} episodes can be written as {exporter.name}: "
            + _named(refused),
            where=dataset.path,
        )
    return replace(planned, refused=refused)


def _in_order(dataset: Dataset) -> Dataset:
    """Sort episodes by when they were recorded, or else as their source had them.

    Their ids, by which a dataset is sorted, are drawn by lot.
    """
    keys = []
    for episode in dataset:
        with episode:
            keys.append((episode.metadata.start or "", episode.metadata.source.key or ""))
    places = sorted(range(len(keys)), key=keys.__getitem__)
    return dataset.select([dataset.ids[place] for place in places])


def _named(failures: Sequence[Failure]) -> str:
    named = "; ".join(f"{failure.name}: {failure.reason}" for failure in failures[:_SHOWN])
    more = len(failures) - _SHOWN
    return f"{named}; and {more} more" if more > 0 else named


def _about(
    exporter: Exporter, dataset: Dataset, plan: ExportPlan, options: ExportOptions
) -> dict[str, Any]:
    """Say what a result is made from: equal for equal results."""
    rows = dataset.select([item.id for item in plan.items]).catalog
    digests = zip(
        rows.column("id").to_pylist(),
        rows.column("digest").to_pylist(),
        rows.column("derived_digest").to_pylist(),
        strict=True,
    )
    return {
        "tool": "exumi-data",
        "tool_version": __version__,
        "exporter": _versioned(exporter),
        "layout": plan.layout,
        "settings": dict(options.settings),
        "shared": plan.shared,
        "lost": [asdict(loss) for loss in plan.losses],
        "left_out": [asdict(failure) for failure in plan.refused],
        "episodes": [
            {"id": name, "digest": digest, "derived_digest": derived}
            for name, digest, derived in digests
        ],
    }


def _is_there(destination: Path, about: Mapping[str, Any]) -> bool:
    """Whether the same export is complete there already.

    Raises
    ------
    UsageError
        Something else is there.
    """
    if not (destination.exists() or destination.is_symlink()):
        return False
    if destination.is_dir():
        try:
            found = json.loads((destination / EXPORT_DOCUMENT).read_bytes())
        except (OSError, ValueError):
            found = None
        if found == json.loads(_json(about)):
            return True
        if found is None and not any(destination.iterdir()):
            return False
    raise UsageError(
        "exists already, and is not this export of these episodes",
        where=destination,
        fix="Remove it, or name another destination.",
    )


@contextmanager
def _work_folder(destination: Path, about: Mapping[str, Any]) -> Iterator[tuple[Path, list[str]]]:
    """Make or take up the folder of parts, for this run alone."""
    work = destination.absolute().with_name(f".partial-{destination.name}")
    notices: list[str] = []
    try:
        work.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(
            f"cannot be made ({error.strerror})",
            where=destination,
            fix="Name a folder you may write to.",
        ) from None
    with only_run(work):
        digest = hashlib.sha256(_json(about)).hexdigest()
        if _planned(work) not in (None, digest):
            for entry in work.iterdir():
                _remove(entry)
            notices.append("what another export had left unfinished there was removed")
        write_atomic(work / _PLAN, json.dumps({"sha256": digest}).encode())
        yield work, notices


def _planned(work: Path) -> str | None:
    try:
        return str(json.loads((work / _PLAN).read_bytes())["sha256"])
    except (OSError, ValueError, KeyError, TypeError):
        return None if not any(work.iterdir()) else ""


def _json(value: Mapping[str, Any]) -> bytes:
    return (json.dumps(value, indent=1, ensure_ascii=False, allow_nan=False) + "\n").encode()


@dataclass(frozen=True, slots=True)
class _Task:
    """One episode to write; travels to a worker."""

    item: ExportItem
    path: str


class _Parts:
    """The parts of one export: which are there, and the writing of the others."""

    def __init__(
        self,
        exporter: Exporter,
        dataset: Dataset,
        plan: ExportPlan,
        work: Path,
        on_progress: Callable[[Progress], None] | None,
        began: float,
    ) -> None:
        self._exporter = exporter
        self._dataset = dataset
        self._plan = plan
        self._work = work
        self._on_progress = on_progress
        self._began = began
        self._failed: list[Failure] = []
        self.frames = 0

    def write_all(self, workers: int | None, engine: Engine | None) -> list[Failure]:
        """Write the parts that are missing; return the episodes that failed."""
        places = {name: place for place, name in enumerate(self._dataset.ids)}
        todo = [
            _Task(item, self._dataset.episode_location(places[item.id]))
            for item in self._plan.items
            if not _result_path(self._work, item).exists()
        ]
        done = len(self._plan.items) - len(todo)
        function = partial(
            _write_one,
            to_format=self._exporter.name,
            plan=replace(self._plan, items=()),
            work=self._work,
        )
        if engine is None:
            workers = min(workers or default_workers(), max(1, len(todo)))
        with closing(map_items(function, todo, workers=workers, engine=engine)) as outcomes:
            for outcome in outcomes:
                done += 1
                self._take(outcome, done)
        self._failed.sort(key=lambda failure: failure.name)
        return self._failed

    def _take(self, outcome: Outcome["_Task", int], done: int) -> None:
        if outcome.error is not None:
            self._failed.append(Failure(outcome.item.item.id, _reason(outcome.error)))
        self.frames += outcome.value or 0
        if self._on_progress is not None:
            status = "converted" if outcome.error is None else "failed"
            seconds = time.perf_counter() - self._began
            total = len(self._plan.items)
            self._on_progress(
                Progress(done, total, outcome.item.item.id, status, self.frames, seconds)  # type: ignore[arg-type]  # one of the literals
            )

    def parts(self) -> list[Part]:
        """Return the parts that are there, in the order of the plan."""
        found = []
        for item in self._plan.items:
            path = _result_path(self._work, item)
            if path.exists():
                result = json.loads(path.read_bytes())
                found.append(Part(item=item, folder=_part_folder(self._work, item), result=result))
        return found


def _reason(error: Exception) -> str:
    if isinstance(error, ExumiError):
        return str(error)
    if isinstance(error, OSError):
        where = f"{error.filename}: " if error.filename else ""
        return f"{where}{error.strerror or error}"
    return f"unexpected {type(error).__name__}: {error}. This is a defect: please report it."


def _part_folder(work: Path, item: ExportItem) -> Path:
    return work / f"part-{item.index:06d}"


def _result_path(work: Path, item: ExportItem) -> Path:
    return work / f"part-{item.index:06d}.json"


def _write_one(task: _Task, *, to_format: str, plan: ExportPlan, work: Path) -> int:
    """Write one part; runs in a worker."""
    item = task.item
    folder = _part_folder(work, item)
    _remove(folder)
    folder.mkdir()
    exporter = find_exporter(to_format)
    with open_episode(task.path) as episode:
        if episode.id != item.id:
            raise DamagedDataError(f"this is the episode {episode.id}", where=task.path)
        episode.check_complete()  # what is missing would be zeros in the other format
        try:
            result = exporter.write(item, episode, folder, plan)
        except BaseException:
            with suppress(OSError):
                _remove(folder)  # on a full disk, half a part would only be in the way
            raise
    write_atomic(_result_path(work, item), _json(result))
    return int(result.get("frames", 0))


def _finish(
    exporter: Exporter,
    parts: Sequence[Part],
    plan: ExportPlan,
    about: Mapping[str, Any],
    work: Path,
    destination: Path,
    *,
    durable: bool,
) -> None:
    written = {part.item.id for part in parts}
    about = {**about, "episodes": [e for e in about["episodes"] if e["id"] in written]}
    target = work / f"result-{destination.name}"
    _remove(target)
    if plan.writes == "folder":
        target.mkdir()
    exporter.assemble(_to_be_moved(parts, work), target, plan, about)
    if plan.writes == "folder":
        (target / EXPORT_DOCUMENT).write_bytes(_json(about))
    if durable:
        _sync(target)
    if destination.is_dir():
        destination.rmdir()  # an empty one
    target.rename(destination)
    sync_folder(destination.absolute().parent)
    shutil.rmtree(work)


def _to_be_moved(parts: Sequence[Part], work: Path) -> list[Part]:
    """Return the parts as links of their files, so that they are still there if this stops here.

    Where there are no links, or no room for what is copied, the parts themselves are handed out:
    then they count as not written from here on.
    """
    links = work / "links"
    _remove(links)
    try:
        if shutil.disk_usage(work).free > _size(work):
            return [replace(part, folder=_linked(part.folder, links)) for part in parts]
    except OSError:
        _remove(links)
    for part in parts:
        _result_path(work, part.item).unlink()
    return list(parts)


def _linked(folder: Path, links: Path) -> Path:
    copy = links / folder.name
    shutil.copytree(folder, copy, copy_function=os.link)
    return copy


def _sync(target: Path) -> None:
    if target.is_dir():
        sync_tree(target)
        return
    descriptor = os.open(target, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _remove(path: Path) -> None:
    if path.is_dir() and not path.is_symlink():
        shutil.rmtree(path)
    else:
        path.unlink(missing_ok=True)


def _size(path: Path) -> int:
    if path.is_file():
        return path.stat().st_size
    return sum(file.stat().st_size for file in path.rglob("*") if file.is_file())
