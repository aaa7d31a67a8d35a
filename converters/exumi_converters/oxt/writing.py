"""``--to oxt``: a folder of Zarr v2 stores that FTP-1 trains from, one a task."""

import re
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from exumi_converters.exporter import ExportItem, ExportOptions, ExportPlan, Loss, Part
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.oxt.contract import GRIPPER_SLOT, INSTRUCTION, MARK, TIMESTAMPS, key_of
from exumi_converters.oxt.losses import LOSES, find_losses
from exumi_converters.oxt.options import OxtOptions
from exumi_converters.oxt.places import Place, Places, find_places
from exumi_converters.oxt.samples import seconds, write_frames, write_numbers
from exumi_converters.oxt.steps import Steps, find_steps
from exumi_converters.oxt.store import NumberArray, chunk_name, write_array, write_group
from exumi_converters.report import Failure
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError, UsageError

__all__ = ["OxtExporter"]

_SHARE = 0.3  # of the pixels, about
_NUMBERS = np.dtype("<i8")


class OxtExporter:
    """Episodes of one task that have the same streams go into one store."""

    name = "oxt"
    version = "1"
    describes = "Open-X-Tactile / FTP-1: a folder of Zarr v2 stores, one a task"
    keeps: tuple[str, ...] = (
        "camera and tactile images, poses and widths at the steps of one timeline",
        "the task as an instruction; the time of every step",
    )
    loses: Mapping[str, str] = LOSES
    options: type[FormatOptions] = OxtOptions

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Find places and steps of every episode, and sort them into stores."""
        told = parse_options(OxtOptions, options.settings, self.name)
        if destination.suffix in {".zarr", ".zip"}:
            raise UsageError(
                "names a store, and a folder of stores is written",
                where=destination,
                fix="Name the folder of the domain: each task gets a .zarr in it.",
            )
        plan = _Plan(told)
        for name, episode in zip(dataset.ids, dataset, strict=True):
            with episode:
                plan.add(name, episode)
        steps = sum(store["steps"] for store in plan.stores)
        return ExportPlan(
            layout=f"{len(plan.stores)} Zarr v2 store(s) of {len(plan.items)} episode(s), {steps} "
            f"steps, at {_timeline_said(told)}",
            items=tuple(plan.items),
            shared={"options": told.model_dump(), "stores": plan.stores},
            losses=tuple(plan.losses.values()),
            refused=tuple(plan.refused),
            notices=tuple(plan.notices()),
            estimated_bytes=round(sum(store["bytes"] for store in plan.stores)),
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write frames one by one, as they will be called; numbers as whole arrays."""
        told = OxtOptions.model_validate(plan.shared["options"])
        places = [Place.of(v) for v in plan.shared["stores"][item.settings["store"]]["places"]]
        steps = find_steps(episode, places, told)
        if not steps.ends:
            raise DamagedDataError("its streams changed since it was planned", where=episode.path)
        for place in places:
            if place.is_image:
                write_frames(episode, place, steps, folder / place.key)
            else:
                write_numbers(episode, place, steps, folder / f"{place.key}.npy")
        np.save(folder / f"{TIMESTAMPS}.npy", seconds(steps.time_ns), allow_pickle=False)
        return {
            "frames": len(steps.time_ns),
            "ends": list(steps.ends),
            "instruction": _instruction(episode),
        }

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Move the frames of each store's episodes into one row, and join their numbers."""
        for number, store in enumerate(plan.shared["stores"]):
            own = [part for part in parts if part.item.settings["store"] == number]
            if own:
                _Assembly(target / store["file"], store, own, str(about["exporter"])).write()


def _timeline_said(told: OxtOptions) -> str:
    if told.rate:
        return f"{told.rate} steps/s"
    return f"the times of {told.timeline}" if told.timeline else "the camera's own times"


def _instruction(episode: Episode) -> str:
    task = episode.metadata.task
    text = " ".join((task.instruction or "").split())
    return text or task.name


