"""Retrieval by touch: how good the built-in encoder is, and how fast the index searches.

How good (``--dataset``, each a dataset of touch clips with part ids, such as the Octopi clips):

- leave one clip out: each clip is asked for in an index of all others, whose space was fitted
  without it; by part id and by object, ranked by similarity and by matches;
- the Guessing Game: five candidates, parts that the index has not seen when it was built; guessed
  by labels before teaching, by the averaged vector of one or two clips of each candidate after;
- tactile sorting: of two parts that are rated more than 2 of 10 apart, which is harder, or rougher,
  by one clip of each; of parts that were met before, and of unseen ones.

Intervals hold 95 %; they come from drawing parts with replacement, since clips of one part are
alike.

How fast (``--rows``): top 5 of so many vectors against the bare matrix product of the same vectors
in memory, in turns, in one process. The index lies on disk and is mapped.
"""

import argparse
import os
import shutil
import statistics
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report

import exumi_data
from exumi_loaders import (
    Entry,
    TactileIndex,
    TextureEncoder,
    encode_clips,
    guessing_game,
    leave_one_out,
    tactile_sorting,
)
from exumi_loaders.clips import Clips
from exumi_loaders.retrieval.document import EncoderStatement, IndexDocument
from exumi_loaders.retrieval.folder import write_document
from exumi_loaders.retrieval.segments import write_segment
from exumi_loaders.retrieval.space import unit

_SEGMENT = 50_000
_PROPERTIES = ("hardness", "roughness")


def quality(path: str, rounds: int) -> dict[str, Any]:
    """Measure the built-in encoder on a dataset."""
    dataset = exumi_data.open(path)
    if not isinstance(dataset, exumi_data.Dataset):
        sys.exit(f"{path} is no dataset")
    channels = Clips(dataset).table[0].shape[2]
    encoder = TextureEncoder(channels)
    clips = encode_clips(dataset, encoder)
    parts = np.array([entry.part_id or "" for entry in clips.entries])
    labels = np.array(
        [[entry.labels.get(name, np.nan) for name in _PROPERTIES] for entry in clips.entries]
    )
    games = [
        guessing_game(
            clips.vectors,
            parts,
            whitening=encoder.whitening,
            taught=taught,
            labels=labels,
            rounds=rounds,
        )
        for taught in (0, 1, 2)
    ]
    return {
        "dataset": dataset.metadata.name,
        "clips": len(clips),
        "parts": len(set(parts)),
        "encoder": encoder.digest,
        "encode_ms_a_clip": _encoding(dataset, encoder),
        "leave_one_out": [score.as_dict() for score in leave_one_out(clips, encoder)],
        "guessing_game": [game.as_dict() for game in games],
        "sorting": _sorting(clips.vectors, parts, labels, encoder.whitening, rounds),
        "first_place_by_whitening": _by_whitening(clips, channels),
    }


def _encoding(dataset: exumi_data.Dataset, encoder: TextureEncoder) -> float:
    """Median time of one clip of 10 frames, without decoding."""
    clips = Clips(dataset)
    seconds = []
    for index in range(min(len(clips), 40)):
        frames, reference = clips.read(index)
        start = time.perf_counter()
        encoder.encode(frames, reference)
        seconds.append(time.perf_counter() - start)
    return round(1e3 * statistics.median(seconds), 2)


def _sorting(
    vectors: np.ndarray,
    parts: np.ndarray,
    labels: np.ndarray,
    whitening: int | None,
    rounds: int,
) -> list[dict[str, Any]]:
    """Sort pairs of parts in both ways, also with other settings: are these lucky ones."""
    ways: list[dict[str, Any]] = [
        *({"method": "neighbours", "neighbours": count} for count in (5, 1, 10)),
        *({"method": "ridge", "penalty": penalty} for penalty in (1.0, 0.1, 10.0)),
    ]
    return [
        {
            "property": name,
            **way,
            **tactile_sorting(
                vectors,
                parts,
                labels[:, column],
                whitening=whitening,
                tested=tested,
                rounds=rounds,
                **way,
            ).as_dict(),
        }
        for column, name in enumerate(_PROPERTIES)
        for tested in ("seen", "unseen")
        for way in ways
    ]


def _by_whitening(clips: Any, channels: int) -> dict[str, float]:
    """First place by part id with other numbers of dimensions: is 48 a lucky number."""
    found = {}
    for dimensions in (24, 32, 48, 64, 96):
        encoder = TextureEncoder(channels)
        encoder.whitening = dimensions
        found[str(dimensions)] = round(leave_one_out(clips, encoder)[0].first.value, 4)
    return found


def speed(work: Path, rows: int, dimension: int, repeats: int) -> dict[str, Any]:
    """Measure search against the bare product."""
    path = work / "retrieval-index"
    shutil.rmtree(path, ignore_errors=True)
    path.mkdir(parents=True)
    try:
        return _speed(path, rows, dimension, repeats)
    finally:
        shutil.rmtree(path, ignore_errors=True)


