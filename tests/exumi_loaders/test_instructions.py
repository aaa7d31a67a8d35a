"""Instruction samples: only what the labels bear out."""

import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from exumi_data.errors import UsageError
from exumi_data.model import Label
from exumi_loaders import InstructionSamples
from exumi_loaders.instructions import Instruction


def words(*adjectives: str) -> Label:
    return Label(property="adjectives", value=list(adjectives), provenance="human")


@pytest.fixture
def things(make_touches: Any, touch: Any, rated: Any) -> Any:
    """Plain and dotted parts; some without adjectives, some without ratings, two that tie."""
    made = []
    for number in range(6):
        labels = [*rated(hardness=number, roughness=9 - number), words(f"word{number}", "flat")]
        made += [touch(f"part{number}", f"object{number // 2}", labels=labels, stored=2)] * 2
    made += [touch("mute", "object0", labels=rated(hardness=7.0), stored=2)]
    made += [touch("unrated", "object1", labels=[words("odd")], stored=2)]
    made += [touch("half", labels=[*rated(hardness=3.0), words("half")], stored=2)]
    for number in range(3):
        labels = [*rated(hardness=number, roughness=5), words(f"dots{number}")]
        made += [touch(f"dots{number}", pad="dotted", labels=labels, stored=2)]
    made += [touch("anywhere", sensor=None, labels=[words("lost")]), touch(None)]
    return make_touches(*made)


def check(samples: InstructionSamples, sample: Instruction) -> None:
    """Read a sample's answer back, and hold it against the labels."""
    clips = {part.label: samples.clips.table[part.clip] for part in sample.parts}
    assert len({clip.part_id for clip in clips.values()}) == len(clips)
    assert {clip.kind for clip in clips.values()} == {(sample.sensor_model, sample.pad_type)}
    assert sample.question.count("<tact_tokens>") == len(clips)
    assert re.findall(r"Part ([\d.]+): <tact_tokens>", sample.question) == list(clips)
    for number in {part.object for part in sample.parts}:
        whole = {clips[p.label].object_id for p in sample.parts if p.object == number}
        assert len(whole) == 1
    described = dict(re.findall(r"Part ([\d.]+): (.*)\.", sample.answer))
    if sample.task != "rank":
        assert described == {label: ", ".join(clip.adjectives) for label, clip in clips.items()}
    ranked = re.findall(r"ranked in decreasing (\w+): (.*)", sample.answer)
    assert [name for name, _ in ranked] == list(sample.properties)
    assert bool(ranked) == (sample.task != "describe")
    for name, order in ranked:
        assert sorted(re.findall(r"[\d.]+", order)) == sorted(clips)
        steps = [[clips[label].labels[name] for label in step.split(" = ")]
                 for step in order.split(", ")]  # fmt: skip
        assert all(len(set(step)) == 1 for step in steps)
        values = [step[0] for step in steps]
        assert values == sorted(set(values), reverse=True)


@pytest.mark.parametrize("ties", ["not_asked", "equal"])
def test_answers_say_what_the_labels_say(things: Any, ties: Any) -> None:
    samples = InstructionSamples(
        things, count=300, tasks=("describe", "describe_and_rank", "rank"), ties=ties, frames=2
    )
    found = list(samples)
    for sample in found:
        check(samples, sample)
    assert {sample.task for sample in found} == {"describe", "describe_and_rank", "rank"}
    assert {sample.pad_type for sample in found} == {"plain", "dotted"}
    both = ("hardness", "roughness")
    assert {sample.properties for sample in found} == {(), ("hardness",), both}
    tied = [sample for sample in found if " = " in sample.answer]
    assert bool(tied) == (ties == "equal")
    assert samples.left_out == {"without a part id": 1, "without a sensor model": 1}
    parts = {samples.clips.table[part.clip].part_id for s in found for part in s.parts}
    assert {"mute", "unrated", "half", "dots0"} <= parts
    assert max(len(sample.parts) for sample in found) > 4


def test_equal_ratings_are_not_ranked_nor_almost_equal_ones(
    make_touches: Any, touch: Any, rated: Any
) -> None:
    values = (1.0, 1.3, 5.0)
    dataset = make_touches(
        *(touch(f"p{v}", labels=[*rated(hardness=v), words("w")]) for v in values)
    )
    options: dict[str, Any] = {"count": 60, "tasks": ["rank"], "properties": ["hardness"]}
    exact = InstructionSamples(dataset, **options)
    assert {len(sample.parts) for sample in exact} == {2, 3}
    apart = InstructionSamples(dataset, tie_margin=0.5, **options)
    for sample in apart:
        ratings = [apart.clips.table[part.clip].labels["hardness"] for part in sample.parts]
        assert 5.0 in ratings
        assert len(ratings) == 2
    with pytest.raises(UsageError, match="without ties"):
        InstructionSamples(dataset, tie_margin=9.0, **options).instruction(0)


