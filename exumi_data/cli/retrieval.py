"""``exumi index build | query | teach | forget | info | eval``."""

from collections.abc import Sequence
from dataclasses import asdict
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.engines import EngineName, EngineOption, RayAddressOption
from exumi_data.cli.options import Format, FormatOption, QuietOption, WorkersOption, epilog

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset
    from exumi_loaders import DamagedClip, Embedding, Encoder, Score, TactileIndex

__all__ = [
    "BUILD_EPILOG",
    "EVAL_EPILOG",
    "FORGET_EPILOG",
    "INFO_EPILOG",
    "QUERY_EPILOG",
    "TEACH_EPILOG",
    "build",
    "evaluate",
    "forget",
    "info",
    "query",
    "teach",
]

BUILD_EPILOG = epilog(
    "exumi index build my-dataset my-index",
    "exumi index build my-dataset my-index --split octopi15/train",
    "exumi index build my-dataset my-index --model tower.pt",
)
QUERY_EPILOG = epilog(
    "exumi index query my-index my-dataset --episode 0",
    "exumi index query my-index my-dataset --part egg --ranking matches",
)
TEACH_EPILOG = epilog(
    'exumi index teach my-index my-dataset --part egg --name "an egg" --adjective smooth',
    'exumi index teach my-index my-dataset --episode 4 --name "an egg" --by model',
)
FORGET_EPILOG = epilog('exumi index forget my-index "an egg"')
INFO_EPILOG = epilog("exumi index info my-index", "exumi index info my-index --verify")
EVAL_EPILOG = epilog(
    "exumi index eval my-index my-dataset --split by-trial/test",
    "exumi index eval my-index my-dataset --leave-one-out",
)


class _Ranking(StrEnum):
    SIMILARITY = "similarity"
    MATCHES = "matches"


class _Unique(StrEnum):
    OBJECT = "object"
    PART = "part"
    CLIP = "clip"


class _Who(StrEnum):
    HUMAN = "human"
    MODEL = "model"


_Index = Annotated[Path, typer.Argument(metavar="INDEX", help="The folder of an index.")]
_Data = Annotated[
    str, typer.Argument(metavar="DATASET", help="A dataset with touch clips, or its URL.")
]
_Split = Annotated[
    str | None,
    typer.Option(metavar="NAME/LIST", help="Only this list of a split of the dataset."),
]
_Model = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE",
        help="A vision model as the encoder: a TorchScript file that you trust. Default: the "
        "built-in encoder, which needs no weights.",
    ),
]
_Stream = Annotated[str | None, typer.Option(help="Tactile stream. Default: all.")]
_Episodes = Annotated[
    list[str] | None,
    typer.Option("--episode", metavar="ID", help="Id or number of an episode; can be repeated."),
]
_Parts = Annotated[
    list[str] | None,
    typer.Option("--part", metavar="ID", help="All clips of a part; can be repeated."),
]
_KeepGoing = Annotated[
    bool,
    typer.Option("--keep-going", help="Exit with 0 although some clips are damaged."),
]


