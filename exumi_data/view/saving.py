"""A view as a file: one recording an episode, and the layout; there whole, or not at all."""

import tempfile
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError, ExumiError, LimitError, UnsupportedError, UsageError
from exumi_data.store.files import atomic_file
from exumi_data.view.names import ViewOptions
from exumi_data.view.report import EpisodeView, Unreadable, ViewReport
from exumi_data.view.sdk import require_rerun

if TYPE_CHECKING:
    from exumi_data.view.panels import Panel

__all__ = ["DEFAULT_EPISODES", "Progress", "save_view"]

DEFAULT_EPISODES = 16
"""Most episodes of a dataset that are shown unless somebody asks for more."""

Progress = Callable[[int, int, str], None]
"""Told how it goes: samples done, samples of all episodes, and the recording being written."""


def save_view(
    source: Episode | Dataset,
    path: Path,
    *,
    options: ViewOptions | None = None,
    max_episodes: int = DEFAULT_EPISODES,
    on_progress: Progress | None = None,
) -> ViewReport:
    """Write episodes as a Rerun recording, which any Rerun viewer opens.

    Streams keep their own times: the timeline ``time`` counts from the episode's start, ``utc`` is
    the time of day where the start is known. Frames stored as JPEG are copied verbatim. What is
    damaged is missing from the view, and reported.

    Parameters
    ----------
    source : Episode or Dataset
    path : pathlib.Path
        The ``.rrd`` file; an existing one is replaced when the new one is complete.
    options : ViewOptions, optional
    max_episodes : int
        Most episodes of a dataset, the first ones.
    on_progress : callable, optional

    Returns
    -------
    ViewReport

    Raises
    ------
    MissingExtraError
        The Rerun SDK is not installed.
    UsageError
        There are no such streams, or no episodes.
    DamagedDataError
        No episode can be read at all.
    """
    require_rerun()
    chosen = ViewOptions() if options is None else options
    began = time.monotonic()
    shown = source if isinstance(source, Episode) else source[:max_episodes]
    _check_streams(source, shown, chosen)
    progress = _Counter(on_progress, _samples(shown, chosen))
    with (
        atomic_file(path) as temporary,
        tempfile.TemporaryDirectory(prefix=".partial-", dir=path.parent) as folder,
    ):
        parts = _write_parts(shown, Path(folder), chosen, progress)
        _join(parts, Path(folder), temporary)
        size = temporary.stat().st_size
    return ViewReport(
        application=parts.application,
        episodes=tuple(parts.views),
        unreadable=tuple(parts.unreadable),
        available=1 if isinstance(source, Episode) else len(source),
        bytes=size,
        seconds=time.monotonic() - began,
    )


@dataclass(slots=True)
class _Counter:
    """Counts samples for the progress."""

    tell: Progress | None
    total: int
    done: int = 0
    name: str = ""

    def add(self, samples: int) -> None:
        """Count samples."""
        self.done += samples
        if self.tell is not None:
            self.tell(self.done, max(self.total, self.done), self.name)


@dataclass(slots=True)
class _Parts:
    """The recordings of a view, each in a file of its own."""

    application: str
    files: list[Path]
    views: list[EpisodeView]
    panels: "dict[Panel, int]"
    unreadable: list[Unreadable]


def _check_streams(
    source: Episode | Dataset, shown: Episode | Dataset, options: ViewOptions
) -> None:
    if isinstance(shown, Dataset) and not len(shown):
        raise UsageError("has no episodes to show", where=source.path)
    there = set(shown.streams) if isinstance(shown, Episode) else set(_stream_counts(shown))
    unknown = [name for name in options.streams if name not in there]
    if unknown:
        raise UsageError(
            f"no stream {', '.join(map(repr, unknown))}",
            where=shown.path,
            fix=f"There are: {', '.join(sorted(there)) or 'none'}.",
        )


def _stream_counts(dataset: Dataset) -> dict[str, int]:
    """Return the samples of each stream, of all episodes together."""
    counts: dict[str, int] = {}
    for streams in dataset.catalog.column("streams").to_pylist():
        for stream in streams:
            counts[stream["name"]] = counts.get(stream["name"], 0) + stream["n"]
    return counts


def _samples(shown: Episode | Dataset, options: ViewOptions) -> int:
    if isinstance(shown, Dataset):
        counts = _stream_counts(shown)
    else:
        counts = {name: _length(shown, name) for name in shown.streams}
    return sum(n for name, n in counts.items() if not options.streams or name in options.streams)


def _length(episode: Episode, name: str) -> int:
    try:
        return len(episode[name])
    except (DamagedDataError, LimitError, UnsupportedError):
        return 0  # it is reported when it is read


def _write_parts(
    shown: Episode | Dataset, folder: Path, options: ViewOptions, progress: _Counter
) -> _Parts:
    from exumi_data.view.names import recording_name
    from exumi_data.view.recording import record_episode

    parts = _Parts(_application(shown), [], [], {}, [])
    for number, episode in enumerate(_episodes(shown, parts.unreadable)):
        progress.name = recording_name(episode)
        progress.add(0)
        file = folder / f"{number:06d}.rrd"
        view, panels = record_episode(episode, file, parts.application, options, progress.add)
        parts.files.append(file)
        parts.views.append(view)
        for panel, count in panels.items():
            parts.panels[panel] = max(count, parts.panels.get(panel, 0))
    if not parts.files:
        raise DamagedDataError(
            f"no episode can be read; the first: {parts.unreadable[0].reason}", where=shown.path
        )
    return parts


def _application(shown: Episode | Dataset) -> str:
    name = shown.metadata.name if isinstance(shown, Dataset) else shown.metadata.task.name
    return f"exUMI: {name}"


def _episodes(shown: Episode | Dataset, unreadable: list[Unreadable]) -> Iterator[Episode]:
    """Yield the episodes, each closed afterwards, but for one that the caller opened."""
    if isinstance(shown, Episode):
        yield shown
        return
    for episode_id in shown.ids:
        try:
            episode = shown[episode_id]
        except ExumiError as error:
            unreadable.append(Unreadable(episode_id, error.reason))
            continue
        with episode:
            yield episode


def _join(parts: _Parts, folder: Path, target: Path) -> None:
    """Put the layout and the recordings into one file, without reading them into memory."""
    from exumi_data.view.blueprint import blueprint_of
    from exumi_data.view.program import run_rerun

    layout = folder / "layout.rbl"
    several = len(parts.files) > 1
    blueprint_of(parts.panels, several=several).save(parts.application, layout)
    files: Sequence[str] = [str(file) for file in (layout, *parts.files)]
    home = folder / "home"
    home.mkdir()
    code, printed = run_rerun("rrd", "route", *files, "--output", str(target), home=home)
    if code != 0:
        raise UsageError(
            f"Rerun's program could not write the file: {printed.strip()}", where=target.parent
        )
