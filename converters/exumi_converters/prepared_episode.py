"""One episode made ready for training: frames fitted once, everything else carried along."""

from collections.abc import Collection, Mapping, Sequence

from exumi_converters.prepare_settings import PrepareSettings
from exumi_converters.prepared_calibration import carry_calibration
from exumi_converters.prepared_combined import Pair, combined_making, pairs_of
from exumi_converters.prepared_one import is_ready, making_of, measure_of, measured_anew
from exumi_converters.prepared_stream import Making, measure_copied, write_made
from exumi_data.episode import Episode, StreamView
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["derived_afterwards", "write_prepared"]


def write_prepared(parent: Episode, writer: EpisodeWriter, settings: PrepareSettings) -> int:
    """Write the streams of a prepared episode.

    Parameters
    ----------
    parent : Episode
        Complete (`Episode.check_complete`).
    writer : EpisodeWriter
    settings : PrepareSettings

    Returns
    -------
    int
        Frames written.

    Raises
    ------
    DamagedDataError
        A frame or a calibration array of the parent cannot be read.
    MetadataError
        A calibration item that is needed is none.
    UnsupportedError
        A stream whose frames are written anew has an array of a newer version.
    UsageError
        What is asked for cannot be made of this episode.
    """
    pairs = pairs_of(parent) if _combines(parent, settings) else []
    gone = _gone(pairs)
    _rename(writer, gone)
    made: dict[str, Making] = {}
    frames = 0
    for name, view in parent.streams.items():
        making = _making(parent, view, pairs, settings)
        if making is not None:
            made[making.name] = making
            write_made(making, writer, settings)
            frames += len(making.time)
        elif name not in gone:
            writer.copy_stream(parent, name)
            frames += len(view) if view.is_image else 0
            if measured_anew(parent, view, settings):
                measure_copied(view, measure_of(parent, view), writer)
    carry_calibration(parent, writer, made, gone, settings)
    writer.copy_group(parent, "annotations")
    _carry_derived(parent, writer, _carried_keys(parent, gone, settings))
    return frames


def derived_afterwards(parent: Episode, settings: PrepareSettings) -> list[str]:
    """Return the derived arrays that the prepared episode has, by ``<stream>/<name>``.

    Raises
    ------
    UsageError
        Fingers are to be combined, and there are none.
    """
    pairs = pairs_of(parent) if _combines(parent, settings) else []
    gone = _gone(pairs)
    measured = [
        f"{name}/activity"
        for name, view in parent.streams.items()
        if name not in gone and measured_anew(parent, view, settings)
    ]
    measured += [
        f"{pair.name}/activity"
        for pair in pairs
        if all("reference" in v.metadata.arrays or len(v) for v in (pair.left, pair.right))
    ]
    return [*_carried_keys(parent, gone, settings), *measured]


def _making(
    parent: Episode, view: StreamView, pairs: Sequence[Pair], settings: PrepareSettings
) -> Making | None:
    """Return how a stream is made anew; None where it is not, or another one stands for it."""
    for pair in pairs:
        if view.name in (pair.left.name, pair.right.name):
            is_first = view.name == pair.left.name
            return combined_making(parent, pair, settings) if is_first else None
    if not view.is_image or is_ready(parent, view, settings):
        return None
    return making_of(parent, view, settings)


def _combines(parent: Episode, settings: PrepareSettings) -> bool:
    return settings.tactile == "combined" and bool(parent.of_kind("tactile"))


def _gone(pairs: Sequence[Pair]) -> dict[str, str]:
    """Return the names of the streams that are combined, with the name of what they become."""
    return {view.name: pair.name for pair in pairs for view in (pair.left, pair.right)}


def _rename(writer: EpisodeWriter, gone: Mapping[str, str]) -> None:
    """Let what is said of a stream that is combined be said of what it becomes."""
    for step in writer.metadata.source.lossy or ():
        name = gone.get(step.stream or "")
        if name is not None:
            step.stream, step.detail = name, f"{step.stream}: {step.detail}"
    for note in writer.metadata.quality:
        name = gone.get(note.stream or "")
        if name is not None:
            note.stream, note.message = name, f"{note.stream}: {note.message}"


def _carried_keys(parent: Episode, gone: Collection[str], settings: PrepareSettings) -> list[str]:
    """Return the derived arrays that still say something of a stream that is there."""
    items = parent.derived.items if parent.derived else {}
    measured = {
        f"{view.name}/activity"
        for view in parent.streams.values()
        if measured_anew(parent, view, settings)
    }
    return [key for key in items if key.partition("/")[0] not in gone and key not in measured]


def _carry_derived(parent: Episode, writer: EpisodeWriter, keys: Collection[str]) -> None:
    """Carry derived arrays along: they say something of the frames as they were."""
    if parent.derived is None:
        return
    writer.derived = parent.derived.model_copy(deep=True)
    for key in keys:
        item, values = parent.derived.items[key], parent.derived_array(key)
        if values is None:
            continue
        stream, _, name = key.partition("/")
        writer.add_derived(
            stream,
            name,
            values,
            algorithm=item.algorithm,
            parameters=item.parameters,
            inputs=[f"{parent.id}/{path}" for path in item.inputs],
            **(item.model_extra or {}),
        )
