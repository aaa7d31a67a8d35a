"""A run over many episodes: in parallel, resumable, every failure named, the catalog kept true.

What `convert` and `prepare` share is here; each hands in a function that makes one episode.
"""

import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Generic, Literal, TypeVar

from pydantic import ValidationError

from exumi_converters.destination import drop_catalog, open_destination, refresh_catalog
from exumi_converters.report import Failure, Flag, Progress
from exumi_converters.resume import existing_path, is_current, next_revision, read_metadata
from exumi_data.catalog import (
    catalog_row,
    episode_path,
    list_episodes,
    read_catalog,
)
from exumi_data.destination import only_run
from exumi_data.engine import Engine, Outcome, default_workers, map_items
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError
from exumi_data.leftovers import clean_leftovers
from exumi_data.model import DatasetMetadata, EpisodeMetadata
from exumi_data.model.documents import problems_of
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["Done", "Run", "attempt", "make_episode", "opened_run"]

Item = TypeVar("Item")


@dataclass(slots=True)
class Done:
    """What became of one episode; travels from the worker to the run.

    Attributes
    ----------
    name : str
    status : {"converted", "skipped", "failed"}
    id : str or None
        None when it failed before the id was known.
    frames : int
        Written now.
    flags : tuple of Flag
    row : dict or None
        Its catalog row, when it was written now.
    reason : str
        Why it failed.
    """

    name: str
    status: Literal["converted", "skipped", "failed"]
    id: str | None = None
    frames: int = 0
    flags: tuple[Flag, ...] = ()
    row: dict[str, Any] | None = None
    reason: str = ""


def make_episode(
    root: Path,
    name: str,
    metadata: EpisodeMetadata,
    write: Callable[[EpisodeWriter], int],
    *,
    durable: bool,
    derived: Sequence[str] | None = None,
) -> Done:
    """Make one episode of a dataset, unless it is there already.

    Parameters
    ----------
    root : pathlib.Path
        The dataset.
    name : str
        For reports.
    metadata : EpisodeMetadata
        With everything that does not need the data; the revision is set here.
    write : callable
        Writes the streams; returns the number of frames.
    durable : bool
    derived : sequence of str, optional
        Derived arrays without which it is not complete; default: the activity of all tactile
        streams.

    Returns
    -------
    Done
        ``converted`` or ``skipped``.
    """
    existing = existing_path(root, metadata.id)
    old = None
    if existing is not None:
        current = is_current(existing, metadata.source, derived)
        if current is not None:
            with current:
                return Done(name, "skipped", metadata.id, flags=_flags(name, current))
        old = read_metadata(existing)
    metadata.revision = next_revision(old, metadata)
    relative = episode_path(metadata.id)
    drop_catalog(root)
    try:
        with EpisodeWriter(
            root / relative, metadata, overwrite=True, durable="filesystem" if durable else False
        ) as writer:
            frames = write(writer)
    except ExumiError as error:
        if existing is not None:
            error.fix = f"{error.fix or ''} The episode of an earlier run was kept.".strip()
        raise
    if existing is not None and existing != root / relative:
        existing.unlink()  # the packed form of what has just been made anew
    with open_episode(root / relative) as episode:
        row = catalog_row(episode, relative)
        return Done(name, "converted", metadata.id, frames, _flags(name, episode), row)


def _flags(name: str, episode: Episode) -> tuple[Flag, ...]:
    return tuple(
        Flag(name, note.code, note.message, note.severity) for note in episode.metadata.quality
    )


def attempt(
    name: str, describe: Callable[[], EpisodeMetadata], make: Callable[[EpisodeMetadata], Done]
) -> Done:
    """Describe an episode, then make it; a failure becomes a result with its reason.

    Parameters
    ----------
    name : str
    describe : callable
        Returns the episode's metadata.
    make : callable
        Takes them.
    """
    episode_id = None
    try:
        metadata = describe()
        episode_id = metadata.id
        return make(metadata)
    except ExumiError as error:
        reason = str(_rebuilt(error))
    except ValidationError as error:
        reason = "; ".join(f"{message} @ {path}" for message, path in problems_of(error))
    except OSError as error:
        where = f"{error.filename}: " if error.filename else ""
        reason = f"{where}{error.strerror or error}"
    return Done(name, "failed", episode_id, reason=reason)


