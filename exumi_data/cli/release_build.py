"""``exumi release SRC DST``."""

import sys
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exumi_data.cli.dataset_options import DryRunOption
from exumi_data.cli.options import (
    Format,
    FormatOption,
    QuietOption,
    WorkersOption,
    epilog,
    given_path,
)

if TYPE_CHECKING:
    from exumi_data.model.dataset import Release
    from exumi_data.release.building import Built
    from exumi_data.release.judging import Judgement
    from exumi_data.release.planning import Plan, SplitWish
    from exumi_data.release.pushing import Pushed

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi release my-dataset my-release --licence CC-BY-4.0 --licence-file CC-BY-4.0.txt",
    "exumi release my-dataset my-release-2 --previous my-release --dry-run",
    "exumi release my-dataset my-release --split object --lists train=8,val=1,test=1",
    'exumi release my-dataset my-release --author "A. Lovelace" --author "C. Babbage" '
    "--published 2026-03-01",
    "exumi release my-dataset my-release --keep operator --remove gps,serial,path",
    "exumi release my-dataset my-release --push our-lab/my-dataset",
)
_LISTS = "train=15,val=1"


class By(StrEnum):
    """What a split keeps together."""

    EPISODE = "episode"
    OBJECT = "object"
    PART = "part"


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    source: Annotated[
        Path, typer.Argument(parser=given_path, metavar="SRC", help="The dataset. It stays.")
    ],
    target: Annotated[
        Path, typer.Argument(parser=given_path, metavar="DST", help="The folder of the release.")
    ],
    licence: Annotated[
        str | None,
        typer.Option(
            metavar="SPDX",
            help="Of the data, such as CC-BY-4.0. Default: what dataset.json says.",
        ),
    ] = None,
    licence_file: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="The text of the licence. Default: the file LICENSE of the dataset.",
        ),
    ] = None,
    version: Annotated[
        str,
        typer.Option(
            metavar="X.Y.Z|auto",
            help="Of the release; auto: what the changes since --previous call for.",
        ),
    ] = "auto",
    previous: Annotated[
        Path | None,
        typer.Option(parser=given_path, metavar="OLD", help="The release before this one."),
    ] = None,
    split: Annotated[
        By | None,
        typer.Option(
            help="Make a split, in which all episodes of an object or part stay together."
        ),
    ] = None,
    lists: Annotated[
        str, typer.Option(metavar="NAME=SHARE,...", help="The lists of --split.")
    ] = _LISTS,
    seed: Annotated[int, typer.Option(min=0, help="Of --split.")] = 0,
    preview_mb: Annotated[
        float, typer.Option(min=0, help="Megabytes of the preview, at most; 0 for none.")
    ] = 50.0,
    published: Annotated[
        str | None,
        typer.Option(metavar="YYYY-MM-DD", help="The day; for citations. Never the clock's."),
    ] = None,
    author: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="Whom to cite. Can be given more than once. Default: what dataset.json says.",
        ),
    ] = None,
    description: Annotated[
        str | None,
        typer.Option(
            metavar="TEXT", help="What the data are, in Markdown. Default: what dataset.json says."
        ),
    ] = None,
    citation_file: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="How to cite it, in BibTeX or as a text. Default: what dataset.json says.",
        ),
    ] = None,
    url: Annotated[
        str | None, typer.Option(metavar="URL", help="Where the release can be had.")
    ] = None,
    keep: Annotated[
        str,
        typer.Option(
            metavar="KIND,...",
            help="What may be private and is released as it is: operator, site, serial, host, "
            "user, path, email, gps. Each kind that is found has to be kept or removed.",
        ),
    ] = "",
    remove: Annotated[
        str,
        typer.Option(
            metavar="KIND,...", help="Kinds that are taken out of the release; the source stays."
        ),
    ] = "",
    pseudonym_key: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="FILE",
            help="A secret of 16 bytes or more: removed names become pseudonyms, the same ones in "
            "each release.",
        ),
    ] = None,
    push: Annotated[
        str | None,
        typer.Option(metavar="REPO", help="Then publish it: see exumi release push."),
    ] = None,
    public: Annotated[
        bool, typer.Option("--public", help="With --push: a new repository is seen by everybody.")
    ] = False,
    dry_run: DryRunOption = False,
    workers: WorkersOption = None,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Make a release of a dataset: validated, packed, with its licence, changes and checksums.

    The release appears under its name when it is complete. Started again after it was stopped, it
    goes on. The same dataset always gives the same bytes. Exit code 1: the data are not valid; 2:
    something else forbids it. All reasons are listed at once.
    """
    from exumi_data.cli.output import print_json, progress_of
    from exumi_data.cli.release_judge import judge_with
    from exumi_data.cli.release_push import push as publish
    from exumi_data.cli.release_push import tell_pushed
    from exumi_data.release.building import build_release
    from exumi_data.release.planning import Wishes, plan_release
    from exumi_data.release.pushing import check_repository

    if push is not None:
        check_repository(push)  # before hours of packing
    wishes = Wishes(
        licence=licence if licence is not None else _asked(source),
        licence_file=licence_file,
        version=version,
        previous=previous,
        split=_wish(split, lists, seed),
        preview_bytes=round(min(preview_mb, 1e9) * 1e6),
        published=published,
        authors=tuple(author or ()),
        description=description,
        citation=None if citation_file is None else _text(citation_file),
        url=url,
        keep=_kinds(keep),
        remove=_kinds(remove),
        pseudonym_key=None if pseudonym_key is None else _key(pseudonym_key),
    )
    with progress_of("Validating", quiet=quiet) as update:
        judge = judge_with(workers, lambda done, total: update(done, total, ""))
        plan = plan_release(source, target, wishes, judge, workers=workers)
    if not quiet or plan.judgement.errors:
        _tell_judgement(plan.judgement)
    if plan.problems or plan.judgement.errors:
        _refuse(plan, output)
    built = None
    if not dry_run:
        with progress_of("Packing", quiet=quiet) as update:
            built = build_release(
                plan,
                judge_with(workers),
                workers=workers,
                on_progress=lambda done, total: update(done, total, ""),
            )
    if output is Format.TEXT:
        _tell(plan, built, quiet=quiet)
    pushed = None
    if push is not None and built is not None:
        pushed = publish(target, push, public=public, workers=workers, quiet=quiet)
        if output is Format.TEXT:
            tell_pushed(pushed, quiet=quiet)
    if output is Format.JSON:
        print_json(_document(plan, built, pushed))


def _asked(source: Path) -> str | None:
    """Return the licence that a person at a terminal types, where the dataset does not say it."""
    from exumi_data.dataset import open_dataset
    from exumi_data.errors import ExumiError
    from exumi_data.release.licence import canonical_licence

    if not (sys.stdin.isatty() and sys.stderr.isatty()):
        return None
    try:
        canonical_licence(open_dataset(source).metadata.licence)
    except ExumiError:
        return str(
            typer.prompt("Licence of the data (SPDX expression, such as CC-BY-4.0)", err=True)
        )
    return None


def _kinds(text: str) -> tuple[str, ...]:
    return tuple(filter(None, (part.strip() for part in text.split(","))))


def _key(path: Path) -> bytes:
    from exumi_data.store.plain_files import read_plain

    return read_plain(path, 1 << 16).strip()


def _text(path: Path) -> str:
    from exumi_data.errors import UsageError
    from exumi_data.store.plain_files import read_plain

    try:
        return read_plain(path, 1 << 16).decode().strip()
    except UnicodeDecodeError:
        raise UsageError("is no text in UTF-8", where=path) from None


def _wish(split: By | None, lists: str, seed: int) -> "SplitWish | None":
    from exumi_data.cli.dataset_split import shares_of
    from exumi_data.errors import UsageError
    from exumi_data.release.planning import SplitWish

    if split is not None:
        return SplitWish(split.value, shares_of(lists), seed)
    if lists != _LISTS or seed:
        raise UsageError("--lists and --seed belong to --split", fix="Add --split episode.")
    return None


def _tell_judgement(judgement: "Judgement") -> None:
    """Show what the validator found, where it found something."""
    from exumi_data.cli.output import error_console, printable

    if judgement.errors or judgement.warnings:
        text = judgement.report.to_text(verbose=False)
        error_console().print(printable(text, lines=True), end="", markup=False)


def _refuse(plan: "Plan", output: Format) -> None:
    """Tell everything that forbids the release, and end.

    Raises
    ------
    typer.Exit
        Always.
    """
    from exumi_data.cli.failures import COULD_NOT_RUN, FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json, printable

    invalid = bool(plan.judgement.errors)
    problems = list(plan.problems)
    if invalid:
        problems.insert(0, "the data are not valid: the errors are listed above")
    if output is Format.JSON:
        print_json(
            {
                "release": str(plan.target),
                "released": False,
                "problems": list(plan.problems),
                "private": _private(plan),
                "errors": list(plan.judgement.errors),
                "warnings": list(plan.judgement.warnings),
            }
        )
    console = error_console()
    console.print("[bold red]error:[/] nothing was released:")
    for problem in problems:
        console.print(printable(f"  {problem}", lines=True), markup=False)
    raise typer.Exit(FOUND_WRONG if invalid else COULD_NOT_RUN)


def _document(plan: "Plan", built: "Built | None", pushed: "Pushed | None") -> dict[str, Any]:
    from dataclasses import asdict

    release, changes = _release_of(plan), built.changes if built else plan.changes
    return {
        "release": str(plan.target),
        "released": built is not None,
        "name": plan.metadata.name,
        "version": release.version,
        "previous": release.previous,
        "licence": plan.metadata.licence,
        "episodes": len(plan.chosen),
        "bytes": _bytes_of(plan, built),
        "files": built.files if built else None,
        "fingerprint": built.fingerprint if built else None,
        "splits": {name: _counts(one.lists) for name, one in plan.splits.items()},
        "preview": list(built.preview if built else plan.preview),
        "preview_bytes": built.preview_bytes if built else None,
        "changes": changes.to_json() if changes else None,
        "private": _private(plan),
        "warnings": list(plan.judgement.warnings),
        "notices": list(plan.notices),
        "pushed": asdict(pushed) if pushed else None,
    }


def _private(plan: "Plan") -> list[dict[str, Any]]:
    """Return what may be private: kind, how often, and whether it is taken out."""
    taken = plan.removal.kinds if plan.removal else frozenset()
    found: dict[str, int] = {}
    for one in plan.private:
        found[one.kind] = found.get(one.kind, 0) + 1
    return [
        {"kind": kind, "places": count, "removed": kind in taken}
        for kind, count in sorted(found.items())
    ]


def _tell(plan: "Plan", built: "Built | None", *, quiet: bool) -> None:
    from exumi_data.cli.output import printable, size_text
    from exumi_data.release.changelog import change_lines

    release, changes = _release_of(plan), built.changes if built else plan.changes
    preview = built.preview if built else plan.preview
    lines = [
        f"{plan.target}: {plan.metadata.name} {release.version}, {len(plan.chosen):,} episodes, "
        f"{size_text(_bytes_of(plan, built))}, {plan.metadata.licence}, "
        f"{'written' if built else 'would be written'}"
    ]
    for name, one in plan.splits.items():
        counts = ", ".join(f"{part} {count}" for part, count in _counts(one.lists).items())
        lines.append(f"  split {name}: {counts}")
    for found in _private(plan):
        what = "taken out" if found["removed"] else "kept"
        lines.append(f"  {found['kind']}: {what}, in {found['places']:,} place(s)")
    if preview:
        lines.append(f"  preview: {len(preview)} episodes")
    if changes is not None:
        lines.append(f"  since {release.previous}:")
        lines += [f"    {line}" for line in change_lines(changes)] or ["    nothing changed"]
    if built is not None:
        lines.append(f"  fingerprint (sha-256 of the manifest): {built.fingerprint}")
    lines += [] if quiet else [f"  note: {notice}" for notice in plan.notices]
    for line in lines:
        print(printable(line))


def _release_of(plan: "Plan") -> "Release":
    release = plan.metadata.release
    assert release is not None  # noqa: S101  # a plan without problems has one
    return release


def _bytes_of(plan: "Plan", built: "Built | None") -> int:
    return built.bytes if built else sum(int(one.row["bytes"]) for one in plan.chosen)


def _counts(lists: "dict[str, list[str]]") -> dict[str, int]:
    return {part: len(ids) for part, ids in lists.items()}