class _Plan:
    """What is decided of one episode after the other."""

    def __init__(self, told: OxtOptions) -> None:
        self._told = told
        self._numbers: dict[str, int] = {}
        self.items: list[ExportItem] = []
        self.stores: list[dict[str, Any]] = []
        self.losses: dict[tuple[str, str | None, str], Loss] = {}
        self.refused: list[Failure] = []
        self._cut: list[str] = []
        self._trimmed: dict[str, int] = {}
        self._without_width = 0

    def add(self, name: str, episode: Episode) -> None:
        """Take an episode in, or refuse it."""
        places = find_places(episode, self._told)
        steps = None
        fault = places.fault
        if fault is None and self._told.timeline and self._told.timeline not in episode:
            fault = f"it has no stream {self._told.timeline!r} to take the steps from"
        if fault is None:
            steps = find_steps(episode, list(places.found.values()), self._told)
            fault = self._fault(steps)
        if steps is None or fault is not None:
            self.refused.append(Failure(name, str(fault)))
            return
        for loss in find_losses(episode, places):
            self.losses.setdefault((loss.facet, loss.stream, loss.detail), loss)
        if len(steps.ends) > 1:
            self._cut.append(f"{name} ({len(steps.ends)} pieces)")
        for stream, count in steps.reasons.items():
            self._trimmed[stream] = self._trimmed.get(stream, 0) + count
        self._without_width += not any(p.kind == "gripper" for p in places.found.values())
        store = self._store(episode, places, steps)
        self.items.append(ExportItem(id=name, index=len(self.items), settings={"store": store}))

    def _fault(self, steps: Steps) -> str | None:
        if not steps.ends:
            return "there are not two steps in a row for which all streams have a value"
        if self._told.gaps == "refuse" and (steps.left_out or len(steps.ends) > 1):
            found = ", ".join(f"{stream}: {count}" for stream, count in steps.reasons.items())
            return (
                f"{steps.left_out} steps fall into gaps ({found or 'of the timeline itself'}), and "
                "-o gaps=refuse was said"
            )
        return None

    def _store(self, episode: Episode, places: Places, steps: Steps) -> int:
        """Return the number of the store that an episode goes into; a new one where none fits."""
        task = episode.metadata.task.name
        values = [place.json() for place in sorted(places.found.values(), key=lambda p: p.key)]
        length = len(_instruction(episode))
        number = self._fitting(task, values)
        if number is None:
            number = len(self.stores)
            new = {"file": self._file(task), "task": task, "places": values}
            self.stores.append({**new, "instruction_length": 1, "steps": 0, "bytes": 0})
        store = self.stores[number]
        store["instruction_length"] = max(store["instruction_length"], length)
        store["steps"] += len(steps.time_ns)
        store["bytes"] += len(steps.time_ns) * sum(
            place.row_bytes * (_SHARE if place.is_image else 1) for place in places.found.values()
        )
        return number

    def _fitting(self, task: str, places: list[dict[str, Any]]) -> int | None:
        for number, store in enumerate(self.stores):
            if store["task"] == task and store["places"] == places:
                return number
        return None

    def _file(self, task: str) -> str:
        plain = re.sub(r"[^A-Za-z0-9.-]+", "_", task).strip("._-")[:100] or "task"
        number = self._numbers[plain.lower()] = self._numbers.get(plain.lower(), 0) + 1
        return f"{plain}.zarr" if number == 1 else f"{plain}_{number}.zarr"

    def notices(self) -> Iterator[str]:
        """Say what the user should know."""
        if self._cut:
            named = ", ".join(self._cut[:5]) + (", ..." if len(self._cut) > 5 else "")
            yield f"{len(self._cut)} episode(s) are cut into pieces at gaps: {named}"
        for stream, count in self._trimmed.items():
            yield f"{count} step(s) are left out, as {stream} has no value there"
        if self._without_width:
            yield (
                f"{self._without_width} episode(s) have no width: FTP-1's loader takes a hand "
                "without hand_joints for absent, and its touch with it"
            )
        if self._told.axes == "kept":
            yield (
                "the axes of poses are kept; if they are UMI's (z forward, x right, y down), "
                "-o axes=umi turns them to the contract's (z forward, x down, y left)"
            )


