"""Sessions that a hub recorded, and the pose stream by which clips are placed in them."""

from collections.abc import Sequence
from pathlib import Path

from exumi_data.catalog import list_episodes
from exumi_data.dataset import DATASET_DOCUMENT
from exumi_data.episode import Episode, StreamView, open_episode
from exumi_data.errors import NotAnEpisodeError, UsageError

__all__ = ["find_sessions", "pose_stream"]

_NAMES_SHOWN = 5


def find_sessions(path: Path, names: Sequence[str], stream: str) -> list[Path]:
    """Return where the sessions are that clips are to be attached to.

    Parameters
    ----------
    path : pathlib.Path
        One episode, or a dataset.
    names : sequence of str
        Ids of sessions in the dataset; none where it holds just one.
    stream : str
        What the clips' stream will be called: an episode that has it is no session without clips.

    Raises
    ------
    UsageError
        It is not clear which.
    NotAnEpisodeError
        There is nothing of the kind.
    """
    if not (path / DATASET_DOCUMENT).is_file():
        if names:
            raise UsageError("--session names episodes of a dataset, and this is none", where=path)
        with open_episode(path):
            return [path]
    found = {}
    for member in list_episodes(path):
        episode_id = Path(member).name.partition(".")[0]
        if names and episode_id not in names:
            continue
        with open_episode(path / member) as episode:
            if names or (episode.of_kind("pose") and stream not in episode):
                found[episode_id] = path / member
    missing = [name for name in names if name not in found]
    if missing:
        raise UsageError(f"no episode {missing[0]}", where=path)
    if not found:
        raise NotAnEpisodeError(
            f"holds no session: no episode that has poses and no stream {stream!r}", where=path
        )
    if len(found) > 1 and not names:
        listed = ", ".join(list(found)[:_NAMES_SHOWN])
        raise UsageError(
            f"holds {len(found)} sessions: {listed}{', ...' if len(found) > _NAMES_SHOWN else ''}",
            where=path,
            fix="Name those that the clips are of, each with --session ID.",
        )
    return list(found.values())


def pose_stream(session: Episode, name: str | None) -> StreamView:
    """Return the poses of the hand that carries the camera.

    Parameters
    ----------
    session : Episode
    name : str or None
        Default: the only pose stream, or the one that is called ``pose``.

    Raises
    ------
    UsageError
        It is not clear which, or there is none.
    """
    streams = {stream.name: stream for stream in session.of_kind("pose")}
    chosen = name or (next(iter(streams)) if len(streams) == 1 else "pose")
    if chosen not in streams:
        raise UsageError(
            f"no pose stream {chosen!r}" if streams else "there are no poses to place clips by",
            where=session.path,
            fix=f"Name one of {', '.join(streams)} with --pose." if streams else None,
        )
    return streams[chosen]
