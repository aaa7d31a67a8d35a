"""Simulated touches as a dataset: parts of known hardness and roughness, pressed several times."""

import uuid
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from exumi_data._version import __version__
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import Dataset, create_dataset, open_dataset
from exumi_data.demo.tactile_measure import TactileMeasure
from exumi_data.engine import map_items
from exumi_data.errors import UsageError
from exumi_data.model import (
    Annotations,
    Clock,
    DatasetMetadata,
    EncodedImages,
    EpisodeMetadata,
    Label,
    LossyStep,
    Sensor,
    Source,
    Task,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = ["TouchSettings", "write_touch_dataset"]

_LICENCE = "CC0-1.0"
_NAMESPACE = uuid.UUID("5d0f7c9e-3b0e-5a57-9c8f-2f1f8e0f6f0a")
_STREAM = "tactile"
_ORIGIN = "the simulation"


@dataclass(frozen=True, slots=True)
class TouchSettings:
    """What a dataset of touches is made from: the same settings give the same dataset.

    Attributes
    ----------
    parts, clips : int
        Parts, and presses of each.
    seed : int
        Chooses everything that is left to chance.
    quality : int
        JPEG quality.
    """

    parts: int = 30
    clips: int = 4
    seed: int = 0
    quality: int = 95


def write_touch_dataset(
    root: Path, settings: TouchSettings | None = None, *, workers: int | None = None
) -> Dataset:
    """Simulate presses of parts and write them as a dataset, one episode a press.

    Each part is rated for hardness and roughness, as what it is, not as what somebody felt.

    Parameters
    ----------
    root : pathlib.Path
        A new folder.
    settings : TouchSettings, optional
    workers : int, optional
        Processes; default all cores.

    Returns
    -------
    Dataset

    Raises
    ------
    UsageError
        A setting is out of its range, or the folder holds something.
    """
    settings = settings or TouchSettings()
    if settings.parts < 1 or settings.clips < 1:
        raise UsageError("parts and clips must be positive")
    create_dataset(
        root,
        DatasetMetadata(
            name="simulated-touches",
            description="Parts of known hardness and roughness, pressed into a simulated gel pad.",
            licence=_LICENCE,
        ),
    )
    presses = [(part, trial) for part in range(settings.parts) for trial in range(settings.clips)]
    write = partial(_write_press, root=root, settings=settings)
    for outcome in map_items(write, presses, workers=workers):
        if outcome.error is not None:
            raise outcome.error
    table, failed = build_catalog(root)
    if failed and failed[0].error is not None:
        raise failed[0].error
    write_catalog(root, table)
    return open_dataset(root)


def _write_press(item: tuple[int, int], *, root: Path, settings: TouchSettings) -> None:
    from exumi_data.simulation.press import make_parts, simulate_press

    number, trial = item
    part = make_parts(settings.parts, seed=settings.seed)[number]
    press = simulate_press(part, seed=trial)
    metadata = _metadata(part.name, part.hardness, part.roughness, trial, settings)
    height, width = press.reference.shape[:2]
    with EpisodeWriter(root / episode_path(metadata.id), metadata, durable=False) as writer:
        stream = writer.add_stream(
            _STREAM,
            kind="tactile",
            clock=Clock(source="session", stamp_point="simulated"),
            images=EncodedImages(
                encoding="encoded",
                media_type="image/jpeg",
                height=height,
                width=width,
                channels=3,
            ),
            sensor=Sensor(model="simulated-gel"),
        )
        measure = TactileMeasure(press.reference)
        for time_ns, frame in zip(press.time_ns.tolist(), press.frames, strict=True):
            file = jpeg.encode(np.ascontiguousarray(frame), settings.quality)
            stream.append(time_ns, file)
            measure.add(file)
        stream.set_reference(press.reference, method="captured", contact_free=True)
        measure.write(writer, _STREAM)


def _metadata(
    part: str, hardness: float, roughness: float, trial: int, settings: TouchSettings
) -> EpisodeMetadata:
    key = f"exumi-touches/1 {settings.seed} {settings.parts} {settings.quality} {part} {trial}"
    scale = [0.0, 10.0]
    words = [_word(hardness, ("soft", "firm", "hard")), _word(roughness, _ROUGH)]
    labels = [
        # Known, as a person knows who made the object: no model has said it.
        Label(property="hardness", value=hardness, scale=scale, provenance="human", origin=_ORIGIN),
        Label(
            property="roughness", value=roughness, scale=scale, provenance="human", origin=_ORIGIN
        ),
        Label(property="adjectives", value=words, provenance="human", origin=_ORIGIN),
    ]
    return EpisodeMetadata(
        id=str(uuid.uuid5(_NAMESPACE, key)),
        task=Task(name="touch", instruction="Press the part into the gel."),
        regime="touch",
        licence=_LICENCE,
        annotations=Annotations(
            object_id=part,
            object=f"a {words[0]}, {words[1]} dome ({part.removeprefix('part_')})",
            part_id=part,
            trial=trial,
            procedure="press",
            pad_type="plain",
            labels=labels,
        ),
        source=Source(
            type="simulated",
            tool="exumi-data",
            tool_version=__version__,
            key=f"{part} {trial}",
            settings=asdict(settings),
            lossy=[
                LossyStep(
                    step="jpeg-encode",
                    stream=_STREAM,
                    detail=f"drawn frames encoded as JPEG, quality {settings.quality}",
                    parameters={"quality": settings.quality},
                )
            ],
        ),
    )


_ROUGH = ("smooth", "grainy", "rough")


def _word(rating: float, words: tuple[str, str, str]) -> str:
    """Return the word for a rating from 0 to 10."""
    return words[min(2, int(rating * 3 / 10))]