def test_missing_labels_are_said(make_touches: Any, touch: Any, rated: Any) -> None:
    plain = make_touches(touch("a", labels=rated(hardness=1)), touch("b", labels=rated(hardness=2)))
    with pytest.raises(UsageError, match="'describe': adjectives"):
        InstructionSamples(plain)
    with pytest.raises(UsageError, match="ratings of roughness of two parts"):
        InstructionSamples(plain, tasks=["rank"], properties=["roughness"])
    assert len(InstructionSamples(plain, tasks=["rank"], count=3)) == 3


def test_the_file_is_the_same_byte_for_byte(things: Any, tmp_path: Path) -> None:
    def written(name: str, **options: Any) -> bytes:
        path = tmp_path / name
        samples = InstructionSamples(things, count=40, frames=2, **options)
        assert samples.write_jsonl(path) == 40
        return path.read_bytes()

    first = written("one.jsonl", seed=1)
    assert written("one.jsonl", seed=1) == first
    assert written("two.jsonl", seed=2) != first
    other = str(tmp_path / "other.jsonl")
    code = (
        "import exumi_data, exumi_loaders as l;"
        f"d = exumi_data.open({things.path!r}).select({things.ids!r});"
        f"l.InstructionSamples(d, count=40, frames=2, seed=1).write_jsonl({other!r})"
    )
    environment = {**os.environ, "PYTHONHASHSEED": "12345"}
    subprocess.run([sys.executable, "-c", code], check=True, env=environment)
    assert (tmp_path / "other.jsonl").read_bytes() == first


def test_the_lines_lead_to_the_frames(things: Any, tmp_path: Path) -> None:
    samples = InstructionSamples(things, count=20, frames=2)
    samples.write_jsonl(tmp_path / "all.jsonl")
    lines = (tmp_path / "all.jsonl").read_text().splitlines()
    assert len(lines) == len(samples) == 20
    for number, line in enumerate(lines):
        document = json.loads(line)
        item = samples[number]
        assert [m["role"] for m in document["chat"]] == ["user", "assistant"]
        assert [m["content"] for m in document["chat"]] == [item["question"], item["answer"]]
        assert [part["label"] for part in document["parts"]] == item["labels"]
        for group, part in zip(item["frames"], document["parts"], strict=True):
            stream = things[part["episode"]][part["stream"]]
            shown = group.movedim(1, -1).numpy()
            assert (shown == stream.frames[part["frames"]]).all()


def test_a_sample_does_not_depend_on_how_many_there_are(things: Any) -> None:
    few, many = (InstructionSamples(things, count=n, frames=2, seed=4) for n in (3, 30))
    assert list(few) == list(many)[:3]
    assert many.instruction(-1) == many.instruction(29)
    with pytest.raises(IndexError, match="sample 30"):
        many.instruction(30)


def test_no_part_of_val_is_in_a_sample_of_train(things: Any) -> None:
    known = things.select(part_id=[f"part{n}" for n in range(6)])
    seen = []
    for name in ("train", "val"):
        samples = InstructionSamples(known, split=name, split_ratio=(1, 1), count=100)
        seen.append({samples.clips.table[p.clip].part_id for s in samples for p in s.parts})
    assert [len(parts) for parts in seen] == [3, 3]
    assert not seen[0] & seen[1]


def test_loaders_hand_out_lists_of_samples(things: Any) -> None:
    samples = InstructionSamples(things, count=5, frames=2)
    batches = list(samples.loader(2))
    assert [len(batch) for batch in batches] == [2, 2, 1]
    assert batches[0][1]["answer"] == samples[1]["answer"]
    item = samples[0]
    assert item["frames"].shape[:3] == (len(item["labels"]), 2, 1)
    assert item["frames_valid"].all()


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"count": 0}, "count"),
        ({"max_parts": 0}, "max_parts"),
        ({"tasks": ()}, "tasks"),
        ({"tasks": ("guess",)}, "tasks"),
        ({"ties": "broken"}, "ties"),
        ({"ties": "equal", "tie_margin": 1.0}, "tie_margin"),
        ({"tie_margin": -1.0}, "tie_margin"),
    ],
)
def test_wrong_options_are_refused(things: Any, options: Any, said: str) -> None:
    with pytest.raises(UsageError, match=said):
        InstructionSamples(things, **options)
