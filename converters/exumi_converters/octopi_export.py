"""``--to octopi``: the processed ``samples/`` that Octopi-1.5's own code reads.

After ``octopi_s/process_datasets.py`` of clear-nus/octopi-1.5: a folder a clip with numbered JPEG
frames and a ``data.json``, and three lists of samples by object. Which frames are kept is the
paper's choice (the ten with the largest difference), not that code's.
"""

import json
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from exumi_converters.exporter import ExportItem, ExportOptions, ExportPlan, Loss, Part
from exumi_converters.facets import FACETS
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.report import Failure
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import UsageError
from exumi_data.model import Annotations
from exumi_data.store import jpeg
from exumi_data.tactile import difference_energy, salient_frames, to_grey

__all__ = ["OctopiExportOptions", "OctopiExporter"]

_LISTS = ("train", "val", "test")
_SPLIT = "octopi15"
_QUALITY = 95
_SALIENT = 10
_PROCEDURES = {"press": "Pressing", "slide": "Sliding", "twist": "Twisting"}
_RATINGS = ("hardness", "roughness")
_WHOLE = ("hardness_", "objectfolder_")
_PHYSICLEAR = {None: "physiclear", "plain": "physiclear", "dotted": "physicleardotted"}
_FRAME_BYTES = 12_000


class OctopiExportOptions(FormatOptions):
    """What only this format can be told."""

    frames: Literal["salient", "all"] = Field(
        "salient", description="Which frames of a clip: the ten salient ones of the paper, or all."
    )
    split: str = Field(_SPLIT, description="Split of the dataset that names train, val and test.")
    root: str = Field(
        "data/samples", description="Where Octopi's code will find the samples, for its lists."
    )


class OctopiExporter:
    """Every tactile stream of an episode becomes a sample."""

    name = "octopi"
    version = "1"
    describes = "Octopi-1.5's processed samples/: numbered JPEG frames, data.json, lists by object"
    keeps: tuple[str, ...] = (
        "object, part, trial, procedure and pad type, as far as the layout has words for them",
        "ratings of hardness and roughness, and the lists of one split",
        "JPEG frames byte for byte, if the stream has them",
    )
    loses: Mapping[str, str] = {
        facet: {
            "time": "frames are numbered, nothing says how fast they came",
            "pixels": "frames that are not salient are left out, unless -o frames=all; what is no "
            "JPEG becomes one",
            "frame-bytes": "frames that are not salient are left out; video is decoded",
            "streams": "streams that are not tactile are left out",
            "annotations": "segments, labels but hardness and roughness, scales and raters",
        }.get(facet, "there is no place for it")
        for facet in FACETS
    }
    options: type[FormatOptions] = OctopiExportOptions

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Episodes with a part and a tactile stream are written."""
        told = parse_options(OctopiExportOptions, options.settings, self.name)
        lists, notices = _lists(dataset, told.split)
        items: list[ExportItem] = []
        refused: list[Failure] = []
        losses: dict[tuple[str, str], Loss] = {}
        size = 0
        for episode in dataset:
            with episode:
                mistake = _mistake(episode)
                if mistake is not None:
                    refused.append(Failure(episode.id, mistake))
                    continue
                settings = {"split": lists.get(episode.id, "train")}
                items.append(ExportItem(id=episode.id, index=len(items), settings=settings))
                for loss in (*_label_losses(episode), *_stream_losses(episode, told)):
                    losses.setdefault((loss.facet, loss.stream or ""), loss)
                for stream in episode.streams.values():
                    if stream.kind == "tactile":
                        count = len(stream) if told.frames == "all" else _SALIENT
                        size += count * _FRAME_BYTES
        return ExportPlan(
            layout=f"samples of {len(items)} clips",
            items=tuple(items),
            shared={"frames": told.frames, "root": told.root.rstrip("/")},
            losses=tuple(losses.values()),
            refused=tuple(refused),
            notices=tuple(notices),
            estimated_bytes=size,
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write the frames of each tactile stream, and what the episode's data.json will say."""
        samples, frames = [], 0
        for stream in episode.of_kind("tactile"):
            target = folder / stream.name
            target.mkdir()
            wanted = _wanted(episode, stream, plan.shared["frames"])
            _write_frames(stream, wanted, target)
            frames += len(wanted)
            samples.append({"folder": stream.name, **_document(episode, item.settings["split"])})
        return {"frames": frames, "samples": samples}

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Give the samples of each data set their numbers, and list them."""
        numbers: Counter[str] = Counter()
        lists: dict[str, dict[str, list[str]]] = {name: {} for name in _LISTS}
        (target / "samples").mkdir()
        for part in parts:
            for sample in part.result["samples"]:
                document = dict(sample)
                frames, kind = document.pop("folder"), document.pop("dataset")
                name = f"{kind}_{numbers[kind]}"
                numbers[kind] += 1
                folder = target / "samples" / name
                folder.mkdir()
                (part.folder / frames).rename(folder / "tactile")
                (folder / "data.json").write_text(json.dumps(document, indent=4), encoding="utf-8")
                samples = lists[document["split"]]
                samples.setdefault(document["object_id"], []).append(
                    f"{plan.shared['root']}/{name}"
                )
        for name, samples in lists.items():
            path = target / f"{name}_samples.json"
            path.write_text(json.dumps(samples), encoding="utf-8")


def _lists(dataset: Dataset, split: str) -> tuple[dict[str, str], list[str]]:
    """Return the list that each episode is in."""
    if split not in dataset.splits:
        if split != _SPLIT:
            raise UsageError(
                f"the dataset has no split {split!r}",
                where=dataset.path,
                fix=f"It has: {', '.join(dataset.splits) or 'none'}.",
            )
        return {}, [f"the dataset has no split {split!r}: every sample is in train"]
    lists = dataset.splits[split].lists
    # Octopi's code knows no others; and their names become those of files.
    strange = sorted(set(lists) - set(_LISTS))
    if strange:
        raise UsageError(
            f"the split {split!r} has the list {strange[0]!r}: Octopi's are {', '.join(_LISTS)}",
            where=dataset.path,
            fix="Name another split with -o split=NAME, or give its lists these names.",
        )
    found = {name: word for word, ids in lists.items() for name in ids}
    missing = sum(name not in found for name in dataset.ids)
    notices = [f"{missing} episodes are in no list of {split!r}: they go to train"]
    return found, notices if missing else []


def _mistake(episode: Episode) -> str | None:
    about = episode.metadata.annotations
    if about is None or not about.part_id:
        return "it names no part (annotations.part_id), and Octopi's samples go by that"
    if not episode.of_kind("tactile"):
        return "it has no tactile stream"
    return None


def _ratings(episode: Episode) -> dict[str, float]:
    """Return hardness and roughness; nothing where one is missing: Octopi's code takes both."""
    about = episode.metadata.annotations or Annotations()
    found = {
        label.property: label.value
        for label in about.labels or []
        if label.property in _RATINGS and isinstance(label.value, int | float)
    }
    return found if len(found) == len(_RATINGS) else {}


