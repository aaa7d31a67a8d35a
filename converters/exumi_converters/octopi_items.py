"""Turns Octopi's files into episodes: what their names, folders and labels say."""

from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from fractions import Fraction
from functools import partial
from pathlib import Path, PurePosixPath
from typing import Any

from pydantic import ValidationError

from exumi_converters.converter import ConvertOptions, EpisodeSource, SourceFile
from exumi_converters.identity import relative_name
from exumi_converters.octopi_labels import PartLabels, bare_id, read_sample_document
from exumi_converters.report import Failure
from exumi_converters.video_episode import VideoHeader, read_header
from exumi_data.errors import SourceError
from exumi_data.model import Annotations, Label, QualityNote, Task
from exumi_data.model.documents import problems_of

__all__ = ["ItemMaker"]

_SENSORS = {
    "physiclear": "gelsight-mini",
    "physicleardotted": "gelsight-mini",
    "hardness": "gelsight-2017",
    "objectfolder": "gelsight",
}
_PADS = {"physiclear": "plain", "physicleardotted": "dotted", "objectfolder": "plain"}
_PROCEDURES = {
    "pressing": "press",
    "sliding": "slide",
    "twisting": "twist",
}
_ASSUMED_RATE = "25/1"
_SIBLINGS = 5  # fewer clips do not show what is usual


class ItemMaker:
    """Makes the episodes of one source.

    Parameters
    ----------
    root : pathlib.Path
    options : ConvertOptions
    labels : mapping of str to PartLabels, or None
        None when the user gave no table.

    Attributes
    ----------
    failed : list of Failure
        What was found and cannot be made an episode.
    """

    def __init__(
        self, root: Path, options: ConvertOptions, labels: Mapping[str, PartLabels] | None
    ) -> None:
        self._root = root
        self._options = options
        self._labels = labels
        self._seen: Counter[str] = Counter()
        self._unlabelled: Counter[str] = Counter()
        self._nameless: list[str] = []
        self.failed: list[Failure] = []

    def clips(self, paths: Sequence[Path], dataset: str) -> list[EpisodeSource]:
        """Make one episode of each video.

        Parameters
        ----------
        paths : sequence of pathlib.Path
        dataset : str
            ``physiclear``, ``physicleardotted`` or ``hardness``.
        """
        usual = _usual_frames(paths)
        items: list[EpisodeSource] = []
        for path in paths:
            part_id, trial = _split_name(path.stem, dataset)
            folder = path.parent.name if path.parent != self._root else None
            settings: dict[str, Any] = {"stream": self._stream(dataset)}
            if path in usual:
                settings["usual_frames"] = usual[path]
            if part_id is None:
                self._nameless.append(path.name)
            key = relative_name(path, self._root)
            facts = {
                "trial": trial,
                "procedure": _procedure(folder) if dataset != "hardness" else None,
                **_ids(part_id, dataset),
            }
            make = partial(
                self._item, key, (SourceFile(path, key),), dataset, facts, part_id, settings
            )
            self._take(items, key, make)
        return items

    def trials(self, folders: Sequence[Path]) -> list[EpisodeSource]:
        """Make one episode of each trial of ObjectFolder: a folder of numbered PNG files."""
        items = []
        for folder in folders:
            trial, number = folder.parents[1].name, folder.parents[3].name
            key = relative_name(folder, self._root)
            part_id = f"objectfolder_{number}"
            items.append(
                self._item(
                    key,
                    (SourceFile(folder, key),),
                    "objectfolder",
                    {
                        "trial": int(trial) if trial.isdecimal() else None,
                        "procedure": "press",
                        **_ids(part_id, "objectfolder"),
                    },
                    part_id,
                    self._frames("objectfolder", processed=False),
                )
            )
        return items

    def samples(self, folders: Sequence[Path]) -> list[EpisodeSource]:
        """Make one episode of each processed sample; one that is broken is a failure."""
        items: list[EpisodeSource] = []
        for folder in folders:
            self._take(items, relative_name(folder, self._root), partial(self._sample, folder))
        return items

    def _take(
        self, items: list[EpisodeSource], name: str, make: Callable[[], EpisodeSource]
    ) -> None:
        """Make an item, or say why there is none: names and labels can be any text."""
        try:
            items.append(make())
        except SourceError as error:
            self.failed.append(Failure(name, str(error)))
        except ValidationError as error:
            said = "; ".join(f"{message} @ {path}" for message, path in problems_of(error))
            self.failed.append(Failure(name, f"its name or its labels cannot be kept: {said}"))

    def _sample(self, folder: Path) -> EpisodeSource:
        document = read_sample_document(folder / "data.json")
        if not (folder / "tactile").is_dir():
            raise SourceError("the sample has no folder tactile/", where=folder)
        dataset = folder.name.rpartition("_")[0]
        video = PurePosixPath((document.tactile_path or "").replace("\\", "/"))
        _, trial = _split_name(video.stem, dataset)
        part_id = document.labels.part_id
        key = relative_name(folder, self._root) if folder != self._root else folder.name
        return self._item(
            key,
            (
                SourceFile(folder / "tactile", f"{key}/tactile"),
                SourceFile(folder / "data.json", f"{key}/data.json", identifies=False),
            ),
            dataset,
            {
                "trial": trial,
                "procedure": _procedure(document.procedure),
                **_ids(part_id, dataset),
            },
            part_id,
            self._frames(dataset, processed=True),
            own=document.labels,
        )

    def _stream(self, dataset: str) -> dict[str, Any]:
        sensor = self._options.sensor or _SENSORS.get(dataset)
        return {"name": "tactile", "kind": "tactile", "sensor": sensor}

    def _frames(self, dataset: str, *, processed: bool) -> dict[str, Any]:
        return {
            "stream": self._stream(dataset),
            "rate": self._options.rate or _ASSUMED_RATE,
            "rate_is_assumed": self._options.rate is None,
            "processed": processed,
        }

    def _item(
        self,
        key: str,
        files: tuple[SourceFile, ...],
        dataset: str,
        facts: dict[str, Any],
        part_id: str | None,
        settings: dict[str, Any],
        *,
        own: PartLabels | None = None,
    ) -> EpisodeSource:
        table = self._labels.get(part_id) if self._labels and part_id else None
        values = {
            **facts,
            "pad_type": self._options.pad_type or _PADS.get(dataset),
            **_words(own),
            **_words(table),
        }
        labels = _merge_labels(own, table)
        quality: tuple[QualityNote, ...] = ()
        if part_id is not None:
            self._seen[part_id] += 1
        if self._labels is not None and table is None:
            self._unlabelled[part_id or key] += 1
            quality = (
                QualityNote(
                    code="no-labels",
                    message=f"the table of labels has no row for {part_id or key}",
                    severity="info",
                ),
            )
        known = {name: value for name, value in values.items() if value is not None}
        if labels:
            known["labels"] = labels
        splits = {**(own.splits if own else {}), **(table.splits if table else {})}
        return EpisodeSource(
            key=key,
            files=files,
            task=Task(name=self._options.task),
            licence=self._options.licence,
            annotations=Annotations.model_validate(known) if known else None,
            settings=settings,
            quality=quality,
            splits=splits,
        )

    def notices(self) -> list[str]:
        """Say which clips have no labels, and which labels no clips. Call it last."""
        found = []
        if self._nameless:
            found.append(
                f"{len(self._nameless)} clip(s) are not named <part id>_<trial>, so their part is "
                f"not known: {', '.join(self._nameless)}"
            )
        if self._labels is None:
            return found
        table = self._options.labels
        unused = sorted(set(self._labels) - set(self._seen))
        if unused:
            found.append(f"{table}: {len(unused)} id(s) match no clip: {', '.join(unused)}")
        if self._unlabelled:
            listed = ", ".join(f"{name} ({n})" for name, n in sorted(self._unlabelled.items()))
            found.append(f"{table}: no row for {len(self._unlabelled)} id(s) of clips: {listed}")
        return found


