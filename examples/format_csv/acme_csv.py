"""Format ``acme-csv``: a folder an episode, with ``pose.csv`` and ``width.csv``."""

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from pydantic import Field

from exumi_converters import (
    FACETS,
    ConvertOptions,
    Discovery,
    EpisodeSource,
    ExportItem,
    ExportOptions,
    ExportPlan,
    FormatOptions,
    Loss,
    Part,
    SourceFile,
    parse_options,
)
from exumi_data import Dataset, Episode, EpisodeWriter
from exumi_data.errors import SourceError
from exumi_data.model import Clock, Frames, Task

_COLUMNS = {"pose": "time_ns,x,y,z,qx,qy,qz,qw", "width": "time_ns,width_m"}
_KEPT = ("time", "values", "stream-names", "task", "regime")


class Converter:
    """Reads the tables. Times and values are taken as they are."""

    name = "acme-csv"
    version = "1"
    id_version = 1
    describes = "a folder for each episode, with pose.csv and width.csv"
    keeps: tuple[str, ...] = ("times and values of poses and widths, digit by digit",)
    loses: tuple[str, ...] = ("every other file of a folder",)
    options: type[FormatOptions] = FormatOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise a folder by its first episode."""
        table = next(iter(sorted(source.glob("*/pose.csv"))), None) if source.is_dir() else None
        return None if table is None else f"{table.parent.name}/pose.csv"

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find the folders of episodes."""
        folders = sorted(path.parent for path in source.glob("*/pose.csv"))
        if not folders:
            raise SourceError("there is no */pose.csv", where=source)
        return Discovery(
            layout=f"{len(folders)} folders", items=tuple(map(self._item(options), folders))
        )

    @staticmethod
    def _item(options: ConvertOptions) -> Any:
        def item(folder: Path) -> EpisodeSource:
            about = json.loads((folder / "about.json").read_text())
            names = [f"{name}.csv" for name in _COLUMNS if (folder / f"{name}.csv").is_file()]
            return EpisodeSource(
                key=folder.name,
                files=tuple(SourceFile(folder / name, f"{folder.name}/{name}") for name in names),
                task=Task(**about["task"]) if "task" in about else Task(name=options.task),
                regime=about.get("regime", "demonstration"),
                licence=options.licence,
            )

        return item

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write the streams of one episode."""
        rows = 0
        for file in item.files:
            kind = file.path.stem
            try:
                table = np.genfromtxt(file.path, delimiter=",", skip_header=1, dtype=str, ndmin=2)
                time, values = table[:, 0].astype(np.int64), table[:, 1:].astype(np.float64)
            except ValueError as error:
                raise SourceError(f"is no table of numbers ({error})", where=file.path) from None
            fields = {"frames": Frames(parent="world", child="tcp")} if kind == "pose" else {}
            clock = Clock(source="acme", stamp_point="user_rx")
            stream = writer.add_stream(kind, kind=kind, clock=clock, **fields)
            stream.append(time, values if kind == "pose" else values[:, 0].astype(np.float32))
            rows += len(table)
        return rows


class Options(FormatOptions):
    """What only this format can be told."""

    header: Literal["yes", "no"] = Field("yes", description="Begin each table with its columns.")


class Exporter:
    """Writes the tables."""

    name = "acme-csv"
    version = "1"
    describes = "a folder for each episode, with pose.csv and width.csv"
    keeps: tuple[str, ...] = ("poses and widths, digit by digit",)
    loses: Mapping[str, str] = {name: "not in the tables" for name in FACETS if name not in _KEPT}
    options: type[FormatOptions] = Options

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Every episode is written; what is no pose and no width is left out."""
        told = parse_options(Options, options.settings, self.name)
        losses, size = {}, 0
        for episode in dataset:
            for stream in episode.streams.values():
                if stream.name not in _COLUMNS:
                    losses[stream.name] = Loss(
                        facet="streams", detail="there is no table for it", stream=stream.name
                    )
                else:
                    size += 100 * len(stream)
        return ExportPlan(
            layout=f"tables of {len(dataset)} episodes",
            items=tuple(ExportItem(id=name, index=i) for i, name in enumerate(dataset.ids)),
            shared={"header": told.header == "yes"},
            losses=tuple(losses.values()),
            estimated_bytes=size,
        )

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write the tables of one episode."""
        about = {
            "task": episode.metadata.task.model_dump(exclude_none=True),
            "regime": episode.metadata.regime,
        }
        (folder / "about.json").write_text(json.dumps(about))
        rows = 0
        for name, columns in _COLUMNS.items():
            if name not in episode:
                continue
            stream = episode[name]
            lines = [columns] if plan.shared["header"] else []
            for time, value in zip(stream.time, stream.data, strict=True):
                numbers = ",".join(repr(float(part)) for part in np.atleast_1d(value))
                lines.append(f"{time},{numbers}")
            (folder / f"{name}.csv").write_text("\n".join(lines) + "\n")
            rows += len(stream)
        return {"frames": rows}

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Give each episode's folder its name."""
        for part in parts:
            part.folder.rename(target / part.item.id)


CONVERTER = Converter()
EXPORTER = Exporter()
