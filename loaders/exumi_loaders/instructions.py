"""Questions and answers about touch, for tactile-language models (Octopi-1.5)."""

import json
import operator
import os
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, SupportsIndex

import numpy as np
from torch.utils.data import DataLoader, Dataset

from exumi_data.errors import ChangedDataError, DamagedDataError, UsageError
from exumi_data.store.files import atomic_file
from exumi_loaders.clip_batches import ClipBatches, as_is, replacements
from exumi_loaders.clip_splits import SplitLevel, split_dataset
from exumi_loaders.clips import Clip, Clips, Provenance
from exumi_loaders.draws import words
from exumi_loaders.instruction_text import Asked, Ties, answer_text, question_text
from exumi_loaders.options import one_of
from exumi_loaders.window_frames import OnCorrupt

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["TASKS", "Instruction", "InstructionPart", "InstructionSamples"]

Task = Literal["describe", "describe_and_rank", "rank"]
TASKS: tuple[Task, ...] = ("describe", "describe_and_rank", "rank")

_PURPOSE = 23  # of draws, see draws.py
_BLOCK = 64
_ATTEMPTS = 500
_MOST_REPLACEMENTS = 100
_FIRST = np.zeros(1, dtype=np.int64)

Kind = tuple[str, str | None]


@dataclass(frozen=True)
class InstructionPart:
    """One part of a sample: a group of frames of its own.

    Attributes
    ----------
    label : str
        Object number and part number, such as ``2.1``.
    object, part : int
        The two numbers; parts of one object number are parts of one real object.
    clip : int
        Position in ``clips.table``.
    """

    label: str
    object: int
    part: int
    clip: int


@dataclass(frozen=True)
class Instruction:
    """One sample: what is asked about which clips, and the answer.

    Attributes
    ----------
    index : int
    task : {"describe", "describe_and_rank", "rank"}
    sensor_model, pad_type : str or None
        The same for all parts.
    properties : tuple of str
        Those that are to be ranked; empty where nothing is.
    parts : tuple of InstructionPart
    question, answer : str
        The question has ``<tact_tokens>`` where the frames of each part go, in order.
    """

    index: int
    task: Task
    sensor_model: str
    pad_type: str | None
    properties: tuple[str, ...]
    parts: tuple[InstructionPart, ...]
    question: str
    answer: str


