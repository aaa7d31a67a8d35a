"""The record in which our files keep the episode's own documents."""

from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from exumi_converters.mcap_files.records import Records
from exumi_converters.mcap_files.topics import DOCUMENT_RECORD
from exumi_data.errors import SourceError
from exumi_data.model import DerivedMetadata, EpisodeMetadata
from exumi_data.model.documents import parse_derived, parse_episode

__all__ = ["OwnRecord", "read_own_record"]

_HEAD_RECORDS = 4096


@dataclass(frozen=True, slots=True)
class OwnRecord:
    """What a file that exUMI wrote says of itself.

    Attributes
    ----------
    metadata : EpisodeMetadata
    derived : DerivedMetadata or None
    base_ns : int
        What was added to the episode's times.
    video : {"jpeg", "attach"}
        What became of video files.
    """

    metadata: EpisodeMetadata
    derived: DerivedMetadata | None
    base_ns: int
    video: Literal["jpeg", "attach"]


def read_own_record(path: Path) -> OwnRecord | None:
    """Return what our exporter put at the beginning of a file; None: somebody else wrote it.

    Parameters
    ----------
    path : pathlib.Path

    Raises
    ------
    MetadataError, UnsupportedError, SourceError
        It is damaged, or of a newer version.
    """
    from mcap.records import Message, Metadata

    for number, record in enumerate(Records(path).read()):
        if isinstance(record, Metadata) and record.name == DOCUMENT_RECORD:
            return _parsed(record.metadata, path)
        if isinstance(record, Message) or number > _HEAD_RECORDS:
            return None
    return None


def _parsed(record: dict[str, str], path: Path) -> OwnRecord:
    try:
        derived = record["derived"].encode()
        return OwnRecord(
            metadata=parse_episode(record["document"].encode(), path),
            derived=parse_derived(derived, path) if derived else None,
            base_ns=int(record["base_ns"]),
            video="attach" if record["video"] == "attach" else "jpeg",
        )
    except (KeyError, ValueError) as error:
        raise SourceError(
            f"its record {DOCUMENT_RECORD!r} is damaged ({error})", where=path
        ) from None
