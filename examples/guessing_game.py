"""The Guessing Game and tactile sorting of Octopi-1.5, by retrieval alone: no training.

    python examples/guessing_game.py                 simulated touches, made on the spot
    python examples/guessing_game.py DATASET         your clips, with part ids and ratings

An index of seen parts answers questions about parts that it has never met: which of five objects
was touched, before and after it was taught them by a clip or two; and which is harder, or rougher.
One game is told in full, then all of them are counted, with 95 % intervals that draw parts.
"""

import argparse
import json
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

import exumi_data
from exumi_data.demo import TouchSettings, write_touch_dataset
from exumi_data.errors import ExumiError, UsageError
from exumi_loaders import (
    Clip,
    Clips,
    Embedding,
    EncodedClips,
    TactileIndex,
    TextureEncoder,
    encode_clips,
    felt_rating,
    guessing_game,
    tactile_sorting,
)

PROPERTIES = ("hardness", "roughness")
CANDIDATES, NEIGHBOURS, TAUGHT = 5, 5, 2
LETTERS = "ABCDE"


@dataclass
class Game:
    """Five unseen parts on the table; the clips of each are shuffled."""

    clips: dict[str, list[int]]
    answer: str

    @property
    def question(self) -> int:
        """The clip that is asked with: it is never taught."""
        return self.clips[self.answer][0]


