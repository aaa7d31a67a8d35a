"""What a converter is: it finds the episodes in a source, and writes one of them.

A converter knows one format and nothing of ids, resuming, processes or catalogs: `exumi_converters`
does that for all of them (``run.py``).
"""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, Protocol

from exumi_converters.format_options import FormatOptions
from exumi_converters.report import Failure
from exumi_data.model import UNKNOWN_LICENCE, Annotations, QualityNote, SplitDocument, Task
from exumi_data.store.episode_writer import EpisodeWriter

__all__ = [
    "ConvertOptions",
    "Converter",
    "Discovery",
    "EpisodeSource",
    "NamedSplit",
    "SourceFile",
    "SourceMembers",
]


@dataclass(frozen=True, slots=True, kw_only=True)
class ConvertOptions:
    """What the user can say about a conversion.

    Attributes
    ----------
    labels : pathlib.Path, optional
        CSV file of labels (formats that have them).
    licence : str
        SPDX expression; ``NOASSERTION`` when it is not known.
    task : str
        Name of the task.
    rate : str, optional
        Frames a second, as a rational number such as ``60000/1001``: for sources that do not say.
    sensor : str, optional
        Sensor model, such as ``gelsight-mini``; where the format does not imply it.
    pad_type : {"plain", "dotted"}, optional
        Gel of the sensor, where the format does not imply it.
    stream, kind : str
        Name and kind of the image stream (format ``clips``).
    workers : int, optional
        Processes; default all cores.
    keep_going : bool
        Whether failures leave the exit status 0. Everything that can be converted is converted in
        either case, and every failure is reported.
    durable : bool
        Make every episode survive a power loss before it takes its final name.
    settings : mapping of str to str
        Options of the format itself (`Converter.options`).
    """

    labels: Path | None = None
    licence: str = UNKNOWN_LICENCE
    task: str = "touch"
    rate: str | None = None
    sensor: str | None = None
    pad_type: Literal["plain", "dotted"] | None = None
    stream: str = "tactile"
    kind: Literal["tactile", "rgb"] = "tactile"
    workers: int | None = None
    keep_going: bool = False
    durable: bool = True
    settings: Mapping[str, str] = field(default_factory=dict)


class SourceMembers(Protocol):
    """What one episode is made from, of a file or folder that holds many.

    It travels to a worker with its episode.
    """

    def __iter__(self) -> Iterator[tuple[str, bytes]]:
        """Yield name and content of each member, in a stable order.

        The names and contents do not depend on how the members are packed.
        """
        ...


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file, or a folder of files, that an episode is made from.

    Attributes
    ----------
    path : pathlib.Path
        Where it is now.
    name : str
        Its name within the source, ``/``-separated: the same wherever the source lies.
    identifies : bool
        Whether its content makes the episode's id. A table beside a video does not: when it
        changes, the same episode gets a new revision.
    members : SourceMembers, optional
        The part of it that the episode is made from: nothing else of it is read or makes the id.
    """

    path: Path
    name: str
    identifies: bool = True
    members: SourceMembers | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class EpisodeSource:
    """One episode that a source holds: what `Converter.convert` needs, and nothing else does.

    The files' bytes and the other fields, all of which can be written as JSON, decide the
    episode's content; a change in any of them makes it be converted again.

    Attributes
    ----------
    key : str
        Names the episode within the source; the same on every machine.
    files : tuple of SourceFile
    task : Task
    licence : str
    annotations : Annotations, optional
    regime : {"demonstration", "play", "touch"}
    settings : dict
        Everything else that the converter needs, JSON values only.
    quality : tuple of QualityNote
        What is known to be odd before the files are read.
    splits : mapping of str to str
        Published splits: name of the split to the list that this episode is in.
    estimated_bytes : int, optional
        How big the episode will be, where that is not about the size of its files.
    parent_id : str, optional
        Of the episode that the source was written from.
    derived : tuple of str, optional
        Derived arrays without which the episode is not complete; default: the activity of all
        tactile streams.
    """

    key: str
    files: tuple[SourceFile, ...]
    task: Task
    licence: str
    annotations: Annotations | None = None
    regime: Literal["demonstration", "play", "touch"] = "touch"
    settings: dict[str, Any] = field(default_factory=dict)
    quality: tuple[QualityNote, ...] = ()
    splits: Mapping[str, str] = field(default_factory=dict)
    estimated_bytes: int | None = None
    parent_id: str | None = None
    derived: tuple[str, ...] | None = None


@dataclass(frozen=True, slots=True)
class NamedSplit:
    """A split that a source publishes; becomes ``splits/<name>.json``."""

    name: str
    level: Literal["episode", "object", "part"]
    method: str | None = None
    seed: int | None = None

    def document(self) -> SplitDocument:
        """Return its document, still without episodes."""
        given = {"method": self.method, "seed": self.seed}
        stated: dict[str, Any] = {k: value for k, value in given.items() if value is not None}
        return SplitDocument(name=self.name, level=self.level, lists={}, **stated)


@dataclass(frozen=True, slots=True, kw_only=True)
class Discovery:
    """What a source holds.

    Attributes
    ----------
    layout : str
        Which layout was recognised, and by what.
    items : tuple of EpisodeSource
        In a stable order.
    notices : tuple of str
        What the user should know: files that were not read, labels that match nothing ...
    failed : tuple of Failure
        Episodes that are there and cannot be converted, as the search already shows.
    splits : tuple of NamedSplit
    """

    layout: str
    items: tuple[EpisodeSource, ...]
    notices: tuple[str, ...] = ()
    failed: tuple[Failure, ...] = ()
    splits: tuple[NamedSplit, ...] = ()


class Converter(Protocol):
    """Reads one format. Third parties add theirs under the entry point ``exumi.converters``."""

    name: str
    """What the user writes after ``--from``."""
    version: str
    """Of what it writes: raise it when the same source gives another episode than before."""
    id_version: int
    """Of how it identifies episodes: raise it, and every episode gets a new id."""
    describes: str
    """One line for the user."""
    keeps: tuple[str, ...]
    """What of the source is in the episodes."""
    loses: tuple[str, ...]
    """What is not."""
    options: type[FormatOptions]
    """The format's own options."""

    def recognise(self, source: Path) -> str | None:
        """Say by what a source is recognised as this format; None if it is not.

        Looks at names and headers of few files, and never raises because of what they hold.

        Parameters
        ----------
        source : pathlib.Path
            An existing file or folder.
        """
        ...

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find the episodes of a source. Reads names, headers and tables, no frames.

        Parameters
        ----------
        source : pathlib.Path
        options : ConvertOptions

        Raises
        ------
        UsageError, SourceError
            The source or an option makes no sense as a whole. Nothing has been written.
        """
        ...

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write the streams of one episode, and add to ``writer.metadata`` what only the data tell.

        The caller has set id, task, annotations, source and licence, and finishes the episode.

        Parameters
        ----------
        item : EpisodeSource
            As `discover` returned it, possibly in another process.
        writer : EpisodeWriter

        Returns
        -------
        int
            Frames written.

        Raises
        ------
        SourceError
            The files cannot be read. The episode does not appear.
        """
        ...
