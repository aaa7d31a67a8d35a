"""Files of other formats become the episodes of a dataset."""

import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path

from exumi_converters.converter import Converter, ConvertOptions, Discovery, EpisodeSource
from exumi_converters.destination import write_splits
from exumi_converters.detection import detect_format, unreadable
from exumi_converters.format_options import parse_options
from exumi_converters.identity import (
    digest_inputs,
    episode_id,
    settings_digest,
    source_digest,
)
from exumi_converters.registry import converters, find_converter
from exumi_converters.report import ConversionPlan, ConversionReport, Progress
from exumi_converters.run import Done, Run, attempt, make_episode, opened_run
from exumi_data import __version__
from exumi_data.engine import Engine, warm_up
from exumi_data.errors import UsageError
from exumi_data.model import DatasetMetadata, EpisodeMetadata, MadeBy, Source
from exumi_data.model.base import STREAM_NAME
from exumi_data.model.documents import dump
from exumi_data.time import parse_rate

__all__ = ["TOOL", "convert", "plan_conversion"]

TOOL = "exumi-data"


def convert(
    source: str | Path,
    destination: str | Path,
    *,
    from_format: str | None = None,
    options: ConvertOptions | None = None,
    engine: Engine | None = None,
    on_progress: Callable[[Progress], None] | None = None,
) -> ConversionReport:
    """Convert a source into a dataset of episodes.

    An episode's id is made from its source, so a second run skips what is complete and makes again
    what is not, or what a changed file, label or option would make otherwise.

    Parameters
    ----------
    source : path-like
        File or folder, as the format wants it.
    destination : path-like
        The dataset: a new or empty folder, or one that an earlier run has made.
    from_format : str, optional
        One of `FORMATS`, or of another package. Default: the one that recognises the source.
    options : ConvertOptions, optional
    engine : Engine, optional
        Where the episodes are worked on; default processes of this machine.
    on_progress : callable, optional
        Called after each episode.

    Returns
    -------
    ConversionReport
        Failures are in it: everything else is converted nevertheless.

    Raises
    ------
    UsageError, SourceError
        An option, the source or the destination makes no sense as a whole. Nothing was converted.
    """
    began = time.perf_counter()
    options = options or ConvertOptions()
    warm_up(__name__, workers=options.workers, engine=engine)
    source, destination = Path(source), Path(destination)
    converter, notices = _converter(source, from_format)
    discovery = _discover(converter, source, options)
    metadata = DatasetMetadata(
        name=destination.resolve().name,
        licence=options.licence,
        made_by=MadeBy(
            tool=TOOL,
            tool_version=__version__,
            settings={"converter": _versioned(converter), "layout": discovery.layout},
        ),
    )
    with opened_run(
        destination, metadata, options.workers, on_progress, began, engine=engine
    ) as run:
        run.failed += discovery.failed
        function = partial(
            _convert_one, root=run.root, from_format=converter.name, durable=options.durable
        )
        run.work(function, discovery.items, _key)
        _write_splits(run, discovery)
        unexplained = run.finish()
        return ConversionReport(
            source=str(source),
            destination=str(destination),
            total=run.converted + run.skipped + len(run.failed),
            converted=run.converted,
            skipped=run.skipped,
            flagged=tuple(run.flagged),
            failed=tuple(run.failed),
            notices=(*notices, *discovery.notices, *run.notices),
            unexplained=unexplained,
            frames=run.frames,
            seconds=run.seconds,
            converter=_versioned(converter),
            layout=discovery.layout,
        )


def plan_conversion(
    source: str | Path,
    *,
    from_format: str | None = None,
    options: ConvertOptions | None = None,
) -> ConversionPlan:
    """Find out what a conversion would write, and what would be lost. Writes nothing.

    Parameters
    ----------
    source : path-like
    from_format : str, optional
        Default: the one that recognises the source.
    options : ConvertOptions, optional

    Returns
    -------
    ConversionPlan

    Raises
    ------
    UsageError, SourceError
        An option or the source makes no sense as a whole.
    """
    source = Path(source)
    converter, notices = _converter(source, from_format)
    discovery = _discover(converter, source, options or ConvertOptions())
    return ConversionPlan(
        source=str(source),
        converter=_versioned(converter),
        layout=discovery.layout,
        episodes=tuple(item.key for item in discovery.items),
        failed=discovery.failed,
        keeps=converter.keeps,
        loses=converter.loses,
        notices=(*notices, *discovery.notices),
        estimated_bytes=sum(map(_estimated_bytes, discovery.items)),
    )


