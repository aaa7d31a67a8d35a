"""The contracts of converters and exporters, for other packages to run on their own.

They need no pytest. Whoever runs them brings a source, or a dataset, of at least two episodes.
"""

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

from exumi_converters.conversion import convert, plan_conversion
from exumi_converters.converter import Converter, ConvertOptions
from exumi_converters.exporter import Exporter, ExportOptions
from exumi_converters.exporting import EXPORT_DOCUMENT, export, plan_export
from exumi_converters.facets import FACETS, differences
from exumi_converters.registry import converters, exporters
from exumi_data.dataset import Dataset, open_dataset
from exumi_data.errors import ExumiError

__all__ = ["check_converter", "check_exporter", "check_round_trip", "round_trip_differences"]

_SINGLE = 1
_DOUBLE = 2


def check_converter(
    converter: Converter,
    source: str | Path,
    folder: str | Path,
    options: ConvertOptions | None = None,
) -> None:
    """Check that a converter keeps the contract.

    It is registered, describes itself, recognises its source and nothing in an empty folder, plans
    what it writes, writes the same episodes with any number of workers, skips them when run again,
    and makes episodes that are complete.

    Parameters
    ----------
    converter : Converter
    source : path-like
        Holds at least two episodes.
    folder : path-like
        For what is written; made if it is not there.
    options : ConvertOptions, optional

    Raises
    ------
    AssertionError
        With all that is wrong.
    """
    root = _folder(folder)
    found = list(_mistakes_of_description(converter, converters(), "converters"))
    found += _mistakes_of_recognition(converter, Path(source), root)
    options = options or ConvertOptions(durable=False)
    plan = plan_conversion(source, from_format=converter.name, options=options)
    if len(plan.episodes) < _DOUBLE:
        found.append("the source holds fewer than two episodes: bring more")
    _raise(found)
    made = []
    for name, workers in (("first", _SINGLE), ("second", _DOUBLE)):
        told = replace(options, workers=workers)
        report = convert(source, root / name, from_format=converter.name, options=told)
        found += [f"failed: {item.name}: {item.reason}" for item in report.failed]
        if report.converted != len(plan.episodes) - len(plan.failed):
            found.append(f"{report.converted} episodes were written, {len(plan.episodes)} planned")
        made.append(open_dataset(root / name))
    found += _mistakes_of_datasets(*made)
    again = convert(source, root / "first", from_format=converter.name, options=options)
    if again.converted:
        found.append(f"run again, it writes {again.converted} episodes that were complete")
    _raise(found)


def check_exporter(
    exporter: Exporter,
    dataset: str | Path,
    folder: str | Path,
    options: ExportOptions | None = None,
    *,
    name: str = "first",
) -> None:
    """Check that an exporter keeps the contract.

    It is registered, describes itself in facets, plans without writing, announces only losses that
    it lists, writes the same bytes with any number of workers, and leaves alone what is complete.

    Parameters
    ----------
    exporter : Exporter
    dataset : path-like
        At least two episodes.
    folder : path-like
        For what is written; made if it is not there.
    options : ExportOptions, optional
    name : str
        Of the first result: some formats go by its ending.

    Raises
    ------
    AssertionError
        With all that is wrong.
    """
    root = _folder(folder)
    found = list(_mistakes_of_description(exporter, exporters(), "exporters"))
    unknown = sorted(set(exporter.loses) - set(FACETS))
    found += [f"it loses {facet!r}, which is no facet" for facet in unknown]
    options = options or ExportOptions(durable=False)
    before = _tree(root)
    plan = plan_export(dataset, root / name, to_format=exporter.name, options=options)
    if _tree(root) != before:
        found.append("planning writes files")
    found += [
        f"it announces the loss of {loss.facet!r}, and does not list it"
        for loss in plan.losses
        if loss.facet not in exporter.loses
    ]
    if len(plan.items) < _DOUBLE:
        found.append("fewer than two episodes can be written: bring others")
    try:
        json.dumps([plan.shared, [item.settings for item in plan.items]], allow_nan=False)
    except (TypeError, ValueError) as error:
        found.append(f"the plan holds what is no JSON value: {error}")
    _raise(found)
    second = f"second-{name}"
    for target, workers in ((name, _SINGLE), (second, _DOUBLE)):
        told = replace(options, workers=workers)
        report = export(dataset, root / target, to_format=exporter.name, options=told)
        found += [f"failed: {item.name}: {item.reason}" for item in report.failed]
    _raise(found)
    if _contents(root / name) != _contents(root / second):
        found.append("one worker and two write different bytes")
    if (root / name).is_dir():
        if not (root / name / EXPORT_DOCUMENT).is_file():
            found.append(f"it removes {EXPORT_DOCUMENT}")
        again = export(dataset, root / name, to_format=exporter.name, options=options)
        if again.written:
            found.append("run again, it writes what was complete")
    _raise(found)