def _speed(path: Path, rows: int, dimension: int, repeats: int) -> dict[str, Any]:
    random = np.random.default_rng(0)
    matrix = np.empty((rows, dimension), dtype=np.float32)
    statements = []
    for start in range(0, rows, _SEGMENT):
        end = min(rows, start + _SEGMENT)
        matrix[start:end] = unit(random.standard_normal((end - start, dimension), np.float32))
        entries = [
            Entry(f"{n:032x}/tactile", f"object {n % 5000}", part_id=f"part {n % 20000}")
            for n in range(start, end)
        ]
        statements.append(write_segment(path, matrix[start:end], entries))
    encoder = EncoderStatement(name="random/1", digest="random/1", dimension=dimension)
    write_document(
        path,
        IndexDocument(encoder=encoder, frames=10, dimension=dimension, segments=statements),
    )
    _out_of_the_cache(path)
    opening, index = _seconds(lambda: TactileIndex.open(path))
    queries = unit(random.standard_normal((64, dimension), np.float32))
    cold, _ = _seconds(lambda: index.search(queries[:1], 5))
    again, _ = _seconds(lambda: TactileIndex.open(path))
    results: dict[str, Any] = {
        "rows": rows,
        "dimension": dimension,
        "threads": os.environ.get("OPENBLAS_NUM_THREADS", "as many as cores"),
        "open_s_cold": round(opening, 3),
        "first_query_s_cold": round(cold, 3),
        "open_s_warm": round(again, 3),
    }
    for batch in (1, 64):
        asked = queries[:batch]
        bare, searched = [], []
        for _ in range(repeats):
            bare.append(_seconds(partial(_product, matrix, asked))[0])
            searched.append(_seconds(partial(index.search, asked, 5))[0])
        found = index.search(asked, 5)[1]
        products = _product(matrix, asked[:1])
        assert found[0].tolist() == np.argsort(-products.ravel(), kind="stable")[:5].tolist()  # noqa: S101  # a fast wrong answer is none
        ratio = statistics.median(searched) / statistics.median(bare)
        results[f"batch_{batch}"] = {
            "bare_s": [round(value, 4) for value in bare],
            "index_s": [round(value, 4) for value in searched],
            "ratio": round(ratio, 3),
        }
    return results


def _product(matrix: np.ndarray, queries: np.ndarray) -> np.ndarray:
    return np.asarray(matrix @ queries[0] if len(queries) == 1 else queries @ matrix.T)


def _seconds(function: Callable[[], Any]) -> tuple[float, Any]:
    start = time.perf_counter()
    result = function()
    return time.perf_counter() - start, result


def _out_of_the_cache(root: Path) -> None:
    """Ask the system to forget what it knows of the files (written to disk by now)."""
    for path in root.rglob("*"):
        if path.is_file():
            descriptor = os.open(path, os.O_RDONLY)
            os.posix_fadvise(descriptor, 0, 0, os.POSIX_FADV_DONTNEED)
            os.close(descriptor)


def table(results: dict[str, Any]) -> str:
    """Write the results for people."""

    def share(value: dict[str, float]) -> str:
        return f"{value['value']:.1%} ({value['low']:.1%} to {value['high']:.1%})"

    lines = []
    for one in results["quality"]:
        lines.append(
            f"{one['dataset']}: {one['clips']} clips, {one['parts']} parts, {one['encoder']}, "
            f"{one['encode_ms_a_clip']} ms a clip"
        )
        lines += [
            f"  leave one out, by {score['by']}, ranked by {score['ranking']}: first "
            f"{share(score['first'])}, in first five {share(score['five'])}"
            for score in one["leave_one_out"]
        ]
        lines += [
            f"  guessing game, {game['candidates']} unseen, {game['taught']} clip(s) taught: "
            f"{share(game['right'])}"
            for game in one["guessing_game"]
        ]
        lines += [
            f"  sorting by {way['property']}, {way['tested']} parts, {way['method']} "
            f"{way.get('neighbours', way.get('penalty'))}: {share(way['right'])} of "
            f"{way['pairs']} pairs of {way['parts']} parts"
            for way in one["sorting"]
        ]
        lines.append(f"  first place by dimensions: {one['first_place_by_whitening']}")
    if results["speed"]:
        fast = results["speed"]
        lines.append(f"{fast['rows']:,} x {fast['dimension']}: opened in {fast['open_s_cold']} s")
        for batch in (1, 64):
            lines.append(f"  batch {batch}: {fast[f'batch_{batch}']['ratio']} x the bare product")
    return "\n".join(lines)


def main() -> None:
    """Run."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", action="append", default=[], help="with touch clips")
    parser.add_argument("--rounds", type=int, default=20, help="of the Guessing Game")
    parser.add_argument("--rows", type=int, default=0, help="vectors of the speed test; 0: none")
    parser.add_argument("--dimension", type=int, default=1024)
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--work", type=Path, default=Path("work"))
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    results = {
        "machine": describe_machine(("numpy", "pyarrow", "opencv-contrib-python-headless")),
        "quality": [quality(path, options.rounds) for path in options.dataset],
        "speed": speed(options.work, options.rows, options.dimension, options.repeats)
        if options.rows
        else None,
    }
    report("retrieval", results, options.json)
    print(table(results), file=sys.stderr)


if __name__ == "__main__":
    main()