def _estimated_bytes(item: EpisodeSource) -> int:
    if item.estimated_bytes is not None:
        return item.estimated_bytes
    return sum(map(_size_of, {file.path for file in item.files}))


def _size_of(path: Path) -> int:
    try:
        if path.is_dir():
            return sum(file.stat().st_size for file in path.iterdir() if file.is_file())
        return path.stat().st_size
    except OSError:
        return 0  # converting says what is the matter with it


def _converter(source: Path, name: str | None) -> tuple[Converter, list[str]]:
    """Return the converter that the user named, or the one that recognises the source."""
    known = converters()
    if name is None:
        name, reason = detect_format(source, known)
        return known[name], [f"read as {name} ({reason})"]
    if name not in known:
        raise UsageError(f"Invalid format ({name}). Supported values are {', '.join(known)}")
    return known[name], []


def _discover(converter: Converter, source: Path, options: ConvertOptions) -> Discovery:
    _check_options(options)
    parse_options(converter.options, options.settings, converter.name)
    try:
        discovery = converter.discover(source, options)
    except OSError as error:
        raise unreadable(source, error) from None
    _check_keys(discovery, source)
    return discovery


def _check_options(options: ConvertOptions) -> None:
    """Refuse an option that makes no sense before anything is written."""
    if options.rate is not None:
        try:
            parse_rate(options.rate)
        except ValueError as error:
            raise UsageError(f"Invalid rate ({options.rate}): {error}") from None
    if not re.fullmatch(STREAM_NAME, options.stream):
        raise UsageError(
            f"Invalid stream name ({options.stream})",
            fix="Use lower-case letters, digits and _, beginning with a letter.",
        )


def _key(item: EpisodeSource) -> str:
    return item.key


def _versioned(converter: Converter) -> str:
    return f"{converter.name}/{converter.version}"


def _check_keys(discovery: Discovery, source: Path) -> None:
    keys = [item.key for item in discovery.items]
    if len(keys) != len(set(keys)):
        twice = next(key for key in keys if keys.count(key) > 1)
        raise UsageError(f"two episodes have the key {twice!r}", where=source)


def _write_splits(run: Run[EpisodeSource], discovery: Discovery) -> None:
    lists: dict[str, dict[str, list[str]]] = {}
    for item in discovery.items:
        for split, name in item.splits.items():
            if item.key in run.ids:
                lists.setdefault(split, {}).setdefault(name, []).append(run.ids[item.key])
    write_splits(run.root, [split.document() for split in discovery.splits], lists)


def _convert_one(item: EpisodeSource, *, root: Path, from_format: str, durable: bool) -> Done:
    """Convert one episode; runs in a worker."""
    converter = find_converter(from_format)

    def make(metadata: EpisodeMetadata) -> Done:
        return make_episode(
            root,
            item.key,
            metadata,
            lambda writer: converter.convert(item, writer),
            durable=durable,
            derived=item.derived,
        )

    return attempt(item.key, lambda: _metadata(item, converter), make)


def _metadata(item: EpisodeSource, converter: Converter) -> EpisodeMetadata:
    inputs = digest_inputs(item.files)
    scheme = f"{converter.name}/{converter.id_version}"
    shaping = {
        "converter": _versioned(converter),
        "task": dump(item.task),
        "licence": item.licence,
        "regime": item.regime,
        "annotations": None if item.annotations is None else dump(item.annotations),
        "quality": [dump(note) for note in item.quality],
        "settings": item.settings,
    }
    metadata = EpisodeMetadata(
        id=episode_id(scheme, source_digest(item.files, inputs), item.key),
        start=None,
        task=item.task,
        regime=item.regime,
        annotations=item.annotations,
        licence=item.licence,
        quality=list(item.quality),
        source=Source(
            type="converted",
            tool=TOOL,
            tool_version=__version__,
            converter=_versioned(converter),
            key=item.key,
            inputs=inputs,
            settings=item.settings,
            settings_sha256=settings_digest(shaping),
        ),
    )
    if item.parent_id is not None:
        metadata.source.parent_id = item.parent_id
    return metadata
