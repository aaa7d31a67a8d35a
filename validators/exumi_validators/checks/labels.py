"""Labels and segments: where they are from, of what they are, and when."""

from collections.abc import Iterator

from exumi_data.model.description import Label, Segment
from exumi_validators.context import EXUMI, ROOT, EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = ["origins", "recorded_segments", "things", "values"]

_LABELS = ("annotations", "labels")


@check("ANN-004")
def origins(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a label says which people or which model it is from."""
    wanted = {"human": "where it is from, or how many rated", "model": "which model it is from"}
    for pointer, label in episode.parts(Label, *_LABELS):
        if label.origin or (label.provenance == "human" and label.raters is not None):
            continue
        yield problem(
            "ANN-004",
            ROOT,
            pointer=pointer,
            expected=label.provenance,
            found=label.property,
            detail=wanted[label.provenance],
        )


@check("ANN-005")
def things(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that labels are of something: without an id they cannot be brought together."""
    notes = episode.section("annotations")
    if notes is None or not notes.labels:
        return
    if notes.object_id is None and notes.part_id is None:
        yield problem("ANN-005", ROOT, pointer=(*EXUMI, *_LABELS), found=len(notes.labels))


@check("ANN-006")
def values(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that no two labels of one source contradict each other."""
    seen: dict[tuple[str, str, str | None], object] = {}
    for pointer, label in episode.parts(Label, *_LABELS):
        key = (label.property, label.provenance, label.origin)
        before = seen.setdefault(key, label.value)
        if before != label.value:
            yield problem(
                "ANN-006",
                ROOT,
                pointer=pointer,
                expected=before,
                found=label.value,
                detail=label.property,
            )


@check("ANN-007")
def recorded_segments(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that segments overlap with what was recorded."""
    segments = list(episode.parts(Segment, "annotations", "segments"))
    if not segments:
        return
    recorded = _recorded(episode)
    if recorded is None:
        yield Skipped("ANN-007", "there are no samples", ROOT)
        return
    first, last = recorded
    for pointer, segment in segments:
        if segment.end_ns < first or segment.start_ns > last:
            found = f"{segment.name} from {segment.start_ns} to {segment.end_ns} ns"
            expected = f"{first} to {last} ns"
            yield problem("ANN-007", ROOT, pointer=pointer, expected=expected, found=found)


def _recorded(episode: EpisodeContext) -> tuple[int, int] | None:
    """Return the times of the first and the last sample of all streams."""
    found: list[int] = []
    for name in episode.streams:
        for _, (time,) in episode.blocks(f"streams/{name}/time"):
            found += [int(time.min()), int(time.max())]
    return (min(found), max(found)) if found else None
