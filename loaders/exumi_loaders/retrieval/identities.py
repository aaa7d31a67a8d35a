"""What a clip can be told by, so that no query is scored by an index that holds it."""

import hashlib
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from exumi_data.model.episode import EpisodeMetadata

__all__ = ["frames_identity", "identities"]

_DIGITS = 32


def frames_identity(frames: np.ndarray, reference: np.ndarray | None) -> str:
    """Return the digest of the pixels that a vector was made of.

    Parameters
    ----------
    frames : (N, H, W, C) uint8
    reference : (H, W, C) uint8 or None
    """
    state = hashlib.sha256(repr(frames.shape).encode())
    state.update(np.ascontiguousarray(frames).data)
    if reference is not None:
        state.update(np.ascontiguousarray(reference).data)
    return f"pixels:{state.hexdigest()[:_DIGITS]}"


def identities(metadata: "EpisodeMetadata", stream: str) -> tuple[str, ...]:
    """Return what a stream of an episode can be told by, also after ``exumi prepare``.

    That is its own id, that of the episode which it was prepared from, and the digest of the
    source that it was converted from.

    Parameters
    ----------
    metadata : EpisodeMetadata
    stream : str
    """
    source = metadata.source
    found = [f"clip:{metadata.id}/{stream}"]
    if source.parent_id is not None:
        found.append(f"clip:{source.parent_id}/{stream}")
    if source.inputs and source.key is not None:
        # The key, too: one file can hold many episodes.
        parts = (source.key, stream, *sorted(item.sha256 for item in source.inputs))
        state = hashlib.sha256("\n".join(parts).encode())
        found.append(f"source:{state.hexdigest()[:_DIGITS]}")
    return tuple(found)