def _label_losses(episode: Episode) -> list[Loss]:
    about = episode.metadata.annotations or Annotations()
    if _ratings(episode) or not any(label.property in _RATINGS for label in about.labels or []):
        return []
    detail = "of some episodes only hardness or only roughness is known: Octopi's code takes both"
    return [Loss(facet="annotations", detail=detail)]


def _stream_losses(episode: Episode, told: OctopiExportOptions) -> Iterator[Loss]:
    for stream in episode.streams.values():
        yield from _losses(stream, told)


def _losses(stream: StreamView, told: OctopiExportOptions) -> list[Loss]:
    if stream.kind != "tactile":
        return [Loss(facet="streams", detail="only touch has a place there", stream=stream.name)]
    losses = [Loss(facet="time", detail="frames are only numbered", stream=stream.name)]
    if told.frames == "salient" and len(stream) > _SALIENT:
        detail = f"{len(stream) - _SALIENT} or more frames of a clip are left out"
        losses.append(Loss(facet="pixels", detail=detail, stream=stream.name))
    elif stream.metadata.images.encoding != "encoded":  # type: ignore[attr-defined]  # an image stream
        losses.append(
            Loss(facet="pixels", detail="frames become JPEG, quality 95", stream=stream.name)
        )
    return losses


def _wanted(episode: Episode, stream: StreamView, frames: str) -> list[int]:
    if frames == "all":
        return list(range(len(stream)))
    if stream.salient is not None:
        return [int(index) for index in stream.salient]
    energies, before = [], None
    for frame in stream.frames:
        grey = to_grey(frame) if frame.shape[2] == 3 else frame[..., 0]  # colours
        energies.append(difference_energy(grey if before is None else before, grey))
        before = grey
    return [int(index) for index in salient_frames(np.array(energies), _SALIENT)]


def _write_frames(stream: StreamView, wanted: Sequence[int], folder: Path) -> None:
    """Write frames under their numbers; Octopi counts a clip's from 1."""
    verbatim = stream.metadata.images.encoding == "encoded"  # type: ignore[attr-defined]  # an image stream
    for index in wanted:
        data = stream.encoded(index) if verbatim else jpeg.encode(stream.frames[index], _QUALITY)
        (folder / f"{index + 1:010d}.jpg").write_bytes(data)


def _document(episode: Episode, split: str) -> dict[str, Any]:
    about = episode.metadata.annotations or Annotations()
    part_id = str(about.part_id)
    whole = next((word for word in _WHOLE if part_id.startswith(word)), None)
    kind = whole.rstrip("_") if whole else _PHYSICLEAR[about.pad_type]
    procedure = _PROCEDURES.get(str(about.procedure), about.procedure)
    trial = 0 if about.trial is None else about.trial
    ratings = _ratings(episode)
    document: dict[str, Any] = {
        "dataset": kind,
        "object_id": part_id if whole else f"physiclear_{part_id}",
        "tactile_format": "video",
        "tactile_path": "/".join(filter(None, (kind, procedure, f"{part_id}_{trial}.mov"))),
        "split": split,
    }
    if about.part or about.object:
        document["object"] = about.part or about.object
    if ratings:
        document["properties"] = ratings
    if procedure:
        document["exploratory_procedure"] = procedure
    return document
