"""Making the page of a dataset or an episode, and writing it."""

from collections.abc import Callable
from pathlib import Path

from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import ExumiError, UsageError
from exumi_data.opening import check_outside
from exumi_data.stats.html.collecting import collect_figures, collect_pictures, locations
from exumi_data.stats.html.judgement import Judgement
from exumi_data.stats.html.material import Material
from exumi_data.stats.html.page import GENERATOR, render
from exumi_data.stats.model import Statistics
from exumi_data.store.files import write_atomic

__all__ = ["check_target", "page_of", "write_page"]

Progress = Callable[[str, int, int], None]

_HEAD_BYTES = 1024


def _silent(_what: str, _done: int, _total: int) -> None:
    pass


def page_of(
    source: Dataset | Episode,
    statistics: Statistics,
    *,
    judgement: Judgement | None = None,
    workers: int | None = None,
    on_progress: Progress = _silent,
) -> str:
    """Make the page of a dataset or an episode: one HTML file that needs nothing else.

    Memory does not grow with the length of episodes: frames are decoded one at a time, a bounded
    number in all, each once.

    Parameters
    ----------
    source : Dataset or Episode
    statistics : Statistics
        What `exumi_data.stats.measure` says of it.
    judgement : Judgement, optional
        What a validation found; without, the page says that nothing was validated.
    workers : int, optional
        Processes; default all cores, for more than a few episodes.
    on_progress : callable, optional
        Called with what is done (``Reading``, ``Looking``), how many episodes are, and of how many.

    Returns
    -------
    str
        The same for the same data, to the byte.

    Examples
    --------
    >>> from exumi_data.stats import measure
    >>> dataset = exumi_data.open("my-dataset")  # doctest: +SKIP
    >>> html = page_of(dataset, measure(dataset))  # doctest: +SKIP
    """
    paths = locations(source)
    totals = collect_figures(
        paths, workers=workers, on_progress=lambda done, all_: on_progress("Reading", done, all_)
    )
    pictures = collect_pictures(
        paths,
        totals,
        workers=workers,
        on_progress=lambda done, all_: on_progress("Looking", done, all_),
    )
    dataset = source if isinstance(source, Dataset) else None
    material = Material(
        statistics=statistics,
        totals=totals,
        pictures=pictures,
        judgement=judgement,
        dataset=None if dataset is None else dataset.metadata,
        fingerprint=source.root_sha256 if isinstance(source, Episode) else source.fingerprint,
        splits={} if dataset is None else _splits(dataset),
    )
    return render(material)


def _splits(dataset: Dataset) -> dict[str, dict[str, int]]:
    try:
        found = dataset.splits
    except (ExumiError, OSError):
        return {}  # what is wrong with them is the validator's to say
    return {
        name: {part: len(ids) for part, ids in split.lists.items()} for name, split in found.items()
    }


def check_target(file: Path) -> None:
    """Refuse a file that a page must not take the place of, before the work is done.

    Parameters
    ----------
    file : pathlib.Path
        Where the page is to be written.

    Raises
    ------
    UsageError
        A folder or another file is there, or it lies inside a dataset or an episode.
    """
    check_outside(file)
    target = file.resolve()
    if not target.exists():
        return
    if not target.is_file() or not _is_page(target):
        raise UsageError(
            "exists and is no page of exumi stats", where=file, fix="Name another file."
        )


def _is_page(file: Path) -> bool:
    with file.open("rb") as opened:
        return f'content="{GENERATOR}"'.encode() in opened.read(_HEAD_BYTES)


def write_page(file: Path, page: str) -> int:
    """Write a page, whole or not at all.

    Parameters
    ----------
    file : pathlib.Path
    page : str

    Returns
    -------
    int
        Its size in bytes.
    """
    data = page.encode()
    write_atomic(file, data)
    return len(data)