def _split_name(stem: str, dataset: str) -> tuple[str | None, int | None]:
    """Take part id and trial from a file's name; the part id is all but the last token."""
    head, _, tail = stem.rpartition("_")
    trial = int(tail) if head and tail.isdecimal() and len(tail) < 10 else None
    if dataset == "hardness":
        # Named by Octopi-1.5 after the first two tokens, whatever follows.
        return f"hardness_{'_'.join(stem.split('_')[:2])}", trial if stem.count("_") > 1 else None
    return (bare_id(head.strip()) or None) if head else None, trial


def _ids(part_id: str | None, dataset: str) -> dict[str, str | None]:
    """Return part and object id. Of these two data sets an object has one part."""
    whole = dataset in ("hardness", "objectfolder")
    return {"part_id": part_id, "object_id": part_id if whole else None}


def _procedure(name: str | None) -> str | None:
    if not name:
        return None
    lower = name.strip().lower()
    return _PROCEDURES.get(lower, lower) or None


def _words(labels: PartLabels | None) -> dict[str, str]:
    if labels is None:
        return {}
    words = {"object_id": labels.object_id, "object": labels.object, "part": labels.part}
    return {name: value for name, value in words.items() if value}


def _merge_labels(own: PartLabels | None, table: PartLabels | None) -> list[Label]:
    """Labels of the table, and of the sample itself what the table does not have."""
    chosen = {label.property: label for label in (own.labels if own else ())}
    chosen.update({label.property: label for label in (table.labels if table else ())})
    return list(chosen.values())


def _usual_frames(paths: Sequence[Path]) -> dict[Path, int]:
    """For clips with fewer frames than most of the same folder and rate: how many those have.

    The others are not named, so that their episodes do not depend on their siblings.
    """
    groups: dict[tuple[Path, Fraction | None], list[tuple[Path, VideoHeader]]] = {}
    for path in paths:
        header = read_header(path)
        if header is not None and header.frames:
            groups.setdefault((path.parent, header.rate), []).append((path, header))
    usual: dict[Path, int] = {}
    for members in groups.values():
        frames, count = Counter(header.frames for _, header in members).most_common(1)[0]
        if len(members) >= _SIBLINGS and 2 * count > len(members):
            usual.update({path: frames for path, header in members if header.frames < frames})
    return usual