def build(  # noqa: PLR0913, PLR0917  # options of the command line
    dataset: _Data,
    path: Annotated[Path, typer.Argument(metavar="INDEX", help="A new folder.")],
    split: _Split = None,
    stream: _Stream = None,
    frames: Annotated[int, typer.Option(min=1, help="Salient frames a clip.")] = 10,
    model: _Model = None,
    keep_going: _KeepGoing = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Build an index of the touch clips of a dataset.

    The folder appears when the index is complete. It says which episodes, which split and which
    encoder it was made of. Damaged clips are left out, counted and named; exit code 1 then.
    """
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.cli.output import progress_of
    from exumi_loaders import TactileIndex

    _keep_model_here(model, engine)
    encoder = _vision(model)
    damaged: list[DamagedClip] = []
    with (
        chosen_engine(engine, ray_address, workers=workers, reads=[dataset], quiet=quiet) as chosen,
        progress_of("Encoding", quiet=quiet) as update,
    ):
        index = TactileIndex.build(
            _dataset(dataset),
            encoder,
            path=path,
            split=split,
            stream=stream,
            frames=frames,
            # A model is not sent to other processes: it uses the cores itself.
            workers=workers if encoder is None else 1,
            engine=chosen,
            on_corrupt="skip",
            on_damaged=damaged.append,
            on_done=lambda done, total: update(done, total, ""),
        )
    _print_info(index, output, damaged_clips=[asdict(clip) for clip in damaged])
    _finish(damaged, keep_going=keep_going)


def query(  # noqa: PLR0913, PLR0917  # options of the command line
    path: _Index,
    dataset: _Data,
    episodes: _Episodes = None,
    parts: _Parts = None,
    stream: _Stream = None,
    k: Annotated[int, typer.Option("-k", min=1, help="How many to name.")] = 5,
    ranking: Annotated[
        _Ranking,
        typer.Option(help="By the most similar clip, or by how many of the nearest clips match."),
    ] = _Ranking.SIMILARITY,
    unique: Annotated[_Unique, typer.Option(help="What is named once.")] = _Unique.OBJECT,
    model: _Model = None,
    output: FormatOption = Format.TEXT,
    quiet: QuietOption = False,
) -> None:
    """Say what clips feel like: the most similar objects of the index, for each clip."""
    from exumi_data.cli.output import error_console, print_json, printable

    index = _open(path, model)
    results = []
    held = 0
    for name, embedding in _embedded(index, _dataset(dataset), episodes, parts, stream):
        matches = index.query(embedding, k=k, ranking=ranking.value, unique=unique.value)
        line = index.line(matches, ranking=ranking.value, unique=unique.value)
        inside = index.holds(embedding.origins)
        held += inside
        results.append(
            {
                "clip": name,
                "in_index": inside,
                "ranking": ranking.value,
                "line": line,
                "matches": [match.as_dict() for match in matches],
            }
        )
        if output is Format.TEXT:
            print(printable(f"{name}: {line}"))
    if output is Format.JSON:
        print_json(results)
    if held and not quiet:
        error_console().print(
            f"note: {held} of {len(results)} clips are in the index, and find themselves",
            style="dim",
            markup=False,
        )


def teach(  # noqa: PLR0913, PLR0917  # options of the command line
    path: _Index,
    dataset: _Data,
    name: Annotated[str, typer.Option(help="Of the object, such as 'an egg'.")],
    episodes: _Episodes = None,
    parts: _Parts = None,
    stream: _Stream = None,
    adjectives: Annotated[
        list[str] | None,
        typer.Option("--adjective", help="How it feels; can be repeated."),
    ] = None,
    labels: Annotated[
        list[str] | None,
        typer.Option("--label", metavar="NAME=0..10", help="Such as hardness=7; can be repeated."),
    ] = None,
    part_id: Annotated[str | None, typer.Option(help="Part id of what is taught.")] = None,
    by: Annotated[_Who, typer.Option(help="Who says so.")] = _Who.HUMAN,
    model: _Model = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Teach an object by one or some clips. Nothing is trained; `forget` undoes it."""
    from exumi_data.cli.output import print_json, printable

    index = _open(path, model)
    clips = [made for _, made in _embedded(index, _dataset(dataset), episodes, parts, stream)]
    entry = index.teach(
        clips,
        name=name,
        part_id=part_id,
        adjectives=adjectives or (),
        labels=_labels(labels or []),
        provenance=by.value,
    )
    if output is Format.JSON:
        print_json({"entry": entry.id, "name": entry.name, "clips": entry.clips})
    else:
        print(printable(f"{path}: taught {entry.name} by {entry.clips} clip(s) ({entry.id})"))


def forget(
    path: _Index,
    name: Annotated[str | None, typer.Argument(metavar="[NAME]", help="What was taught.")] = None,
    entry: Annotated[str | None, typer.Option(help="The id of one entry instead.")] = None,
    built: Annotated[
        bool, typer.Option("--built", help="Also what was built from a dataset.")
    ] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Forget what was taught."""
    from exumi_data.cli.output import print_json, printable
    from exumi_loaders import TactileIndex

    gone = TactileIndex.open(path).forget(name, entry=entry, built=built)
    if output is Format.JSON:
        print_json({"forgotten": [one.id for one in gone]})
    else:
        print(printable(f"{path}: forgot {len(gone)} of {gone[0].name}"))


def info(
    path: _Index,
    verify: Annotated[
        bool,
        typer.Option("--verify", help="Read all files and compare their checksums."),
    ] = False,
    output: FormatOption = Format.TEXT,
) -> None:
    """Say what an index holds, and what it was made from.

    With --verify, exit code 1 if a file is damaged; all of those are named.
    """
    from exumi_loaders import TactileIndex

    if verify:
        _verify(path, output)
    else:
        _print_info(TactileIndex.open(path), output)


def _verify(path: Path, output: Format) -> None:
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json, printable
    from exumi_loaders import TactileIndex, verify_index

    damaged = [{"where": error.where, "reason": error.what} for error in verify_index(path)]
    if not damaged:
        _print_info(TactileIndex.open(path), output, damaged_files=[])
        if output is Format.TEXT:
            print("  verified  every file is as it was written")
        return
    if output is Format.JSON:
        print_json({"path": str(path), "damaged_files": damaged})
    console = error_console()
    console.print(f"[bold red]error:[/] {len(damaged):,} file(s) are damaged:")
    for one in damaged:
        console.print(printable(f"  {one['where']}: {one['reason']}"), markup=False)
    raise typer.Exit(FOUND_WRONG)


def evaluate(  # noqa: PLR0913, PLR0917  # options of the command line
    path: _Index,
    dataset: _Data,
    split: _Split = None,
    stream: _Stream = None,
    leave_one_out: Annotated[
        bool,
        typer.Option(
            "--leave-one-out",
            help="Score each clip by an index of all the others, made in memory.",
        ),
    ] = False,
    model: _Model = None,
    keep_going: _KeepGoing = False,
    output: FormatOption = Format.TEXT,
    workers: WorkersOption = None,
    engine: EngineOption = EngineName.LOCAL,
    ray_address: RayAddressOption = None,
    quiet: QuietOption = False,
) -> None:
    """Score an index: how often the right part or object comes first, or among the first five.

    Queries that are in the index are refused: they would find themselves. Damaged clips are left
    out and named; exit code 1 then.
    """
    from exumi_data.cli.engines import chosen_engine
    from exumi_data.cli.output import progress_of
    from exumi_data.engine import default_workers
    from exumi_data.splits import split_ids
    from exumi_loaders import encode_clips
    from exumi_loaders import evaluate as score
    from exumi_loaders import leave_one_out as score_without

    _keep_model_here(model, engine)
    index = _open(path, model)
    data = _dataset(dataset)
    if split is not None:
        data = data.select(split_ids(data, split, by="part"))
    encoder = _encoder(index)
    with (
        chosen_engine(engine, ray_address, workers=workers, reads=[dataset], quiet=quiet) as chosen,
        progress_of("Encoding", quiet=quiet) as update,
    ):
        # On a cluster it is as many as it has; a model uses the cores itself.
        here = (workers or default_workers()) if chosen is None else workers
        clips = encode_clips(
            data,
            encoder,
            stream=stream,
            frames=index.document.frames,
            workers=here if model is None else 1,
            engine=chosen,
            on_corrupt="skip",
            on_done=lambda done, total: update(done, total, ""),
        )
    if leave_one_out:
        with progress_of("Scoring", quiet=quiet) as update:
            scores = score_without(
                clips, encoder, on_done=lambda done, total: update(done, total, "")
            )
    else:
        scores = score(index, clips)
    _print_scores(scores, output)
    _finish(clips.damaged, keep_going=keep_going)


def _dataset(path: str) -> "Dataset":
    import exumi_data
    from exumi_data.errors import UsageError

    opened = exumi_data.open(path)
    if not isinstance(opened, exumi_data.Dataset):
        raise UsageError("is one episode, not a dataset", where=path, fix="Name the dataset.")
    return opened


def _keep_model_here(model: Path | None, engine: EngineName) -> None:
    from exumi_data.errors import UsageError

    if model is not None and engine is not EngineName.LOCAL:
        raise UsageError(
            "--model is not sent to a cluster", fix="Leave --engine out: it uses all cores here."
        )


def _vision(model: Path | None) -> "Encoder | None":
    if model is None:
        return None
    from exumi_loaders import VisionEncoder

    return VisionEncoder(model)


def _open(path: Path, model: Path | None) -> "TactileIndex":
    from exumi_loaders import TactileIndex

    return TactileIndex.open(path, encoder=_vision(model))


def _encoder(index: "TactileIndex") -> "Encoder":
    from exumi_data.errors import UsageError

    if index.encoder is None:
        raise UsageError(
            f"the index was made with {index.document.encoder.name}",
            where=index.path,
            fix="Name its TorchScript file with --model.",
        )
    return index.encoder


def _embedded(
    index: "TactileIndex",
    data: "Dataset",
    episodes: list[str] | None,
    parts: list[str] | None,
    stream: str | None,
) -> "list[tuple[str, Embedding]]":
    """Encode the clips that were named; return each with what to call it."""
    from exumi_data.errors import UsageError
    from exumi_loaders import encode_clips

    if not episodes and not parts:
        raise UsageError("no clip was named", fix="Name clips with --episode or --part.")
    chosen = [_episode_id(data, one) for one in episodes or []]
    if parts:
        found = data.select(part_id=parts).ids
        if not found:
            raise UsageError(f"no episode of part {', '.join(parts)}", where=data.path)
        chosen += found
    clips = encode_clips(
        data.select(list(dict.fromkeys(chosen))),
        _encoder(index),
        stream=stream,
        frames=index.document.frames,
    )
    return [(entry.id, clips.embedding(number)) for number, entry in enumerate(clips.entries)]


def _episode_id(data: "Dataset", word: str) -> str:
    from exumi_data.errors import UsageError

    if not word.isdecimal():
        return word
    if int(word) >= len(data):
        raise UsageError(f"no episode number {word} of {len(data)}", where=data.path)
    return data.ids[int(word)]


def _labels(words: list[str]) -> dict[str, float]:
    from exumi_data.errors import UsageError

    labels: dict[str, float] = {}
    for word in words:
        name, _, value = word.partition("=")
        rating: float | None
        try:
            rating = float(value)
        except ValueError:
            rating = None
        if rating is None or not name:
            raise UsageError(f"--label {word!r} is not like hardness=7")
        if name in labels:
            raise UsageError(f"--label gives {name!r} twice")
        labels[name] = rating
    return labels


def _finish(damaged: "Sequence[DamagedClip]", *, keep_going: bool) -> None:
    """Name the clips that were left out; end with exit code 1 then, unless told to keep going."""
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, printable

    if not damaged:
        return
    console = error_console()
    console.print(f"[bold red]error:[/] {len(damaged):,} clip(s) are damaged and were left out:")
    for clip in damaged:
        console.print(printable(f"  {clip}"), markup=False)
    if not keep_going:
        raise typer.Exit(FOUND_WRONG)


def _print_info(index: "TactileIndex", output: Format, **more: object) -> None:
    """Print what an index is; as JSON with `more`."""
    from exumi_data.cli.output import print_json, printable

    about = index.info()
    if output is Format.JSON:
        print_json({**about.as_dict(), **more})
        return
    counts = (
        f"{about.path}: {about.entries:,} entries of {about.objects:,} objects, "
        f"{about.parts:,} parts; {about.taught:,} taught, {about.forgotten:,} forgotten"
    )
    made = "nothing that is stated"
    if about.dataset is not None:
        made = f"{about.dataset} ({about.split or 'all of it'}), digest {about.dataset_digest}"
        if about.damaged:
            made += f"; {about.damaged:,} damaged clips left out"
    compared = f"{about.dimension} dimensions, {about.space or 'as the encoder gives them'}"
    for line in (
        counts,
        f"  made of   {made}",
        f"  encoder   {about.encoder_digest}, {about.frames} frames a clip",
        f"  compared  {compared}",
    ):
        print(printable(line))


def _print_scores(scores: "list[Score]", output: Format) -> None:
    from exumi_data.cli.output import (
        error_console,
        plain_table,
        print_json,
        print_table,
        result_console,
    )

    if output is Format.JSON:
        print_json([score.as_dict() for score in scores])
        return
    table = plain_table(
        ("by", "left"),
        ("ranking", "left"),
        ("queries", "right"),
        ("of", "right"),
        ("known", "right"),
        ("first (95 %)", "right"),
        ("in first five", "right"),
    )
    for score in scores:
        shares = (
            f"{s.value:.1%} ({s.low * 100:.0f} to {s.high * 100:.0f})"
            for s in (score.first, score.five)
        )
        counts = (f"{count:,}" for count in (score.queries, score.groups, score.known))
        table.add_row(score.by, score.ranking, *counts, *shares)
    print_table(table, result_console())
    if not any(score.known for score in scores):
        error_console().print(
            "note: the index knows none of these parts and objects, so nothing can be found; "
            "see --leave-one-out",
            style="dim",
            markup=False,
        )