def check_round_trip(
    exporter: Exporter,
    converter: Converter,
    dataset: str | Path,
    folder: str | Path,
    *,
    name: str = "out",
    export_options: ExportOptions | None = None,
    convert_options: ConvertOptions | None = None,
) -> None:
    """Check that what a round trip loses is what the exporter lists, and nothing else.

    Parameters
    ----------
    exporter : Exporter
    converter : Converter
        Reads what the exporter writes.
    dataset : path-like
    folder : path-like
        For what is written; made if it is not there.
    name : str
        Of the result: some formats go by its ending.
    export_options : ExportOptions, optional
    convert_options : ConvertOptions, optional

    Raises
    ------
    AssertionError
        With the facets that were lost and are not listed.
    """
    lost = round_trip_differences(
        exporter,
        converter,
        dataset,
        folder,
        name=name,
        export_options=export_options,
        convert_options=convert_options,
    )
    unlisted = sorted(lost - set(exporter.loses))
    _raise([f"{facet} is lost and not listed ({FACETS[facet]})" for facet in unlisted])


def round_trip_differences(
    exporter: Exporter,
    converter: Converter,
    dataset: str | Path,
    folder: str | Path,
    *,
    name: str = "out",
    export_options: ExportOptions | None = None,
    convert_options: ConvertOptions | None = None,
) -> frozenset[str]:
    """Export a dataset, convert the result, and find the facets that differ.

    Episodes are paired by their ids, where the keys of the converted ones name them; else the keys
    are taken to be in the dataset's order.

    Parameters
    ----------
    exporter : Exporter
    converter : Converter
    dataset : path-like
    folder : path-like
    name : str
    export_options : ExportOptions, optional
    convert_options : ConvertOptions, optional

    Returns
    -------
    frozenset of str
        Keys of `FACETS`.
    """
    root = _folder(folder)
    told = export_options or ExportOptions(durable=False)
    written = export(dataset, root / name, to_format=exporter.name, options=told)
    _raise([f"failed: {item.name}: {item.reason}" for item in written.failed])
    report = convert(
        root / name,
        root / "back",
        from_format=converter.name,
        options=convert_options or ConvertOptions(durable=False),
    )
    _raise([f"failed: {item.name}: {item.reason}" for item in report.failed])
    before, after = open_dataset(dataset), open_dataset(root / "back")
    if len(before) != len(after):
        _raise([f"{len(before)} episodes became {len(after)}"])
    lost: set[str] = set()
    for one, other in _pairs(before, after):
        lost |= differences(before[one], after[other])
    return frozenset(lost)


def _pairs(before: Dataset, after: Dataset) -> Iterator[tuple[str, str]]:
    """Pair episodes with what became of them: by ids in the keys, else by the keys' order."""
    keys = {episode.id: str(episode.metadata.source.key) for episode in after}
    ordered = sorted(after.ids, key=keys.__getitem__)
    for index, name in enumerate(before.ids):
        named = [other for other in ordered if name in keys[other]]
        yield name, named[0] if named else ordered[index]


def _folder(path: str | Path) -> Path:
    root = Path(path)
    root.mkdir(parents=True, exist_ok=True)
    return root


def _raise(found: list[str]) -> None:
    if found:
        raise AssertionError("\n".join(found))


def _mistakes_of_description(
    described: Converter | Exporter, known: object, group: str
) -> Iterator[str]:
    assert isinstance(known, dict)  # noqa: S101  # by name
    if known.get(described.name) is not described:
        yield f"no installed package registers {described.name!r} under exumi.{group}"
    for attribute in ("describes", "version"):
        if not getattr(described, attribute):
            yield f"{attribute} is empty"
    for name, field in described.options.model_fields.items():
        if not field.description:
            yield f"the option {name!r} has no description"
        if field.is_required():
            yield f"the option {name!r} has no default"


def _mistakes_of_recognition(converter: Converter, source: Path, root: Path) -> Iterator[str]:
    if not converter.recognise(source):
        yield "it does not recognise the source"
    empty = root / "empty"
    empty.mkdir(exist_ok=True)
    file = root / "empty.bin"
    file.write_bytes(b"")
    for nothing in (empty, file):
        try:
            if converter.recognise(nothing):
                yield f"it recognises an {'empty folder' if nothing.is_dir() else 'empty file'}"
        except Exception as error:  # noqa: BLE001  # whatever it raises is the finding
            yield f"recognise raises {type(error).__name__} on nothing: {error}"
    try:
        converter.discover(empty, ConvertOptions())
        yield "it finds episodes in an empty folder, or says nothing"
    except ExumiError:
        pass
    finally:
        empty.rmdir()
        file.unlink()


def _mistakes_of_datasets(first: Dataset, second: Dataset) -> Iterator[str]:
    if first.fingerprint != second.fingerprint:
        yield "one worker and two write different episodes"
    for episode in first:
        try:
            episode.check_complete()
        except ExumiError as error:
            yield f"an episode is not complete: {error}"
        if not episode.streams:
            yield f"episode {episode.id} has no stream"


def _tree(root: Path) -> set[Path]:
    return set(root.rglob("*"))


def _contents(path: Path) -> dict[str, bytes]:
    if path.is_file():
        return {"": path.read_bytes()}
    return {
        file.relative_to(path).as_posix(): file.read_bytes()
        for file in path.rglob("*")
        if file.is_file() and file.name != EXPORT_DOCUMENT
    }