class InstructionSamples(Dataset[dict[str, Any]]):
    """Descriptions and rankings of several object parts, made from labels.

    Each part is a group of frames of its own, named by object and part number. The answer
    describes each part first, in the adjectives of its labels, and decides then::

        Describe the object parts in the following tactile videos and rank them in decreasing
        hardness.

        Object 1
        Part 1.1: <tact_tokens>
        Part 1.2: <tact_tokens>

    ::

        Object 1
        Part 1.1: smooth, flat.
        Part 1.2: soft, bumpy.

        Object parts ranked in decreasing hardness: 1.1, 1.2

    Clips of different sensor models or pad types are never in one sample, nor is a part twice.
    A part is described only if it has adjectives, and a property is asked only if all parts of the
    sample have a rating of it. A sample is a pure function of (seed, index) and the dataset.

    Parameters
    ----------
    dataset : exumi_data.Dataset
        Frames of one sensor model and pad type have one size where samples are read as tensors.
    count : int
        Samples.
    tasks : sequence of {"describe", "describe_and_rank", "rank"}
        Drawn alike. ``rank`` gives the decision alone.
    properties : sequence of str
        What is ranked; ratings on a stated scale.
    ties : {"not_asked", "equal"}
        A property in which two parts of a sample have the same rating is not asked of them, or
        they are said to be equal (``1.1, 1.2 = 2.1``, as the question then explains).
    tie_margin : float
        Ratings that differ by no more count as the same; raters do not agree on less. Only with
        ``not_asked``.
    max_objects, max_parts : int
        Most objects of a sample, and parts of an object; 5 and 2 in Octopi-1.5.
    frames : int
        Salient frames of a clip.
    provenance : {"human", "any"}
        Whose labels count.
    stream : str or sequence of str, optional
        Tactile streams; default all.
    split, split_by, split_ratio
        See `split_dataset`: parts of ``test`` or ``val`` are in no sample of ``train``.
    grey_tactile : bool
        Give one channel (luma) of colour frames.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged frames of a sample that is read. ``raise``: an error that names
        episode, stream and frame. ``skip``: another sample takes the place (drawn by seed and
        index), and ``replaced`` counts the damaged ones. ``substitute``: the frame is black,
        marked in ``frames_valid`` and counted in ``substituted``. A dataset that changed since it
        was opened is an error in any case. `instruction` and `write_jsonl` decode nothing.
    seed : int
        Of samples, and of a split made on the fly.

    Attributes
    ----------
    clips : Clips
    left_out : dict of str to int
        Clips that no sample can hold, by reason.

    Raises
    ------
    UsageError
        Labels for a task are missing.

    Notes
    -----
    Octopi-1.5 keeps such samples as a JSON list of ``{"info": {"tactile": [folder, ...],
    "objects": ..., "get_description", "get_order", ...}, "chat": [{"role": "user", "content":
    ...}, {"role": "assistant", ...}]}``. `write_jsonl` writes the same ``chat``, with the same
    ``<tact_tokens>``, one for each part in order, and ``parts`` instead of ``info.tactile`` and
    ``info.objects``: episode, stream and frame numbers instead of a folder of JPEG files. Its
    generator differs where labels would not bear it out: it takes any two parts for one object,
    may take a part twice and the two pads of one sensor together, and it ranks equal ratings.

    Examples
    --------
    >>> samples = InstructionSamples(exumi_data.open("training"), split="train")  # doctest: +SKIP
    >>> samples.write_jsonl("train.jsonl")  # doctest: +SKIP
    >>> samples[0]["frames"].shape  # doctest: +SKIP
    torch.Size([4, 10, 1, 224, 224])
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
        count: int = 1000,
        tasks: Sequence[Task] = ("describe", "describe_and_rank"),
        properties: Sequence[str] = ("hardness", "roughness"),
        ties: Ties = "not_asked",
        tie_margin: float = 0.0,
        max_objects: int = 5,
        max_parts: int = 2,
        frames: int = 10,
        provenance: Provenance = "human",
        stream: str | Sequence[str] | None = None,
        split: str | None = None,
        split_by: SplitLevel = "part",
        split_ratio: tuple[int, int] = (15, 1),
        grey_tactile: bool = False,
        on_corrupt: OnCorrupt = "raise",
        seed: int = 0,
    ) -> None:
        _check_options(count, tasks, ties, tie_margin, max_objects, max_parts)
        dataset = split_dataset(dataset, split, by=split_by, ratio=split_ratio, seed=seed)
        self.clips = Clips(dataset, stream=stream, frames=frames, provenance=provenance)
        self._count, self._seed = count, seed
        self._tasks = tuple(tasks)
        self._properties = tuple(properties)
        self._ties, self._margin = ties, tie_margin
        self._most = (max_objects, max_parts)
        usable, self.left_out = _usable(self.clips.table)
        self._choices = self._make_choices(usable)
        one_of("on_corrupt", on_corrupt, ("raise", "skip", "substitute"))
        self._skips = on_corrupt == "skip"
        self._batches = ClipBatches(
            self.clips,
            usable,
            grey=grey_tactile,
            # Here, a sample is replaced as a whole, not a clip of it.
            on_corrupt="raise" if self._skips else on_corrupt,
        )

    def __len__(self) -> int:
        return self._count

    def __repr__(self) -> str:
        return f"<InstructionSamples: {len(self)} about {len(self.clips)} clips>"

    def _make_choices(self, usable: list[int]) -> dict[Task, list["_Pool"]]:
        """Return the pools of clips that each task can draw from: a ranking has one a property."""
        choices: dict[Task, list[_Pool]] = {}
        table = self.clips.table
        for task in self._tasks:
            described = [i for i in usable if table[i].adjectives or task == "rank"]
            if task == "describe":
                pools = [_Pool(table, described)]
            else:
                rated = [[i for i in described if p in table[i].labels] for p in self._properties]
                pools = [_Pool(table, clips) for clips in rated]
            pools = [pool for pool in pools if pool.most_parts() > (task != "describe")]
            if not pools:
                raise UsageError(
                    f"too few parts have the labels of task {task!r}: {self._needs(task)}",
                    where=self.clips.dataset.path,
                    fix="Leave the task out, or take models' labels too: provenance='any'.",
                )
            choices[task] = pools
        return choices

    def _needs(self, task: Task) -> str:
        ratings = f"ratings of {' or '.join(self._properties)} of two parts"
        return {
            "describe": "adjectives",
            "describe_and_rank": f"adjectives, and {ratings}",
            "rank": ratings,
        }[task]

    def instruction(self, index: int) -> Instruction:
        """Make one sample; nothing is decoded.

        Parameters
        ----------
        index : int

        Returns
        -------
        Instruction

        Raises
        ------
        UsageError
            The labels leave nothing to rank: all parts have the same ratings.
        """
        if not -len(self) <= index < len(self):
            msg = f"sample {index} of {len(self)}"
            raise IndexError(msg)
        index %= len(self)
        draws = _Draws(self._seed, index)
        task = draws.one_of(self._tasks)
        for _ in range(_ATTEMPTS):
            found = self._attempt(index, task, draws)
            if found is not None:
                return found
        raise UsageError(
            f"no ranking of {self._properties} without ties was found",
            where=self.clips.dataset.path,
            fix="Give ties='equal', a smaller tie_margin, or tasks=('describe',).",
        )

    def _attempt(self, index: int, task: Task, draws: "_Draws") -> Instruction | None:
        pool = draws.one_of(self._choices[task])
        kind, parts = pool.draw(draws, *self._most)
        clips = [self.clips.table[part.clip] for part in parts]
        properties = () if task == "describe" else self._can_be_ranked(clips)
        twice = len({clip.part_id for clip in clips}) < len(clips)  # under another object
        if twice or (task != "describe" and not properties):
            return None
        asked = Asked(task != "rank", properties, self._ties)
        labels = [part.label for part in parts]
        return Instruction(
            index=index,
            task=task,
            sensor_model=kind[0],
            pad_type=kind[1],
            properties=properties,
            parts=tuple(parts),
            question=question_text(asked, labels),
            answer=answer_text(asked, labels, clips),
        )

    def _can_be_ranked(self, clips: Sequence[Clip]) -> tuple[str, ...]:
        """Return the properties in which these clips have an order."""
        if len(clips) < 2:
            return ()
        return tuple(name for name in self._properties if self._has_order(clips, name))

    def _has_order(self, clips: Sequence[Clip], name: str) -> bool:
        ratings = sorted(clip.labels[name] for clip in clips if name in clip.labels)
        if len(ratings) < len(clips):
            return False
        if self._ties == "equal":
            return ratings[0] < ratings[-1]
        return bool((np.diff(ratings) > self._margin).all())

    def __iter__(self) -> Iterator[Instruction]:
        """Yield every sample, without its frames."""
        for index in range(len(self)):
            yield self.instruction(index)

    def __getitem__(self, index: SupportsIndex) -> dict[str, Any]:
        """Return a sample with its frames.

        Returns
        -------
        dict
            ``frames`` (G, K, C, H, W) uint8 of G parts, ``frames_valid`` (G, K) bool,
            ``reference`` (G, C, H, W) uint8 if all clips have one, ``clip`` and ``episode`` (G,)
            int64; ``labels`` (G names such as ``1.1``), ``question``, ``answer``, ``task`` (str).
            ``replaced`` (int) with ``skip``, ``substituted`` (G,) int64 with ``substitute``.
        """
        number = operator.index(index)
        if not self._skips:
            return self._read(number)
        for tries in range(_MOST_REPLACEMENTS + 1):
            asked = replacements(self._seed, [number], _FIRST, tries, len(self)) if tries else None
            try:
                item = self._read(number if asked is None else int(asked[0]))
            except ChangedDataError:
                raise
            except DamagedDataError:
                continue
            return {**item, "replaced": tries}
        raise DamagedDataError(
            f"sample {number} and {_MOST_REPLACEMENTS} that were drawn to replace it have damaged "
            "frames",
            where=self.clips.dataset.path,
            fix="See what is damaged: exumi validate --level data",
        )

    def _read(self, number: int) -> dict[str, Any]:
        sample = self.instruction(number)
        chosen = [part.clip for part in sample.parts]
        self._batches.require_one_size(chosen)
        return {
            **self._batches.fill(np.array(chosen)),
            "labels": [part.label for part in sample.parts],
            "question": sample.question,
            "answer": sample.answer,
            "task": sample.task,
        }

    def loader(
        self, batch_size: int, *, num_workers: int = 0, **options: Any
    ) -> DataLoader[dict[str, Any]]:
        """Make a DataLoader; a batch is a list of samples, which differ in their parts.

        Parameters
        ----------
        batch_size : int
        num_workers : int
        **options
            Passed on to `torch.utils.data.DataLoader`, such as ``shuffle``.
        """
        return DataLoader(
            self, batch_size=batch_size, num_workers=num_workers, collate_fn=as_is, **options
        )

    def document(self, sample: Instruction) -> dict[str, Any]:
        """Return a sample as `write_jsonl` writes it.

        Parameters
        ----------
        sample : Instruction
        """
        return {
            "index": sample.index,
            "task": sample.task,
            "properties": list(sample.properties),
            "sensor_model": sample.sensor_model,
            "pad_type": sample.pad_type,
            "parts": [self._part_document(part) for part in sample.parts],
            "chat": [
                {"role": "user", "content": sample.question},
                {"role": "assistant", "content": sample.answer},
            ],
        }

    def _part_document(self, part: InstructionPart) -> dict[str, Any]:
        clip = self.clips.table[part.clip]
        salient = self.clips.salient(part.clip)
        return {
            "label": part.label,
            "part_id": clip.part_id,
            "object_id": clip.object_id,
            "episode": clip.id,
            "stream": clip.stream,
            "frames": salient.numbers[salient.valid].tolist(),
        }

    def write_jsonl(self, path: str | os.PathLike[str]) -> int:
        """Write all samples as JSON lines, the same bytes for the same dataset and options.

        Parameters
        ----------
        path : path-like
            Written anew, whole or not at all.

        Returns
        -------
        int
            Samples written.
        """
        with atomic_file(Path(path)) as temporary, temporary.open("wb") as file:
            for sample in self:
                line = json.dumps(self.document(sample), ensure_ascii=False, separators=(",", ":"))
                file.write(line.encode() + b"\n")
        return len(self)


def _check_options(
    count: int,
    tasks: Sequence[str],
    ties: str,
    tie_margin: float,
    max_objects: int,
    max_parts: int,
) -> None:
    for name, value in (("count", count), ("max_objects", max_objects), ("max_parts", max_parts)):
        if value < 1:
            raise UsageError(f"{name} is {value}, not a positive number")
    unknown = [task for task in tasks if task not in TASKS]
    if unknown or not tasks:
        raise UsageError(f"invalid tasks {list(tasks)}. Supported values are {', '.join(TASKS)}")
    if ties not in ("not_asked", "equal"):
        raise UsageError(f"invalid ties ({ties!r}). Supported values are 'not_asked', 'equal'")
    if tie_margin < 0 or (tie_margin and ties == "equal"):
        raise UsageError(
            f"tie_margin is {tie_margin}: it is not negative, and goes with ties='not_asked' only"
        )


class _Draws:
    """A stream of random numbers for one sample."""

    def __init__(self, seed: int, index: int) -> None:
        self._seed, self._index = seed, np.array([index])
        self._blocks = 0
        self._left: list[int] = []

    def below(self, count: int) -> int:
        """Draw a whole number in [0, count)."""
        if not self._left:
            block = np.array([self._blocks])
            drawn = words(self._seed, block, self._index, _BLOCK, purpose=_PURPOSE)
            self._left = drawn[0].tolist()
            self._blocks += 1
        return self._left.pop() % count

    def one_of(self, choices: Sequence[Any]) -> Any:
        """Draw one of some."""
        return choices[self.below(len(choices))]

    def several(self, choices: Sequence[Any], count: int) -> list[Any]:
        """Draw `count` of some, in random order."""
        left = list(choices)
        return [left.pop(self.below(len(left))) for _ in range(count)]


class _Pool:
    """Clips that a task can draw from: by kind, object and part."""

    def __init__(self, table: Sequence[Clip], chosen: Sequence[int]) -> None:
        self._kinds: dict[Kind, dict[str, dict[str, list[int]]]] = {}
        for index in chosen:
            clip = table[index]
            assert clip.sensor_model is not None and clip.part_id is not None  # noqa: S101, PT018  # see _usable
            kind = (clip.sensor_model, clip.pad_type)
            # A part whose object is not known is an object of its own.
            whole = f"object {clip.object_id}" if clip.object_id else f"part {clip.part_id}"
            parts = self._kinds.setdefault(kind, {}).setdefault(whole, {})
            parts.setdefault(clip.part_id, []).append(index)
        self._parts = sorted(
            (
                (kind, whole, name)
                for kind, objects in self._kinds.items()
                for whole, parts in objects.items()
                for name in parts
            ),
            key=lambda part: (part[0][0], part[0][1] or "", *part[1:]),
        )
        self._objects = {
            kind: sorted({whole for k, whole, _ in self._parts if k == kind})
            for kind in self._kinds
        }

    def most_parts(self) -> int:
        """Return how many parts the largest kind has."""
        return max((sum(map(len, objects.values())) for objects in self._kinds.values()), default=0)

    def draw(
        self, draws: _Draws, max_objects: int, max_parts: int
    ) -> tuple[Kind, list[InstructionPart]]:
        """Draw the parts of a sample, each with one of its clips."""
        kind, first, _ = draws.one_of(self._parts)  # kinds in proportion to their parts
        others = [whole for whole in self._objects[kind] if whole != first]
        count = 1 + draws.below(min(max_objects, 1 + len(others)))
        found = []
        for number, whole in enumerate([first, *draws.several(others, count - 1)], start=1):
            parts = self._kinds[kind][whole]
            wanted = 1 + draws.below(min(max_parts, len(parts)))
            for position, name in enumerate(draws.several(sorted(parts), wanted), start=1):
                label = f"{number}.{position}"
                clip = draws.one_of(sorted(parts[name]))
                found.append(InstructionPart(label, number, position, clip))
        return kind, found


def _usable(table: Sequence[Clip]) -> tuple[list[int], dict[str, int]]:
    usable = []
    left_out: dict[str, int] = {}
    for index, clip in enumerate(table):
        if clip.part_id is None or clip.sensor_model is None:
            why = "without a part id" if clip.part_id is None else "without a sensor model"
            left_out[why] = left_out.get(why, 0) + 1
        else:
            usable.append(index)
    return usable, left_out
