"""Labels and segments, in an episode and between the episodes of a dataset."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.model import Annotations, DatasetMetadata, Label, Segment
from exumi_data.splits import make_split
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_validators import Problem, validate
from tests.exumi_data.builders import CLOCK, edit_json, episode_id, metadata


def label(value: Any = 7.0, **changes: Any) -> Label:
    scale = [0.0, 10.0] if isinstance(value, float) else None
    values = {"property": "hardness", "provenance": "human", "origin": "labels.csv", **changes}
    return Label(value=value, scale=scale, **values)


def write(path: Path, number: int = 0, regime: str = "touch", **annotations: Any) -> Path:
    """An episode of a width at 0, 100 and 200 ns."""
    values = metadata(number, regime=regime, annotations=Annotations(**annotations))
    with EpisodeWriter(path, values, durable=False) as writer:
        width = writer.add_stream("width", kind="width", clock=CLOCK)
        width.append(np.arange(3) * 100, np.zeros(3))
    return path


def codes(path: Path) -> list[str]:
    report = validate(path, workers=1)
    assert report.coverage.unchecked == ()
    return [problem.code for problem in report.problems]


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({}, []),
        ({"origin": None}, ["ANN-004"]),
        ({"origin": ""}, ["ANN-004"]),
        ({"origin": None, "raters": 1}, []),
        ({"origin": None, "raters": 1, "provenance": "model"}, ["ANN-004"]),
        ({"provenance": "model", "origin": "words 1.2"}, []),
    ],
)
def test_where_a_label_is_from(tmp_path: Path, changes: Any, found: list[str]) -> None:
    path = write(tmp_path / "e.zarr", part_id="egg", labels=[label(**changes)])
    assert codes(path) == found


@pytest.mark.parametrize(
    ("ids", "found"),
    [({}, ["ANN-005"]), ({"object": "an egg"}, ["ANN-005"]), ({"object_id": "egg"}, [])],
)
def test_what_a_label_is_of(tmp_path: Path, ids: Any, found: list[str]) -> None:
    assert codes(write(tmp_path / "e.zarr", labels=[label()], **ids)) == found


def test_nothing_is_asked_of_episodes_without_labels(tmp_path: Path) -> None:
    assert codes(write(tmp_path / "e.zarr", labels=[])) == []


@pytest.mark.parametrize(
    ("second", "found"),
    [
        (label(), []),
        (label(6.0), ["ANN-006"]),
        (label(["soft"]), ["ANN-006"]),
        (label(6.0, origin="others.csv"), []),
        (label(6.0, provenance="model"), []),
        (label(6.0, property="roughness"), []),
    ],
)
def test_labels_that_contradict(tmp_path: Path, second: Label, found: list[str]) -> None:
    path = write(tmp_path / "e.zarr", part_id="egg", labels=[label(), second])
    assert codes(path) == found


@pytest.mark.parametrize(
    ("start", "end", "found"),
    [(-9, 0, []), (200, 900, []), (-9, 900, []), (-9, -1, ["ANN-007"]), (201, 900, ["ANN-007"])],
)
def test_where_a_segment_lies(tmp_path: Path, start: int, end: int, found: list[str]) -> None:
    segment = Segment(name="contact", start_ns=start, end_ns=end)
    assert codes(write(tmp_path / "e.zarr", segments=[segment])) == found


def test_segments_of_nothing(tmp_path: Path) -> None:
    values = metadata(annotations=Annotations(segments=[Segment(name="a", start_ns=0, end_ns=1)]))
    with EpisodeWriter(tmp_path / "e.zarr", values, durable=False):
        pass
    report = validate(tmp_path / "e.zarr")
    assert report.codes() == {}
    assert ("ANN-007", "there are no samples") in [
        (skipped.code, skipped.reason) for skipped in report.coverage.skipped
    ]


# ----------------------------------------------------------------------------------------- datasets


def dataset(root: Path, *episodes: dict[str, Any]) -> Path:
    """A dataset of episodes with these annotations."""
    create_dataset(root, DatasetMetadata(name="tests", licence="CC0-1.0"))
    for number, annotations in enumerate(episodes):
        write(root / episode_path(episode_id(number)), number, **annotations)
    table, failed = build_catalog(root)
    assert not failed
    write_catalog(root, table)
    return root


def test_a_part_of_two_objects(tmp_path: Path) -> None:
    cup = {"object_id": "cup", "part_id": "handle"}
    pot = {"object_id": "pot", "part_id": "handle"}
    assert codes(dataset(tmp_path / "one", cup, cup, {"part_id": "handle"})) == []
    assert codes(dataset(tmp_path / "two", cup, cup, pot)) == ["SET-007"]


@pytest.mark.parametrize(
    ("second", "found"),
    [
        ({"labels": [label(7.0)]}, []),
        ({"labels": [label(6.0)]}, ["SET-008"]),
        ({"labels": [label(6.0, origin="others.csv")]}, []),
        ({"labels": [label(6.0)], "instance_id": "second"}, []),
        ({"labels": [label(6.0)], "part_id": "lid"}, []),
        ({"labels": None}, []),
    ],
)
def test_labels_of_one_thing(tmp_path: Path, second: Any, found: list[str]) -> None:
    cup = {"object_id": "cup", "part_id": "handle"}
    path = dataset(tmp_path / "d", {**cup, "labels": [label()]}, {**cup, **second})
    assert codes(path) == found


def split(path: Path, level: Any = "episode") -> list[Problem]:
    """Split a dataset, and return what is found."""
    made = make_split(open_dataset(path), level=level, ratio=(1, 1))
    (path / "splits").mkdir()
    (path / "splits" / "default.json").write_text(made.model_dump_json(), "utf-8")
    edit_json(path / "dataset.json", lambda head: head.update(splits=["default"]))
    report = validate(path, workers=1)
    assert report.coverage.unchecked == ()
    return list(report.problems)


def test_parts_in_train_and_val(tmp_path: Path) -> None:
    parts = [{"object_id": "cup", "part_id": part} for part in ("lid", "handle", "cup")]
    (problem,) = split(dataset(tmp_path / "d", *parts, *parts, *parts, *parts))
    assert (problem.code, problem.severity) == ("SPLIT-009", "info")
    assert problem.message == "of 3 parts, 3 are in more than one list"


def test_a_split_by_part(tmp_path: Path) -> None:
    parts = [{"object_id": "cup", "part_id": part} for part in ("lid", "handle", "cup")]
    assert split(dataset(tmp_path / "d", *parts, *parts), level="part") == []


@pytest.mark.parametrize(
    ("changes", "found"),
    [
        ({"regime": "play"}, []),
        ({"regime": "demonstration", "labels": [label()]}, ["SPLIT-009"]),
        ({"regime": "touch"}, ["SPLIT-009"]),
    ],
)
def test_where_it_matters(tmp_path: Path, changes: Any, found: list[str]) -> None:
    episodes = [{"object_id": "cup", **changes}] * 4
    assert [p.code for p in split(dataset(tmp_path / "d", *episodes))] == found


def test_things_without_ids(tmp_path: Path) -> None:
    path = dataset(tmp_path / "d", {}, {})
    assert split(path) == []
    report = validate(path, workers=1)
    assert "SPLIT-009" in {skipped.code for skipped in report.coverage.skipped}
