"""The episode's metadata: fields, names, licence, source, annotations."""

import re
from collections.abc import Iterator

from exumi_data.model.description import CalibrationItem, Label, LossyStep, QualityNote, Segment
from exumi_data.model.episode import DerivedMetadata, EpisodeMetadata
from exumi_data.model.streams import (
    ExtensionStream,
    PoseStream,
    TaxelsStream,
    WidthStream,
    WrenchStream,
)
from exumi_data.standard import units
from exumi_validators.context import EXUMI, ROOT, EpisodeContext, newer_minor
from exumi_validators.document_rules import (
    MODEL_RULES,
    is_real_date,
    licence_problems,
    model_rule_problems,
    undescribed_objects,
)
from exumi_validators.findings import problem
from exumi_validators.model_problems import problems_of_model
from exumi_validators.registry import Finding, check
from exumi_validators.report import Problem, Skipped

__all__ = [
    "fields",
    "id_version",
    "labels",
    "labels_in_scale",
    "licence",
    "segments",
    "source",
    "stream_names",
    "third_parties",
    "timestamps",
    "unit_names",
]

_HEAD = {"format", "version"}  # the models have defaults for these
_UUID = re.compile(r"[0-9a-f]{8}-[0-9a-f]{4}-([0-9a-f])[0-9a-f]{3}-[0-9a-f]{4}-[0-9a-f]{12}")
_UUID_VERSION = {"recorded": "7", "converted": "5"}
Pointer = tuple[int | str, ...]

_EXTENSION_UNIT = re.compile(r"[a-z][a-z0-9-]*:\S+")


@check(*MODEL_RULES, "ID-001", "KIND-001", "EXT-001")
def fields(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge every field of the root's document and of that of ``derived``."""
    document = episode.document
    if document is not None and (episode.metadata is None or not set(document) >= _HEAD):
        yield from model_rule_problems("episode", EpisodeMetadata, document, ROOT, EXUMI)
    derived = episode.derived_document
    if derived is not None and newer_minor(derived.get("version")) is not None:
        path = "derived/zarr.json"
        yield from model_rule_problems("derived", DerivedMetadata, derived, path, EXUMI)
    for name, stream in episode.streams.items():
        if isinstance(stream, ExtensionStream):
            yield from _fields_of_extension(episode, name, stream)


def _fields_of_extension(
    episode: EpisodeContext, name: str, stream: ExtensionStream
) -> Iterator[Finding]:
    """Judge what a third party says of its stream, by its package's own description."""
    kind = episode.described_kind(stream)
    if kind is None:
        reason = f"no installed package describes {stream.kind} {stream.extension_version}"
        yield Skipped("META-002", reason, f"streams/{name}")
        return
    document = (episode.document or {})["streams"][name]
    at = (*EXUMI, "streams", name)
    yield from problems_of_model(kind.metadata, document, ROOT, at)
    for key in document:
        if key.startswith(f"{kind.vendor}:") and key not in kind.keys:
            yield problem("META-003", ROOT, pointer=(*at, key), found=key)


@check("EXT-002")
def third_parties(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that objects of third parties say where they are described."""
    yield from undescribed_objects("episode", episode.document or {}, ROOT, EXUMI)
    derived = episode.derived_document or {}
    yield from undescribed_objects("derived", derived, "derived/zarr.json", EXUMI)


@check("META-005")
def timestamps(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that timestamps are in the calendar."""
    start = episode.section("start")
    if not is_real_date(start):
        yield problem("META-005", ROOT, pointer=(*EXUMI, "start"), found=start)
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        if not is_real_date(item.time):
            yield problem("META-005", ROOT, pointer=(*pointer, "time"), found=item.time)


@check("ID-002")
def id_version(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that the id was made as its source says."""
    source = episode.section("source")
    uuid = _UUID.fullmatch(str((episode.document or {}).get("id")))
    wanted = _UUID_VERSION.get(source.type) if source else None
    if uuid and wanted and uuid[1] != wanted:
        yield problem("ID-002", ROOT, pointer=(*EXUMI, "id"), expected=source.type, found=uuid[1])


@check("LIC-001", "LIC-002")
def licence(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge how the licence is written."""
    yield from licence_problems(episode.section("licence"), ROOT, (*EXUMI, "licence"))


@check("SRC-001")
def source(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that a converted episode names what it was made from."""
    found = episode.section("source")
    if found is None or found.type != "converted":
        return
    from_files = found.converter and found.inputs
    from_episode = found.parent_id and found.parent_digest
    if not (from_files or from_episode):
        yield problem("SRC-001", ROOT, pointer=(*EXUMI, "source"))


@check("REF-001")
def stream_names(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that lossy steps and quality notes name streams that are there."""
    named: list[tuple[Pointer, str | None]] = []
    for pointer, step in episode.parts(LossyStep, "source", "lossy"):
        named.append((pointer, step.stream))
    for pointer, note in episode.parts(QualityNote, "quality"):
        named.append((pointer, note.stream))
    for pointer, name in named:
        if name is not None and name not in episode.stream_names:
            yield problem("REF-001", ROOT, pointer=(*pointer, "stream"), found=name)


@check("UNIT-001")
def unit_names(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that units are registered."""
    stated: list[tuple[Pointer, str | None]] = [
        ((*pointer, "unit"), item.unit)
        for pointer, item in episode.parts(CalibrationItem, "calibration")
    ]
    for name, stream in episode.streams.items():
        at = (*EXUMI, "streams", name)
        stated.append(((*at, "time_device_unit"), stream.time_device_unit))
        if isinstance(stream, PoseStream | WidthStream | WrenchStream) and stream.raw:
            stated.append(((*at, "raw", "unit"), stream.raw.unit))
        if isinstance(stream, TaxelsStream):
            stated.append(((*at, "unit"), stream.unit))
    for pointer, unit in stated:
        if unit is not None and unit not in units() and not _EXTENSION_UNIT.fullmatch(unit):
            yield problem("UNIT-001", ROOT, pointer=pointer, found=unit)


@check("ANN-001")
def labels(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that numbers have a scale."""
    for pointer, label in episode.parts(Label, "annotations", "labels"):
        if isinstance(label.value, float) and label.scale is None:
            yield problem("ANN-001", ROOT, pointer=pointer, found=label.property)


@check("ANN-002")
def labels_in_scale(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that numbers lie within their scale."""
    for pointer, label in episode.parts(Label, "annotations", "labels"):
        if not isinstance(label.value, float) or label.scale is None:
            continue
        if not label.scale[0] <= label.value <= label.scale[1]:
            yield problem("ANN-002", ROOT, pointer=pointer, expected=label.scale, found=label.value)


@check("ANN-003")
def segments(episode: EpisodeContext) -> Iterator[Problem]:
    """Judge that segments do not end before they start."""
    for pointer, segment in episode.parts(Segment, "annotations", "segments"):
        if segment.end_ns < segment.start_ns:
            found = segment.start_ns - segment.end_ns
            yield problem("ANN-003", ROOT, pointer=pointer, found=found)