def _rebuilt(error: ExumiError) -> ExumiError:
    """Make an error's text from its fields, which may have been added to."""
    return ExumiError(error.what, where=error.where, fix=error.fix)


@dataclass(slots=True)
class Run(Generic[Item]):
    """A run that is going on.

    Attributes
    ----------
    root : pathlib.Path
        The dataset that is written.
    notices : list of str
    converted, skipped, frames : int
    flagged : list of Flag
    failed : list of Failure
    ids : dict of str to str
        Name of each item to the id of its episode, where there is one.
    """

    root: Path
    workers: int | None
    engine: Engine | None
    on_progress: Callable[[Progress], None] | None
    began: float
    notices: list[str] = field(default_factory=list)
    converted: int = 0
    skipped: int = 0
    frames: int = 0
    flagged: list[Flag] = field(default_factory=list)
    failed: list[Failure] = field(default_factory=list)
    ids: dict[str, str] = field(default_factory=dict)
    _known: list[dict[str, Any]] = field(default_factory=list)
    _rows: dict[str, dict[str, Any]] = field(default_factory=dict)
    _touched: set[str] = field(default_factory=set)

    @property
    def seconds(self) -> float:
        """Since the run began."""
        return time.perf_counter() - self.began

    def work(
        self,
        function: Callable[[Item], Done],
        items: Sequence[Item],
        name_of: Callable[[Item], str],
    ) -> None:
        """Make all episodes.

        Parameters
        ----------
        function : callable
            A module-level function, or a partial of one: it is sent to other processes.
        items : sequence
        name_of : callable
        """
        total = len(items) + len(self.failed)
        done = len(self.failed)
        workers = self.workers
        if self.engine is None:
            workers = min(workers or default_workers(), max(1, len(items)))
        # Closed at once, whatever happens here: workers must not go on when the run has ended.
        with closing(map_items(function, items, workers=workers, engine=self.engine)) as outcomes:
            for outcome in outcomes:
                done += 1
                result = outcome.value or _crashed(outcome, name_of(outcome.item))
                self._take(result)
                if self.on_progress is not None:
                    self.on_progress(
                        Progress(done, total, result.name, result.status, self.frames, self.seconds)
                    )
        self.failed.sort(key=lambda failure: failure.name)
        self.flagged.sort(key=lambda flag: (flag.name, flag.code))

    def _take(self, done: Done) -> None:
        if done.id is not None:
            self._touched.add(done.id)
        if done.status == "failed":
            self.failed.append(Failure(done.name, done.reason))
            return
        assert done.id is not None  # noqa: S101  # only failures lack one
        self.ids[done.name] = done.id
        self.flagged += done.flags
        self.frames += done.frames
        if done.row is None:
            self.skipped += 1
        else:
            self.converted += 1
            self._rows[done.row["path"]] = done.row

    def finish(self) -> tuple[str, ...]:
        """Write the catalog; return the episodes that the source does not explain."""
        self.notices += refresh_catalog(
            self.root, self._rows, self._known, workers=self.workers, engine=self.engine
        )
        return tuple(
            path
            for path in list_episodes(self.root)
            if Path(path).name.partition(".")[0] not in self._touched
        )


def _crashed(outcome: Outcome[Any, Done], name: str) -> Done:
    error = outcome.error
    reason = str(error)
    if not isinstance(error, ExumiError):
        reason = f"unexpected {type(error).__name__}: {error}. This is a defect: please report it."
    return Done(name, "failed", reason=reason)


@contextmanager
def opened_run(
    destination: Path,
    metadata: DatasetMetadata,
    workers: int | None,
    on_progress: Callable[[Progress], None] | None,
    began: float,
    *,
    engine: Engine | None = None,
) -> Iterator[Run[Any]]:
    """Make or take up the destination, clean it, and keep other runs out of it.

    Raises
    ------
    UsageError
        The destination holds something else, or another run writes into it.
    """
    root = open_destination(destination, metadata)
    with only_run(root):
        notices = clean_leftovers(root)
        table = read_catalog(root)
        run: Run[Any] = Run(
            root,
            workers,
            engine,
            on_progress,
            began,
            notices,
            _known=[] if table is None else table.to_pylist(),
        )
        try:
            yield run
        except BaseException:
            # A worker that was stopped at the wrong moment may have left something; all have ended.
            with suppress(OSError):
                clean_leftovers(root)
            raise
