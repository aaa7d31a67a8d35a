"""What an exporter is: it plans what becomes of episodes, writes one, and puts the parts together.

An exporter knows one format and nothing of processes, resuming, locks or final names:
`exumi_converters.exporting` does that for all of them.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from exumi_converters.format_options import FormatOptions
from exumi_converters.report import Failure
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode

__all__ = ["ExportItem", "ExportOptions", "ExportPlan", "Exporter", "Loss", "Part"]


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportOptions:
    """What the user can say about an export.

    Attributes
    ----------
    settings : mapping of str to str
        Options of the format itself (`Exporter.options`).
    workers : int, optional
        Processes; default all cores.
    keep_going : bool
        Write the episodes that can be written although others cannot.
    durable : bool
        Make the result survive a power loss before it takes its final name.
    """

    settings: Mapping[str, str] = field(default_factory=dict)
    workers: int | None = None
    keep_going: bool = False
    durable: bool = True


@dataclass(frozen=True, slots=True, kw_only=True)
class Loss:
    """Something of these episodes that the format cannot hold.

    Attributes
    ----------
    facet : str
        A key of `exumi_converters.facets.FACETS`.
    detail : str
        One line for the user: what happens to it.
    stream : str or None
        Which stream; None: the episode, or all streams.
    """

    facet: str
    detail: str
    stream: str | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportItem:
    """One episode that will be written.

    Attributes
    ----------
    id : str
        Of the episode.
    index : int
        Its place in the plan; parts are put together in this order.
    settings : dict
        What `Exporter.write` needs of it, JSON values only.
    """

    id: str
    index: int
    settings: dict[str, Any] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportPlan:
    """What will be written, and what will be lost. Made from metadata alone: no frame is decoded.

    Attributes
    ----------
    layout : str
        One line: what will be written.
    items : tuple of ExportItem
    writes : {"folder", "file"}
        What the destination becomes.
    shared : dict
        What was decided once for all episodes (timeline, features, shapes), JSON values only.
    losses : tuple of Loss
    refused : tuple of Failure
        Episodes that the format cannot hold, and why.
    notices : tuple of str
    estimated_bytes : int or None
    """

    layout: str
    items: tuple[ExportItem, ...]
    writes: Literal["folder", "file"] = "folder"
    shared: dict[str, Any] = field(default_factory=dict)
    losses: tuple[Loss, ...] = ()
    refused: tuple[Failure, ...] = ()
    notices: tuple[str, ...] = ()
    estimated_bytes: int | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class Part:
    """One episode as `Exporter.write` left it.

    Attributes
    ----------
    item : ExportItem
    folder : pathlib.Path
        What was written.
    result : dict
        What `Exporter.write` returned.
    """

    item: ExportItem
    folder: Path
    result: dict[str, Any]


class Exporter(Protocol):
    """Writes one format. Third parties add theirs under the entry point ``exumi.exporters``."""

    name: str
    """What the user writes after ``--to``."""
    version: str
    """Of what it writes: raise it when the same episodes give other files than before."""
    describes: str
    """One line for the user."""
    keeps: tuple[str, ...]
    """What of an episode is in the result, in words."""
    loses: Mapping[str, str]
    """Facets of an episode that do not survive, and what happens to them; see `FACETS`."""
    options: type[FormatOptions]
    """The format's own options."""

    def plan(self, dataset: Dataset, destination: Path, options: ExportOptions) -> ExportPlan:
        """Decide what will be written. Reads metadata and times, decodes no frame, writes nothing.

        Parameters
        ----------
        dataset : Dataset
        destination : pathlib.Path
            What the user wants it called: its name may decide between a folder and a file.
        options : ExportOptions

        Raises
        ------
        UsageError
            An option makes no sense, or no common layout fits these episodes.
        """
        ...

    def write(
        self, item: ExportItem, episode: Episode, folder: Path, plan: ExportPlan
    ) -> dict[str, Any]:
        """Write one episode into a folder of its own; called in workers.

        Parameters
        ----------
        item : ExportItem
        episode : Episode
        folder : pathlib.Path
            New and empty.
        plan : ExportPlan
            Without its items: only what all episodes share.

        Returns
        -------
        dict
            JSON values for `assemble`; ``frames`` is the number of frames written.

        Raises
        ------
        ExumiError
            The episode cannot be written; the others are.
        """
        ...

    def assemble(
        self, parts: Sequence[Part], target: Path, plan: ExportPlan, about: Mapping[str, Any]
    ) -> None:
        """Put the parts together. Frames are not encoded again here.

        Files of the parts may be moved or removed, but not changed: they are links to those that
        the next run goes on with if this one is stopped here.

        Parameters
        ----------
        parts : sequence of Part
            In the order of the plan, without those that failed.
        target : pathlib.Path
            A new, empty folder, or the name of a file to make; it takes its final name afterwards.
        plan : ExportPlan
        about : mapping
            Where the result came from (JSON values): a folder gets it as ``exumi_export.json``
            anyway; a format that has a place for it keeps it there too.
        """
        ...
