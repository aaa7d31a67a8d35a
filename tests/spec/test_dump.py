"""The canonical dump: what it says, and how two dumps are compared."""

import hashlib
import importlib.util
import itertools
import json
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np
import pytest

from exumi_data.episode import open_episode
from tests.exumi_data.builders import write_episode

SPEC = Path(__file__).resolve().parents[2] / "spec"


def load(path: Path) -> ModuleType:
    spec = importlib.util.spec_from_file_location(path.stem, path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


DUMP = load(SPEC / "readers" / "dump.py")
COMPARE = load(SPEC / "conformance" / "harness" / "dumps.py")


@pytest.fixture(scope="module")
def episode(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_episode(tmp_path_factory.mktemp("dump") / "a.zarr")


@pytest.fixture(scope="module")
def dump(episode: Path) -> dict[str, Any]:
    found: dict[str, Any] = DUMP.dump_episode(episode)
    return found


def sha(data: bytes) -> str:
    return hashlib.sha256(data).hexdigest()


def test_streams_stand_in_their_order_and_arrays_by_name(dump: Any, episode: Path) -> None:
    with open_episode(episode) as opened:
        assert [stream["name"] for stream in dump["streams"]] == list(opened.streams)
        for stream in dump["streams"]:
            view = opened[stream["name"]]
            assert stream["kind"] == view.kind
            assert stream["count"] == len(view)
            assert [a["name"] for a in stream["arrays"]] == sorted(view.metadata.arrays)
            for array in stream["arrays"]:
                values = view.array(array["name"])
                little = values.astype(values.dtype.newbyteorder("<"))
                assert array["sha256"] == sha(little.tobytes())
                assert (array["dtype"], array["shape"]) == (values.dtype.name, [*values.shape])


def test_frames_are_the_first_the_middle_and_the_last(dump: Any, episode: Path) -> None:
    streams = {stream["name"]: stream for stream in dump["streams"]}
    with open_episode(episode) as opened:
        count = len(opened["tactile"])
        for frame, index in zip(
            streams["tactile"]["images"]["frames"], (0, count // 2, count - 1), strict=True
        ):
            assert frame["index"] == index
            assert frame["sha256"] == sha(opened["tactile"].encoded(index))
            pixels = opened["tactile"].frames[index]
            assert [frame[key] for key in ("height", "width", "channels")] == [*pixels.shape]
            corner = pixels[: pixels.shape[0] // 3, : pixels.shape[1] // 4]
            assert frame["blocks"][0] == [round(v) for v in corner.mean(axis=(0, 1)).tolist()]
        for frame in streams["rgb"]["images"]["frames"]:
            assert frame["sha256"] == sha(opened["rgb"].frames[frame["index"]].tobytes())
        (file,) = streams["gopro"]["images"]["files"]
        assert file["sha256"] == sha(opened["gopro"].container())


@pytest.mark.parametrize(
    ("length", "count"), [(1, 1), (7, 1), (15, 1), (16, 2), (31, 3), (32, 4), (480, 4)]
)
def test_blocks_cover_an_axis(length: int, count: int) -> None:
    edges = list(DUMP.edges(length))
    assert len(edges) == count
    assert edges[0][0] == 0
    assert edges[-1][1] == length
    assert all(a[1] == b[0] for a, b in itertools.pairwise(edges))


def test_large_arrays_are_hashed_block_by_block(
    episode: Path, dump: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(DUMP, "BLOCK_BYTES", 64)
    assert DUMP.dump_episode(episode) == dump


def test_a_dump_is_json(dump: Any) -> None:
    assert json.loads(json.dumps(dump)) == dump


def changed(dump: Any, *place: Any, value: Any) -> Any:
    copy = json.loads(json.dumps(dump))
    *outer, last = place
    inner = copy
    for part in outer:
        inner = inner[part]
    inner[last] = value
    return copy


def test_decoders_may_differ_a_little_and_nothing_else_may(dump: Any) -> None:
    streams = [stream["name"] for stream in dump["streams"]]
    blocks = ("streams", streams.index("tactile"), "images", "frames", 0, "blocks")
    level = dump["streams"][blocks[1]]["images"]["frames"][0]["blocks"][1][2]
    for change, differs in ((2, False), (-2, False), (3, True), (-3, True)):
        other = changed(dump, *blocks, 1, 2, value=level + change)
        assert bool(list(COMPARE.differences(dump, other))) == differs
    for place, value in (
        (("id",), "another"),
        (("streams", 0, "count"), 2.0),
        (("streams", 0, "arrays"), []),
        (("streams", 0, "more"), 1),
        ((*blocks[:-1], "sha256"), "0" * 64),
        ((*blocks,), []),
    ):
        assert list(COMPARE.differences(dump, changed(dump, *place, value=value)))
    assert list(COMPARE.differences(dump, dump)) == []


def test_what_cannot_be_read_is_refused_in_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(sys, "argv", ["dump.py", str(tmp_path)])
    assert DUMP.main() == 1
    assert capsys.readouterr().err.startswith("refused: ")


def test_grey_frames_have_one_mean_a_block() -> None:
    frame = np.full((16, 8, 1), 7, np.uint8)
    assert DUMP.block_means(frame) == [[7], [7]]
