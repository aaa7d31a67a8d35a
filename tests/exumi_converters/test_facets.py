"""The words for what is lost: an episode equals itself, and every change is found by its name."""

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from exumi_converters import FACETS, differences
from exumi_data.episode import open_episode
from exumi_data.store import jpeg
from exumi_data.store.shards import crc32c
from tests.exumi_converters.whole import Made, write_episode

Change = Callable[[Path], object]


@pytest.fixture(scope="module")
def whole(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("whole")
    return write_episode(folder / "episode.zarr", Made(seconds=0.5, lossless_camera=True))


def document(change: Callable[[dict[str, Any]], object]) -> Change:
    def edit(episode: Path) -> None:
        path = episode / "zarr.json"
        root = json.loads(path.read_text())
        change(root["attributes"]["exumi"])
        path.write_text(json.dumps(root))

    return edit


def stream(name: str, **fields: object) -> Change:
    return document(lambda exumi: exumi["streams"][name].update(fields))


def array(path: str, add: int) -> Change:
    def edit(episode: Path) -> None:
        values = zarr.open_array(episode / path, mode="r+")
        first = np.asarray(values[:1])
        values[:1] = first + np.asarray(add, first.dtype)

    return edit


def without(name: str) -> Change:
    return document(lambda exumi: exumi["streams"].pop(name))


def other_jpeg(episode: Path) -> None:
    """One frame's comment is another: the pixels stay."""
    with open_episode(episode) as opened:
        file = opened["tactile"].encoded(0)
    start = file.index(b"\xff\xdb")
    changed = bytearray(file)
    assert jpeg.is_jpeg(file)
    # The density in the JFIF header changes no pixel.
    at = file.index(b"JFIF\x00") + 9
    assert at < start
    changed[at] ^= 1
    data = zarr.open_array(episode / "streams/tactile/data", mode="r+")
    data[: len(file)] = np.frombuffer(bytes(changed), np.uint8)
    checksums = zarr.open_array(episode / "streams/tactile/crc32c", mode="r+")
    checksums[:1] = np.array([crc32c(bytes(changed))], np.uint32)


CHANGES: list[tuple[set[str], Change]] = [
    ({"identity"}, document(lambda e: e.update(revision=2))),
    ({"start"}, document(lambda e: e.pop("start"))),
    ({"task"}, document(lambda e: e["task"].pop("instruction"))),
    ({"regime"}, document(lambda e: e.update(success=False))),
    ({"annotations"}, document(lambda e: e["annotations"].pop("trial"))),
    ({"people"}, document(lambda e: e.pop("operator"))),
    ({"licence"}, document(lambda e: e.update(licence="MIT"))),
    ({"quality"}, document(lambda e: e.pop("quality"))),
    ({"source"}, document(lambda e: e["source"].pop("lossy"))),
    ({"calibration"}, document(lambda e: e["calibration"].pop("encoder_map"))),
    ({"streams"}, without("force")),
    (
        {"stream-names"},
        lambda path: (
            document(lambda e: e["streams"].update(lips=e["streams"].pop("force")))(path),
            (path / "streams/force").rename(path / "streams/lips"),
        ),
    ),
    ({"time"}, array("streams/pose/time", 5)),
    ({"raw-time"}, array("streams/tactile/sequence", 0xFFFF)),
    ({"clock"}, stream("pose", clock={"source": "x", "stamp_point": "user_rx"})),
    ({"flags"}, array("streams/width/flags", 2)),
    ({"gaps"}, document(lambda e: e["streams"]["width"].pop("lost"))),
    ({"sensor"}, document(lambda e: e["streams"]["tactile"].pop("sensor"))),
    ({"values"}, array("streams/pose/data", 1)),
    ({"values"}, array("streams/mic/data", 1)),
    ({"values"}, array("streams/taxels/valid", 1)),
    ({"raw"}, array("streams/width/raw", 1)),
    ({"frame-bytes"}, other_jpeg),
    ({"pixels"}, array("streams/rgb/data", 1)),
    ({"reference"}, array("streams/tactile/reference", 1)),
    ({"derived"}, array("derived/tactile/activity", 1)),
]


def test_every_facet_has_a_change() -> None:
    assert set.union(*(facets for facets, _ in CHANGES)) == set(FACETS)


@pytest.mark.parametrize(
    ("facets", "change"),
    CHANGES,
    ids=[f"{i}-{min(facets)}" for i, (facets, _) in enumerate(CHANGES)],
)
def test_a_change_is_found_by_its_name(
    whole: Path, tmp_path: Path, facets: set[str], change: Change
) -> None:
    changed = tmp_path / "changed.zarr"
    shutil.copytree(whole, changed)
    change(changed)
    with open_episode(whole) as before, open_episode(changed) as after:
        assert differences(before, after) == facets


def test_an_episode_equals_itself(whole: Path) -> None:
    with open_episode(whole) as one, open_episode(whole) as other:
        assert differences(one, other) == frozenset()
