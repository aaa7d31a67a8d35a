"""What an index is taught: the entry that a lesson becomes."""

import uuid
from collections.abc import Mapping, Sequence

from exumi_data.errors import UsageError
from exumi_loaders.retrieval.building import Embedding
from exumi_loaders.retrieval.entries import Entry, Provenance
from exumi_loaders.retrieval.matches import check_choice

__all__ = ["taught_entry"]


def taught_entry(
    clips: Sequence[Embedding],
    *,
    name: str,
    part_id: str | None,
    object_id: str | None,
    adjectives: Sequence[str],
    labels: Mapping[str, float],
    provenance: Provenance,
) -> Entry:
    """Describe an object that is taught, as `TactileIndex.teach` takes it.

    Parameters
    ----------
    clips : sequence of Embedding
    name : str
    part_id, object_id : str or None
    adjectives : sequence of str
    labels : mapping of str to float
    provenance : {"human", "model"}

    Returns
    -------
    Entry

    Raises
    ------
    UsageError
        No clip, or something that an entry cannot say.
    """
    check_choice("provenance", provenance, ("human", "model"))
    if not clips:
        raise UsageError("nothing to teach by: give at least one clip")
    ratings = {key: float(value) for key, value in labels.items()}
    if not all(0 <= value <= 10 for value in ratings.values()):
        raise UsageError(f"labels are from 0 to 10, not {ratings}")
    if not all(word.strip() for word in (*adjectives, *ratings)):
        raise UsageError("an adjective or the name of a label is empty", where=name)
    return Entry(
        id=f"taught/{uuid.uuid4()}",
        name=name,
        object_id=object_id,
        part_id=part_id,
        adjectives=tuple(adjectives),
        labels=ratings,
        provenance=provenance,
        taught=True,
        clips=len(clips),
        origins=tuple(dict.fromkeys(word for one in clips for word in one.origins)),
    )
