"""Whether what is stored can be decoded. Judged last: other checks have read most of it by then."""

from collections.abc import Iterator

from exumi_data.model.streams import images_of
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import check
from exumi_validators.report import Problem

__all__ = ["readable"]


@check("SHARD-005")
def readable(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that every array can be read to its end; frames are judged at the level of data."""
    for path in episode.array_nodes:
        # One finding an array: what its index tells, or else what reading it tells.
        yield from [p for p in episode.shard_problems(path) if p.code == "SHARD-005"][:1]
        stream = episode.stream_of(path)
        are_frames = path.endswith("/data") and stream is not None and images_of(stream)
        if not are_frames and path not in episode.scanned:
            for _ in episode.blocks(path):
                pass
    for path, reason in sorted(episode.unreadable.items()):
        yield problem("SHARD-005", path, detail=reason)
