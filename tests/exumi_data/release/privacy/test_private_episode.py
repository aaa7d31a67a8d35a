import hashlib
import json
import shutil
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.clips.clip import read_clip
from exumi_data.dataset import create_dataset, open_dataset
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import UnsupportedError, UsageError
from exumi_data.model import DatasetMetadata, MadeBy, VideoImages
from exumi_data.release.privacy import (
    KINDS,
    REMOVAL_STEP,
    Removal,
    find_private,
    private_in,
    remove_private,
    without_private,
)
from exumi_data.store.access import open_store
from exumi_data.store.pack import pack, pack_store
from tests.exumi_data.builders import edit_metadata, episode_id, read_everything, write_episode
from tests.exumi_data.release.privacy.clips import (
    CAMERA,
    HOME,
    LENS,
    POSITION,
    clip,
    with_ids,
    write_private,
)

EVERYTHING = Removal(frozenset(KINDS))
KEY = b"a key that nobody knows"


@pytest.fixture(scope="module")
def private(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("private")
    return write_private(folder / "a.zarr", with_ids(clip(folder / "GX010001.MP4")))


def packed_without(source: Path, target: Path, removal: Removal = EVERYTHING) -> Path:
    store = open_store(source)
    pack_store(without_private(store, removal).store, target)
    store.close()
    return target


def members(path: Path) -> dict[str, bytes]:
    store = open_store(path)
    found = {name: store.read(name) for name in store.paths()}
    store.close()
    return found


def test_that_every_kind_is_found(private: Path) -> None:
    found = {
        (item.kind, item.where.partition("#")[2] or item.where): item.value
        for item in find_private(private)
    }
    below = "/attributes/exumi"
    assert found == {
        ("operator", f"{below}/operator"): "Grace Hopper",
        ("site", f"{below}/site"): "Building 7",
        ("serial", f"{below}/device/serial"): "EX-0007",
        ("host", f"{below}/device/hub"): "hub-of-grace",
        ("serial", f"{below}/streams/rgb/sensor/serial"): CAMERA.decode(),
        ("path", f"{below}/source/settings/out"): f"{HOME}/jars of sand/take 1",
        ("serial", f"{below}/source/settings/camera"): found[
            "serial", f"{below}/source/settings/camera"
        ],
        ("host", f"{below}/source/settings/tracker/address"): "192.168.7.31",
        ("serial", f"{below}/source/settings/tracker/board_serial"): "TRK-99",
        ("host", f"{below}/source/settings/tracker/hostname"): "lab-7",
        ("gps", f"{below}/source/settings/where/latitude"): "48.1374",
        ("gps", f"{below}/source/settings/where/longitude"): "11.5755",
        ("operator", f"{below}/quality/0/message"): "Grace Hopper",
        ("user", f"{below}/quality/0/message"): "grace",
        ("email", f"{below}/quality/0/message"): "grace.h@lab.example",
        ("gps", "streams/rgb: GX010001.MP4"): found["gps", "streams/rgb: GX010001.MP4"],
        ("serial", "streams/rgb: GX010001.MP4"): found["serial", "streams/rgb: GX010001.MP4"],
        ("gps", "streams/tactile: JPEG frames"): found["gps", "streams/tactile: JPEG frames"],
        ("serial", "streams/tactile: JPEG frames"): "CAM-0042-7",
    }


def test_what_the_clip_is_found_to_hold(private: Path) -> None:
    found = {item.why: item.value for item in find_private(private) if "GX01" in item.where}
    assert found == {
        "the clip's position": "48.1, 11.6",
        "positions in the camera's telemetry (GPS5)": "48.1, 11.6",
        "positions in the camera's telemetry (GPSF)": "GPSF",
        "positions in the camera's telemetry (GPSU)": "GPSU",
        "positions in the camera's telemetry (GPSP)": "GPSP",
        "the camera's own id": bytes(range(1, 17)).hex(),
        "the lens's serial number": LENS.decode(),
        "the camera's serial number": CAMERA.decode(),
    }


def test_that_nothing_of_it_is_left(private: Path, tmp_path: Path) -> None:
    before = {path: path.read_bytes() for path in private.rglob("*") if path.is_file()}
    clean = packed_without(private, tmp_path / "a.zarr.zip")
    assert find_private(clean) == []
    raw = clean.read_bytes()
    position = np.rint(np.array(POSITION) * 1e7).astype(">i4").tobytes()
    source = pack(private, tmp_path / "source.zarr.zip").read_bytes()
    for secret in (b"Grace", b"grace", b"Building", CAMERA, LENS, b"9A8B7C6D", b"192.168", b"48.13",
                   b"CAM-0042", b"TRK-99", b"lab-7", b"EX-0007", position):  # fmt: skip
        assert secret in source
        assert secret not in raw
    # The source was only read.
    assert {path: path.read_bytes() for path in private.rglob("*") if path.is_file()} == before
    read_everything(clean)


def test_that_pictures_times_and_motion_stay(private: Path, tmp_path: Path) -> None:
    clean = packed_without(private, tmp_path / "a.zarr.zip")
    with open_episode(private) as was, open_episode(clean) as now:
        for name in was.streams:
            assert np.array_equal(was[name].frames[:], now[name].frames[:])
            assert np.array_equal(was[name].time, now[name].time)
        assert np.array_equal(was["rgb"].array("pts"), now["rgb"].array("pts"))
        files = []
        for number, episode in enumerate((was, now)):
            path = tmp_path / f"{number}.MP4"
            path.write_bytes(episode["rgb"].container())
            files.append(path)
    first, second = (read_clip(path, path.name) for path in files)
    assert first.gyro is not None
    assert second.gyro is not None
    assert np.array_equal(first.gyro.rad_per_s, second.gyro.rad_per_s)
    assert np.array_equal(first.gyro.time_s, second.gyro.time_s)
    assert first.timecode == second.timecode
    assert files[0].stat().st_size == files[1].stat().st_size
    with av.open(str(files[1])) as container:
        assert "location" not in container.metadata


def test_what_is_on_record(private: Path, tmp_path: Path) -> None:
    clean = packed_without(private, tmp_path / "a.zarr.zip")
    with open_episode(private) as was, open_episode(clean) as now:
        assert now.id == was.id
        assert now.metadata.revision == was.metadata.revision + 1
        assert now.digest() != was.digest()
        images = now["rgb"].metadata.images  # type: ignore[attr-defined]  # it is an image stream
        assert isinstance(images, VideoImages)
        assert images.files[0].sha256 == hashlib.sha256(now["rgb"].container()).hexdigest()
        steps = [one for one in now.metadata.source.lossy or [] if one.step == REMOVAL_STEP]
        assert [step.stream for step in steps] == [None, "rgb", "tactile"]
        assert (steps[1].parameters or {})["kinds"] == ["gps", "serial"]
        assert (steps[0].parameters or {})["fields"] == 13
        assert (now.metadata.source.settings or {})["out"] == "take 1"


def test_that_only_the_kinds_that_were_named_go(private: Path, tmp_path: Path) -> None:
    clean = packed_without(private, tmp_path / "a.zarr.zip", Removal(frozenset(["gps"])))
    before = [item for item in find_private(private) if item.kind != "gps"]
    # Where a removed field stood, the others keep their place.
    assert find_private(clean) == before


def test_that_folder_and_packed_form_give_the_same_bytes_each_time(
    private: Path, tmp_path: Path
) -> None:
    zipped = pack(private, tmp_path / "source.zarr.zip")
    one = packed_without(private, tmp_path / "1.zarr.zip")
    two = packed_without(zipped, tmp_path / "2.zarr.zip")
    assert one.read_bytes() == two.read_bytes()
    again = packed_without(one, tmp_path / "3.zarr.zip")
    assert again.read_bytes() == one.read_bytes()


def test_pseudonyms_by_a_key(private: Path, tmp_path: Path) -> None:
    made = []
    for key in (KEY, KEY, b"another key of 16 and more"):
        path = packed_without(private, tmp_path / "x.zarr.zip", Removal(frozenset(KINDS), key))
        with open_episode(path) as episode:
            made.append((episode.metadata.operator, episode.metadata.site))
        assert find_private(path) == []
    assert made[0] == made[1] != made[2]
    operator, site = made[0]
    assert operator is not None
    assert site is not None
    assert operator.startswith("operator-")
    assert operator.removeprefix("operator-") != site.removeprefix("site-")
    with pytest.raises(UsageError, match="16"):
        Removal(frozenset(["operator"]), b"short")


def test_an_episode_without_anything_private_stays_as_it_is(tmp_path: Path) -> None:
    path = write_episode(tmp_path / "a.zarr")
    assert find_private(path) == []
    store = open_store(path)
    assert without_private(store, EVERYTHING).store is store


def test_a_secret_that_is_also_among_the_pictures(private: Path, tmp_path: Path) -> None:
    path = clip(tmp_path / "GX010002.MP4")
    raw = bytearray(path.read_bytes())
    middle = raw.index(b"mdat") + 400
    raw[middle : middle + len(LENS)] = LENS
    path.write_bytes(raw)
    spoilt = write_private(tmp_path / "b.zarr", with_ids(path))
    with pytest.raises(UnsupportedError, match="elsewhere in the file"):
        without_private(open_store(spoilt), EVERYTHING)


def test_a_whole_dataset(private: Path, tmp_path: Path) -> None:
    root = tmp_path / "set"
    made_by = MadeBy(tool="exumi-data", tool_version="1", command=f"exumi convert {HOME}/in .")
    create_dataset(root, DatasetMetadata(name="set", licence="CC0-1.0", made_by=made_by))
    source = root.parent / "GX010001.MP4"
    with_ids(clip(source))
    write_private(root / episode_path(episode_id(0)), source)
    folder = write_private(tmp_path / "b.zarr", source, 1)
    (root / episode_path(episode_id(1), packed=True)).parent.mkdir(parents=True, exist_ok=True)
    pack(folder, root / episode_path(episode_id(1), packed=True))
    write_catalog(root, build_catalog(root)[0])
    found = find_private(root)
    paths = [episode_path(episode_id(0)), episode_path(episode_id(1), packed=True)]
    assert {item.episode for item in found} == {"", *paths}
    assert found[0].where == "dataset.json#/made_by/command"
    seen: list[int] = []
    removed = remove_private(root, EVERYTHING, on_done=seen.append)
    assert seen == [1, 2]
    assert {item.kind for item in removed} == set(KINDS)
    assert find_private(root) == []
    assert remove_private(root, EVERYTHING) == []
    dataset = open_dataset(root)  # with a catalog that is right
    assert dataset.metadata.made_by is not None
    assert dataset.metadata.made_by.command == "exumi convert in ."
    assert [one.metadata.revision for one in dataset] == [2, 2]


def test_strings_of_third_parties_and_of_keys(private: Path, tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    shutil.copytree(private, path)

    def change(exumi: dict[str, Any]) -> None:
        exumi["acme:rig"] = {f"{HOME}/x": 1, "acme:serial": 7, "host": False, "user": {"n": 1}}

    edit_metadata(path, change)
    found = [
        (item.kind, item.value) for item in private_in(open_store(path)) if "acme" in item.where
    ]
    assert found == [("path", f"{HOME}/x"), ("serial", "7")]
    clean = packed_without(path, tmp_path / "a.zarr.zip")
    kept = json.loads(members(clean)["zarr.json"])["attributes"]["exumi"]["acme:rig"]
    assert kept == {"x": 1, "host": False, "user": {"n": 1}}
    assert isinstance(open_episode(clean), Episode)
