"""Which episodes are looked at, and which of their moments are shown."""

from collections.abc import Sequence
from dataclasses import dataclass

from exumi_data.stats.html.reading import even
from exumi_data.stats.html.totals import EpisodeRow, Totals

__all__ = ["Job", "jobs_of"]

_MOST_FRAMES = 24  # of a stream in an episode
_FRAMES_IN_ALL = 6_000
_PICTURES = 72
_MOST_TILES = 24


@dataclass(frozen=True, slots=True, kw_only=True)
class Job:
    """One episode to look at.

    Attributes
    ----------
    path : str
    frames : int
        Most frames of each tactile stream to decode.
    rank : int or None
        Place of its moment among those that are shown; None: none is.
    name : str
        What was touched, for the caption.
    """

    path: str
    frames: int
    rank: int | None
    name: str


def jobs_of(paths: Sequence[str], totals: Totals) -> list[Job]:
    """Choose the episodes to look at, so that the work is bounded however many there are.

    Parameters
    ----------
    paths : sequence of str
    totals : Totals

    Returns
    -------
    list of Job
        In the order of the episodes. None without tactile streams.
    """
    streams = len(totals.kinds.get("tactile", ()))
    if not streams or not totals.rows:
        return []
    shown = _shown(totals.rows, _tiles(totals))
    ranks = {row.position: rank for rank, row in enumerate(shown)}
    looked = {totals.rows[int(i)].position for i in even(len(totals.rows), _FRAMES_IN_ALL)}
    frames = max(1, min(_MOST_FRAMES, _FRAMES_IN_ALL // (streams * len(totals.rows))))
    return [
        Job(
            path=paths[row.position],
            frames=frames if row.position in looked else 0,
            rank=ranks.get(row.position),
            name=row.object_id or row.part_id or row.task,
        )
        for row in totals.rows
        if row.position in looked or row.position in ranks
    ]


def _tiles(totals: Totals) -> int:
    each = 2 * min(2, len(totals.kinds["tactile"])) + bool(totals.holding["rgb"])
    return min(_MOST_TILES, _PICTURES // each)


def _shown(rows: Sequence[EpisodeRow], count: int) -> list[EpisodeRow]:
    """Take the strongest contact of each group in turn, so that the sheets show many things."""
    groups: dict[tuple[str, str], list[EpisodeRow]] = {}
    for row in rows:
        groups.setdefault((row.task, row.object_id or row.part_id or ""), []).append(row)
    queues = [
        sorted(group, key=lambda row: (-row.peak, row.position))
        for _, group in sorted(groups.items())
    ]
    if len(queues) > count:
        queues = [queues[int(i)] for i in even(len(queues), count)]
    taken: list[EpisodeRow] = []
    for turn in range(max(len(queue) for queue in queues)):
        taken += [queue[turn] for queue in queues if turn < len(queue)]
        if len(taken) >= count:
            break
    return sorted(
        taken[:count], key=lambda row: (row.task, row.object_id or row.part_id or "", row.position)
    )