class _Assembly:
    """One store that is being put together."""

    def __init__(
        self, root: Path, store: Mapping[str, Any], parts: Sequence[Part], exporter: str
    ) -> None:
        self._root = root
        self._data = root / "data"
        self._store = store
        self._parts = parts
        self._exporter = exporter
        self._places = [Place.of(values) for values in store["places"]]
        self._length = sum(part.result["frames"] for part in parts)

    def write(self) -> None:
        """Write everything."""
        write_group(self._root, {MARK: self._about()})
        write_group(self._root / "meta")
        write_group(self._data)
        self._write_ends()
        self._join(TIMESTAMPS, (), np.dtype("<f8"))
        self._write_instructions()
        for place in self._places:
            if place.is_image:
                self._move(place)
            else:
                self._join(place.key, place.row, np.dtype(place.dtype))
            if place.kind == "gripper":
                self._constant(f"{place.key}_idx", (1,), _NUMBERS, GRIPPER_SLOT)
            if place.areas:
                self._describe(place)

    def _about(self) -> dict[str, Any]:
        """Say what the contract leaves open: units, names, where each episode came from."""
        arrays: dict[str, Any] = {
            place.key: {"streams": list(place.streams), **place.about} for place in self._places
        }
        arrays[TIMESTAMPS] = {"unit": "s"}
        episodes = [part.item.id for part in self._parts for _ in part.result["ends"]]
        return {
            "exporter": self._exporter,
            "task": self._store["task"],
            "episodes": episodes,
            "arrays": arrays,
        }

    def _write_ends(self) -> None:
        ends, offset = [], 0
        for part in self._parts:
            ends += [offset + end for end in part.result["ends"]]
            offset += part.result["frames"]
        array = NumberArray(self._root / "meta/episode_ends", (), _NUMBERS, len(ends))
        array.append(np.array(ends))
        array.finish()

    def _write_instructions(self) -> None:
        text = np.dtype(f"<U{self._store['instruction_length']}")
        array = NumberArray(self._data / INSTRUCTION, (), text, self._length)
        for part in self._parts:
            array.repeat(part.result["instruction"], part.result["frames"])
        array.finish()

    def _join(self, key: str, row: tuple[int, ...], dtype: np.dtype[Any]) -> None:
        array = NumberArray(self._data / key, row, dtype, self._length)
        for part in self._parts:
            array.append(np.load(part.folder / f"{key}.npy", mmap_mode="r", allow_pickle=False))
        array.finish()

    def _constant(
        self, key: str, row: tuple[int, ...], dtype: np.dtype[Any], value: object
    ) -> None:
        array = NumberArray(self._data / key, row, dtype, self._length)
        array.repeat(value, self._length)
        array.finish()

    def _describe(self, place: Place) -> None:
        """Write the three arrays that stand beside tactile data."""
        kind = "image" if place.kind == "tactile" else "state"
        areas = np.array(place.areas, _NUMBERS)
        self._constant(key_of(place.key, "area"), areas.shape, _NUMBERS, areas)
        for what, text in (("sensor", place.sensor), ("type", kind)):
            self._constant(key_of(place.key, what), (), np.dtype(f"<U{len(text)}"), text)

    def _move(self, place: Place) -> None:
        """Give the frames of all parts their numbers in the store."""
        pads = range(len(place.streams)) if place.kind == "tactile" else (None,)
        chunks = (1, 1, *place.row[1:]) if place.kind == "tactile" else (1, *place.row)
        folder = self._data / place.key
        write_array(folder, (self._length, *place.row), chunks, np.dtype(place.dtype))
        offset = 0
        for part in self._parts:
            for step in range(part.result["frames"]):
                for pad in pads:
                    piece = () if pad is None else (pad,)
                    old = chunk_name(step, *piece, dimensions=len(chunks))
                    new = chunk_name(offset + step, *piece, dimensions=len(chunks))
                    (part.folder / place.key / old).rename(folder / new)
            offset += part.result["frames"]
