"""An episode shortened to a stretch of its time: a new revision, with less in it."""

import os
import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from exumi_data.editing.cutting import (
    Stretch,
    check_known,
    cut_annotations,
    cut_stream,
    samples_in,
)
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UsageError
from exumi_data.model.description import LossyStep
from exumi_data.model.episode import EpisodeMetadata
from exumi_data.model.images import VideoImages
from exumi_data.model.streams import images_of
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.files import claim_folder
from exumi_data.store.pack import pack

__all__ = ["Trim", "stretch_of", "trim_episode"]

_SALIENT = "salient"
_LONGEST_S = 2**63 / 1e9


@dataclass(frozen=True, slots=True)
class Trim:
    """What is left of an episode.

    Attributes
    ----------
    id : str
    path : str
    revision : int
        After the change.
    kept : dict of str to (int, int)
        For each stream how many samples stay, and how many there were.
    whole : tuple of str
        Streams whose video files stay whole, because they hold frames of the stretch.
    dropped : tuple of str
        Derived arrays that are left out: how they follow from a part is not known.
    """

    id: str
    path: str
    revision: int
    kept: dict[str, tuple[int, int]]
    whole: tuple[str, ...]
    dropped: tuple[str, ...]

    @property
    def is_changed(self) -> bool:
        """Whether any sample goes."""
        return any(count != total for count, total in self.kept.values())


def trim_episode(
    path: Path, start_s: float | None, end_s: float | None, *, dry_run: bool = False
) -> Trim:
    """Shorten an episode to the samples from one moment up to another.

    Times stay what they are: they count from the same epoch. Video files are never cut.

    Parameters
    ----------
    path : pathlib.Path
        The episode's folder or zip.
    start_s, end_s : float or None
        Seconds of the episode's time; None: from the first sample, or to the last.
    dry_run : bool
        Only tell what would be left.

    Returns
    -------
    Trim

    Raises
    ------
    UsageError
        Nothing would be left, or all.
    UnsupportedError
        A stream has an array that this library cannot cut.
    DamagedDataError
        Something is missing or damaged. Of the samples themselves only a run that writes finds it.
    """
    stretch = stretch_of(start_s, end_s)
    with open_episode(path) as episode:
        ranges = {name: samples_in(episode[name], stretch) for name in episode}
        kept = {name: (b - a, len(episode[name])) for name, (a, b) in ranges.items()}
        if not any(count for count, _ in kept.values()):
            raise UsageError("nothing would be left", where=path, fix=_ends(episode))
        changes = any(count != total for count, total in kept.values())
        derived = [] if episode.derived is None else list(episode.derived.items)
        known = [key for key in derived if key.rpartition("/")[2] in ("activity", _SALIENT)]
        result = Trim(
            episode.id,
            str(path),
            episode.metadata.revision + changes,
            kept,
            tuple(name for name in episode if _is_video(episode, name)),
            tuple(key for key in derived if key not in known),
        )
        if changes:
            episode.check_complete()
            for name in episode:
                check_known(episode, name)
        if changes and not dry_run:
            _write(path, episode, stretch, ranges, known)
    return result


def _is_video(episode: Episode, name: str) -> bool:
    return isinstance(images_of(episode[name].metadata), VideoImages)


def stretch_of(start_s: float | None, end_s: float | None) -> Stretch:
    """Return the stretch of time from one moment up to another.

    Parameters
    ----------
    start_s, end_s : float or None
        Seconds of the episode's time; None: from the first sample, or to the last.

    Raises
    ------
    UsageError
        There is none.
    """
    ends = np.iinfo(np.int64)
    for moment in (start_s, end_s):
        if moment is not None and not abs(moment) < _LONGEST_S:
            raise UsageError(
                f"{moment} s is no moment of an episode", fix="Say seconds, such as 1.5."
            )
    first = ends.min if start_s is None else round(start_s * 1e9)
    stop = ends.max if end_s is None else round(end_s * 1e9)
    if first >= stop:
        raise UsageError(f"from {start_s} s to {end_s} s is no stretch of time")
    return Stretch(int(first), int(stop), 0)


def _ends(episode: Episode) -> str:
    times = [stream.time[[0, -1]] for stream in episode.streams.values() if len(stream)]
    if not times:
        return "It has no samples."
    first, last = min(int(t[0]) for t in times), max(int(t[1]) for t in times)
    return f"Its samples are from {first * 1e-9:.3f} s to {last * 1e-9:.3f} s."


def _write(
    path: Path,
    episode: Episode,
    stretch: Stretch,
    ranges: dict[str, tuple[int, int]],
    derived: list[str],
) -> None:
    metadata = episode.metadata.model_copy(deep=True)
    metadata.revision, metadata.streams = metadata.revision + 1, {}
    metadata.annotations = cut_annotations(metadata.annotations, stretch)
    times = [episode[name].time[a:b] for name, (a, b) in ranges.items() if b > a]
    first, last = min(int(t[0]) for t in times), max(int(t[-1]) for t in times)
    step = LossyStep(
        step="trim",
        detail=f"only what lies from {first} to {last} ns of revision "
        f"{episode.metadata.revision} was kept",
    )
    metadata.source.lossy = [*(metadata.source.lossy or []), step]
    if path.is_dir():
        _write_folder(path, episode, metadata, stretch, ranges, derived)
        return
    aside = path.with_name(f".partial-trim-{episode.id}")
    claim = claim_folder(aside)
    try:
        folder = aside / path.name.removesuffix(".zip")
        _write_folder(folder, episode, metadata, stretch, ranges, derived)
        pack(folder, path, overwrite=True)
    finally:
        shutil.rmtree(aside, ignore_errors=True)
        os.close(claim)


def _write_folder(
    path: Path,
    episode: Episode,
    metadata: EpisodeMetadata,
    stretch: Stretch,
    ranges: dict[str, tuple[int, int]],
    derived: list[str],
) -> None:
    with EpisodeWriter(path, metadata, overwrite=True) as writer:
        for name in episode:
            cut_stream(episode, name, writer, stretch)
        writer.copy_group(episode, "calibration")
        writer.copy_group(episode, "annotations")
        for key in derived:
            stream, _, name = key.partition("/")
            values = episode.derived_array(key)
            assert episode.derived is not None  # noqa: S101  # `derived` is of its items
            item = episode.derived.items[key]
            if values is not None:
                writer.add_derived(
                    stream,
                    name,
                    _part(values, ranges[stream], is_index=name == _SALIENT),
                    algorithm=item.algorithm,
                    parameters=item.parameters,
                    inputs=item.inputs,
                    **(item.model_extra or {}),
                )


def _part(values: np.ndarray, chosen: tuple[int, int], *, is_index: bool) -> np.ndarray:
    first, last = chosen
    if not is_index:
        return values[first:last]
    inside: np.ndarray = values[(values >= first) & (values < last)]
    inside -= values.dtype.type(first)  # a copy: the array's own are not touched
    return inside
