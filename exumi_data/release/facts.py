"""What the episodes of a dataset say of themselves, counted: how they were made, and by what."""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import TypeVar

from exumi_data.dataset import Dataset
from exumi_data.model.description import Label
from exumi_data.model.episode import EpisodeMetadata
from exumi_data.model.streams import StreamModel, TactileStream, images_of

__all__ = ["Facts", "LabelKind", "Step", "StreamFact", "facts_of"]

_NOT_SAID = ""
T = TypeVar("T")


@dataclass(frozen=True, slots=True)
class Step:
    """A step at which information was lost, as the episodes tell it."""

    step: str
    stream: str
    detail: str
    by: str


@dataclass(frozen=True, slots=True)
class StreamFact:
    """A stream, by what it is.

    Attributes
    ----------
    name, kind : str
    sensor : str
        Its registered model, and who made it.
    stored : str
        Size and encoding of its frames.
    stamped : str
        Where on its way a sample got its time.
    """

    name: str
    kind: str
    sensor: str
    stored: str
    stamped: str


@dataclass(frozen=True, slots=True)
class LabelKind:
    """Judgements of one property that came about in the same way.

    Attributes
    ----------
    property, provenance : str
    scale : tuple of float
        Lowest and highest value; empty where none is said.
    raters : int
        Of each value; 0 where it is not said.
    origin : str
    """

    property: str
    provenance: str
    scale: tuple[float, ...]
    raters: int
    origin: str


@dataclass(slots=True)
class Facts:
    """What the episodes say, each with the number of episodes that say it; in order of mention.

    What an episode does not say is an empty string.

    Attributes
    ----------
    sources : Counter of (type, tool, version, converter)
    steps : Counter of Step
    streams : Counter of StreamFact
    devices : Counter of (device, embodiment)
    calibration : Counter of (item, method)
    references : Counter of (stream, method)
        How the image without contact was had.
    labels : Counter of LabelKind
    notes : Counter of (code, message)
        On quality.
    licences : Counter of str
    """

    sources: Counter[tuple[str, str, str, str]] = field(default_factory=Counter)
    steps: Counter[Step] = field(default_factory=Counter)
    streams: Counter[StreamFact] = field(default_factory=Counter)
    devices: Counter[tuple[str, str]] = field(default_factory=Counter)
    calibration: Counter[tuple[str, str]] = field(default_factory=Counter)
    references: Counter[tuple[str, str]] = field(default_factory=Counter)
    labels: Counter[LabelKind] = field(default_factory=Counter)
    notes: Counter[tuple[str, str]] = field(default_factory=Counter)
    licences: Counter[str] = field(default_factory=Counter)


def facts_of(dataset: Dataset) -> Facts:
    """Read the metadata of all episodes; no array is read.

    Parameters
    ----------
    dataset : Dataset

    Returns
    -------
    Facts

    Raises
    ------
    ExumiError
        An episode cannot be read.
    """
    facts = Facts()
    for episode in dataset:
        with episode:
            _count(facts, episode.metadata)
    return facts


def _count(facts: Facts, metadata: EpisodeMetadata) -> None:
    source, device, hand = metadata.source, metadata.device, metadata.embodiment
    converter = source.converter or _NOT_SAID
    facts.sources[source.type, source.tool, source.tool_version, converter] += 1
    facts.licences[metadata.licence] += 1
    if device or hand:
        facts.devices[device.name if device else _NOT_SAID, hand.name if hand else _NOT_SAID] += 1
    facts.steps.update(
        _each(
            Step(one.step, one.stream or _NOT_SAID, one.detail, one.by or _NOT_SAID)
            for one in source.lossy or []
        )
    )
    for name, stream in metadata.streams.items():
        facts.streams[_stream(name, stream)] += 1
        if isinstance(stream, TactileStream):
            method = stream.reference.method if stream.reference else _NOT_SAID
            facts.references[name, method] += 1
    for name, item in metadata.calibration.items():
        facts.calibration[name, item.method or _NOT_SAID] += 1
    labels = (metadata.annotations.labels if metadata.annotations else None) or []
    facts.labels.update(_each(map(_label, labels)))
    facts.notes.update(_each((note.code, note.message) for note in metadata.quality))


def _each(items: Iterable[T]) -> list[T]:
    """Return items once each, in their order: an episode counts once."""
    return list(dict.fromkeys(items))


def _stream(name: str, stream: StreamModel) -> StreamFact:
    sensor, images = stream.sensor, images_of(stream)
    made_by = f" ({sensor.manufacturer})" if sensor and sensor.manufacturer else ""
    stored = "" if images is None else f"{images.width}×{images.height}, {images.encoding}"
    codecs = sorted({file.codec for file in getattr(images, "files", [])})
    return StreamFact(
        name=name,
        kind=stream.kind,
        sensor=f"{sensor.model}{made_by}" if sensor else _NOT_SAID,
        stored=f"{stored} ({', '.join(codecs)})" if codecs else stored,
        stamped=stream.clock.stamp_point,
    )


def _label(label: Label) -> LabelKind:
    return LabelKind(
        property=label.property,
        provenance=label.provenance,
        scale=tuple(label.scale or ()),
        raters=label.raters or 0,
        origin=label.origin or _NOT_SAID,
    )
