"""Going through the episodes of a dataset twice: once for numbers, once for pictures."""

from collections.abc import Callable, Sequence

from exumi_data.dataset import Dataset
from exumi_data.engine import map_items
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError
from exumi_data.stats.html.choosing import Job, jobs_of
from exumi_data.stats.html.figures import EpisodeFigures
from exumi_data.stats.html.looking import Looked, look
from exumi_data.stats.html.pictures import Pictures
from exumi_data.stats.html.reading import read_figures
from exumi_data.stats.html.totals import Totals
from exumi_data.stats.model import Unreadable

__all__ = ["collect_figures", "collect_pictures", "locations"]

Progress = Callable[[int, int], None]

_MANY_EPISODES = 200
_FEW_PICTURES = 8


def locations(source: Dataset | Episode) -> list[str]:
    """List the paths of a dataset's episodes, or of the one.

    Parameters
    ----------
    source : Dataset or Episode
    """
    if isinstance(source, Episode):
        return [source.path]
    return [source.episode_location(index) for index in range(len(source))]


def _figures(item: tuple[int, str]) -> EpisodeFigures:
    with open_episode(item[1]) as episode:
        return read_figures(episode)


def _nothing(_done: int, _total: int) -> None:
    pass


def collect_figures(
    paths: Sequence[str], *, workers: int | None = None, on_progress: Progress = _nothing
) -> Totals:
    """Read the figures of all episodes and add them up.

    Parameters
    ----------
    paths : sequence of str
    workers : int, optional
        Processes. Default: one for up to 200 episodes, else all cores.
    on_progress : callable
        Called with the number of episodes done, and of all.

    Returns
    -------
    Totals
        The same with any number of workers: episodes are added in their order.
    """
    totals = Totals()
    processes = 1 if workers is None and len(paths) <= _MANY_EPISODES else workers
    waiting: dict[int, EpisodeFigures | None] = {}
    added = 0
    items = list(enumerate(paths))
    for done, outcome in enumerate(map_items(_figures, items, workers=processes), 1):
        position, path = outcome.item
        waiting[position] = outcome.value
        if outcome.error is not None:
            totals.unreadable.append(_unreadable(path, outcome.error))
        while added in waiting:
            figures = waiting.pop(added)
            if figures is not None:
                totals.add(added, figures)
            added += 1
        on_progress(done, len(paths))
    totals.unreadable.sort(key=lambda item: item.path)
    return totals


def _unreadable(path: str, error: Exception) -> Unreadable:
    if not isinstance(error, ExumiError | OSError):
        raise error
    return Unreadable(path, str(error))


def collect_pictures(
    paths: Sequence[str],
    totals: Totals,
    *,
    workers: int | None = None,
    on_progress: Progress = _nothing,
) -> Pictures:
    """Decode some frames of the tactile streams: what was touched where, and contact sheets.

    Parameters
    ----------
    paths : sequence of str
    totals : Totals
        Of the same episodes: they say which moments are worth showing.
    workers : int, optional
        Processes. Default: all cores, for more than a few episodes.
    on_progress : callable
        Called with the number of episodes done, and of all.

    Returns
    -------
    Pictures
    """
    pictures = Pictures()
    jobs = jobs_of(paths, totals)
    processes = 1 if workers is None and len(jobs) <= _FEW_PICTURES else workers
    tiles: dict[int, Looked] = {}
    for done, outcome in enumerate(map_items(look, jobs, workers=processes), 1):
        job: Job = outcome.item
        if outcome.error is not None:
            pictures.damaged.append(_unreadable(job.path, outcome.error))
        if outcome.value is not None:
            pictures.add(outcome.value)
            if outcome.value.tile is not None:
                tiles[job.rank or 0] = outcome.value
        on_progress(done, len(jobs))
    pictures.damaged.sort(key=lambda item: item.path)
    pictures.tiles.extend(tile for rank in sorted(tiles) if (tile := tiles[rank].tile) is not None)
    return pictures