def main() -> None:
    """Play, and say how often it went well."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("dataset", nargs="?", help="default: simulated touches")
    parser.add_argument("--simulated-parts", type=int, default=30)
    parser.add_argument("--rounds", type=int, default=10, help="of all games and sortings")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--json", action="store_true", help="print figures for programs")
    arguments = parser.parse_args()
    try:
        with tempfile.TemporaryDirectory() as work:
            results = play(arguments, Path(work), quiet=arguments.json)
    except ExumiError as error:
        sys.exit(f"error: {error}")
    if arguments.json:
        print(json.dumps(results, indent=2))


def play(arguments: argparse.Namespace, work: Path, *, quiet: bool) -> dict[str, Any]:
    """Tell one game and one sorting, then count many."""
    if arguments.dataset is None:
        settings = TouchSettings(parts=arguments.simulated_parts, seed=arguments.seed)
        dataset = write_touch_dataset(work / "touches", settings)
    else:
        opened = exumi_data.open(arguments.dataset)
        if not isinstance(opened, exumi_data.Dataset):
            sys.exit("error: give a dataset, not one episode")
        dataset = opened
    table = Clips(dataset).table
    encoder = TextureEncoder(table[0].shape[2])
    encoded = encode_clips(dataset, encoder)
    parts = np.array([clip.part_id or f"clip {clip.id}" for clip in table])
    game = lay_out(table, np.random.default_rng(arguments.seed))
    unseen = {clip.id for clip in table if clip.part_id in game.clips}
    seen = dataset.select([one for one in dataset.ids if one not in unseen])
    index = TactileIndex.build(seen, encoder, path=work / "index")

    say = (lambda _line="": None) if quiet else print
    say(f"{dataset.metadata.name}: {len(table)} clips of {len(set(parts))} parts; {encoder.digest}")
    told = {
        "game": tell_game(game, table, encoded, index, say),
        "sorting": tell_sorting(game, table, encoded, index, say),
    }
    try:
        counted = count_all(table, encoded, parts, arguments, encoder.whitening)
    except UsageError as error:  # one game can be told of five parts; counting takes more
        sys.exit(f"error: one game can be told of these parts, but not counted: {error}")
    for line in lines_of(counted):
        say(line)
    about = {"dataset": dataset.metadata.name, "clips": len(table), "parts": len(set(parts))}
    return {**about, "encoder": encoder.digest, "told": told, **counted}


def lay_out(table: list[Clip], rng: np.random.Generator) -> Game:
    """Draw five parts that are rated, with clips enough to ask and to teach."""
    clips: dict[str, list[int]] = {}
    for number, clip in enumerate(table):
        if clip.part_id is not None and all(name in clip.labels for name in PROPERTIES):
            clips.setdefault(clip.part_id, []).append(number)
    usable = sorted(part for part, numbers in clips.items() if len(numbers) > TAUGHT)
    if len(usable) < CANDIDATES:
        sys.exit(
            f"error: {len(usable)} part(s) have {TAUGHT + 1} clips and ratings of "
            f"{' and '.join(PROPERTIES)}; a game needs {CANDIDATES}"
        )
    drawn = [str(part) for part in rng.permutation(usable)[:CANDIDATES]]
    shuffled = {part: [int(n) for n in rng.permutation(clips[part])] for part in drawn}
    return Game(shuffled, drawn[int(rng.integers(CANDIDATES))])


def tell_game(
    game: Game, table: list[Clip], encoded: EncodedClips, index: TactileIndex, say: Any
) -> dict[str, Any]:
    """Ask which of five was touched: knowing nothing, taught one clip of each, taught two."""
    asked = encoded.embedding(game.question)
    say("\nThe Guessing Game. One of five objects was touched; the index has met none of them.")
    say("Determine which option the touched object is likely to be:")
    for letter, part in zip(LETTERS, game.clips, strict=True):
        say(f"  {letter}) {name_of(table[game.clips[part][0]])}")
    guesses = {"0": guess_by_ratings(game, table, index, asked)}
    say(f"\nBefore teaching. {index.line(index.query(asked, k=NEIGHBOURS))}")
    felt = ", ".join(f"{name} {felt:.1f}" for name, felt in ratings_of(index, asked).items())
    say(f"It feels like {felt}; nearest is {verdict(game, guesses['0'])}")
    for count in range(1, TAUGHT + 1):
        lessons = {part: clips[1 : 1 + count] for part, clips in game.clips.items()}
        for part, clips in lessons.items():
            index.teach([encoded.embedding(n) for n in clips], name=part, part_id=part)
        matches = index.query(asked, k=len(index), unique="clip")
        best = next(match for match in matches if match.entry.taught)
        guesses[str(count)] = best.name
        say(f"Taught {count} clip(s) of each: most similar is {verdict(game, best.name)}")
        for part in lessons:
            index.forget(part)  # the next lesson starts anew
    return {"options": list(game.clips), "answer": game.answer, "guess_by_clips_taught": guesses}


def verdict(game: Game, guess: str) -> str:
    """Say which option was chosen, and whether it is right."""
    said = f"option {LETTERS[list(game.clips).index(guess)]}"
    if guess == game.answer:
        return f"{said}, which is right."
    return f"{said}; it was {LETTERS[list(game.clips).index(game.answer)]}."


def name_of(clip: Clip) -> str:
    """Say what was touched and how it is rated."""
    words = clip.object or clip.part_id or "?"
    if clip.part and clip.part != clip.object:
        words += f", {clip.part}"
    return f"{words} ({', '.join(f'{name} {clip.labels[name]:.1f}' for name in PROPERTIES)})"


def ratings_of(index: TactileIndex, asked: Embedding) -> dict[str, float]:
    """Rate a clip by the clips that feel most like it; 5 where none of them is rated."""
    nearest = index.query(asked, k=NEIGHBOURS, unique="clip")
    felt = {name: felt_rating(nearest, name) for name in PROPERTIES}
    return {name: 5.0 if rating is None else rating for name, rating in felt.items()}


def guess_by_ratings(game: Game, table: list[Clip], index: TactileIndex, asked: Embedding) -> str:
    """Return the option whose known ratings are nearest to what is felt."""
    felt = ratings_of(index, asked)

    def distance(part: str) -> float:
        known = table[game.clips[part][0]].labels
        return sum((known[name] - felt[name]) ** 2 for name in PROPERTIES)

    return min(game.clips, key=distance)


def tell_sorting(
    game: Game, table: list[Clip], encoded: EncodedClips, index: TactileIndex, say: Any
) -> dict[str, Any]:
    """Sort the same five by touch; the index knows none of them again."""
    orders: dict[str, Any] = {}
    for name in PROPERTIES:
        felt = {
            part: ratings_of(index, encoded.embedding(clips[0]))[name]
            for part, clips in game.clips.items()
        }
        rated = {part: table[clips[0]].labels[name] for part, clips in game.clips.items()}
        letters = dict(zip(game.clips, LETTERS, strict=True))
        order = sorted(felt, key=lambda part: -felt[part])
        truth = sorted(rated, key=lambda part: -rated[part])
        say(f"\nRank the touched objects in decreasing {name}.")
        say("  by touch:  " + ", ".join(f"{letters[p]} ({felt[p]:.1f})" for p in order))
        say("  as rated:  " + ", ".join(f"{letters[p]} ({rated[p]:.1f})" for p in truth))
        orders[name] = {"by_touch": order, "as_rated": truth}
    return orders


def count_all(
    table: list[Clip],
    encoded: EncodedClips,
    parts: np.ndarray,
    arguments: argparse.Namespace,
    whitening: int | None,
) -> dict[str, Any]:
    """Play every clip of every part, and sort all pairs that are clearly different."""
    labels = np.array([[clip.labels.get(name, np.nan) for name in PROPERTIES] for clip in table])
    options: dict[str, Any] = {
        "whitening": whitening,
        "rounds": arguments.rounds,
        "seed": arguments.seed,
    }
    games = [
        guessing_game(encoded.vectors, parts, labels=labels, taught=taught, **options)
        for taught in range(TAUGHT + 1)
    ]
    sortings = [
        {
            "property": name,
            **tactile_sorting(
                encoded.vectors, parts, labels[:, column], tested=tested, method=method, **options
            ).as_dict(),
        }
        for column, name in enumerate(PROPERTIES)
        for tested in ("seen", "unseen")
        for method in ("neighbours", "ridge")
    ]
    return {"guessing_game": [game.as_dict() for game in games], "sorting": sortings}


def lines_of(counted: dict[str, Any]) -> list[str]:
    """Write the figures for people."""
    games, sortings = counted["guessing_game"], counted["sorting"]
    lines = [f"\nAll games, of {CANDIDATES} unseen parts (chance {1 / CANDIDATES:.0%}):"]
    for game in games:
        said = f"{game['taught']} clip(s) of each taught" if game["taught"] else "nothing taught"
        lines.append(f"  {said:28} {share_of(game['right'])}  in {game['games']} games")
    margin = sortings[0]["margin"]
    lines.append(f"\nPairs of parts rated more than {margin:g} of 10 apart, sorted (chance 50%):")
    for sorting in sortings:
        said = f"{sorting['property']}, {sorting['tested']} parts, {sorting['method']}"
        lines.append(f"  {said:36} {share_of(sorting['right'])}  of {sorting['pairs']} pairs")
    return lines


def share_of(share: dict[str, float]) -> str:
    """Write a share with its 95 % interval."""
    return f"{share['value']:6.1%} ({share['low']:.0%} to {share['high']:.0%})"


if __name__ == "__main__":
    main()
