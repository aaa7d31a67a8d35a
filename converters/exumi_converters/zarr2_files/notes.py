"""What is said of the images of a store: those that could not be decoded, and what was lossy."""

from collections.abc import Sequence

from exumi_converters.frame_files import add_lossy
from exumi_converters.zarr2_files.metadata import ArrayMeta
from exumi_data.errors import SourceError
from exumi_data.model import LossyStep, QualityNote
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["name_some", "note_damaged", "note_jpeg"]

_NAMED = 5


def name_some(texts: Sequence[str]) -> str:
    """Name the first few of many things.

    Parameters
    ----------
    texts : sequence of str
    """
    return ", ".join(texts[:_NAMED]) + (", ..." if len(texts) > _NAMED else "")


def note_damaged(
    writer: EpisodeWriter,
    streams: Sequence[str],
    lost: Sequence[tuple[int, str]],
    good: int,
    meta: ArrayMeta,
) -> None:
    """Say which frames were left out.

    Parameters
    ----------
    writer : EpisodeWriter
    streams : sequence of str
        That were written from them.
    lost : sequence of (int, str)
        Index of each within the episode, and what is the matter with it.
    good : int
        Frames that could be decoded.
    meta : ArrayMeta

    Raises
    ------
    SourceError
        There is not one.
    """
    if not good:
        reason = lost[0][1] if lost else "there is none"
        raise SourceError(
            f"no frame can be decoded ({reason})",
            where=meta.path,
            fix="Get the file again from its source.",
        )
    if not lost:
        return
    named = name_some([f"{index} ({reason})" for index, reason in lost])
    for stream in streams:
        writer.metadata.quality.append(
            QualityNote(
                code="damaged-frames",
                message=f"{len(lost)} of {good + len(lost)} frames are missing or cannot be "
                f"decoded and were left out: {named}",
                stream=stream,
            )
        )


def note_jpeg(
    writer: EpisodeWriter, stream: str, meta: ArrayMeta, quality: int, channels: int
) -> None:
    """Say that the images of a stream were encoded as JPEG.

    Parameters
    ----------
    writer : EpisodeWriter
    stream : str
    meta : ArrayMeta
        Of the array that they were decoded from.
    quality : int
    channels : int
    """
    sampling = "4:4:4" if channels == 3 else "grey"
    add_lossy(
        writer,
        LossyStep(
            step="jpeg-encode",
            stream=stream,
            detail=f"frames were decoded from {meta.codec or 'pixels'} and encoded as JPEG, "
            f"quality {quality}, {sampling}",
            parameters={"quality": quality, "chroma": sampling},
        ),
    )
