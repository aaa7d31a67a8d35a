"""Strangers' files: every one ends in a report, soon and in bounded memory."""

import json
import os
import shutil
import struct
import tracemalloc
import zipfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import exumi_data
from exumi_data.dataset import open_dataset
from exumi_data.episode import open_episode
from exumi_data.errors import DamagedDataError, NotAnEpisodeError
from exumi_data.store.access import ZipStore
from exumi_data.store.pack import pack
from exumi_data.store.shards import ArrayWriter
from exumi_validators import validate
from exumi_validators.listing import list_folder
from tests.exumi_data.builders import edit_json, edit_metadata, write_dataset

Codes = Callable[[Path], list[str]]
CORPUS = Path(__file__).resolve().parents[2] / "spec" / "conformance" / "1.0"


def replace_root(episode: Path, data: bytes) -> None:
    (episode / "zarr.json").write_bytes(data)


@pytest.mark.parametrize(
    "data",
    [
        b"",
        b"\xff\xfe",
        b"null",
        b"[]",
        b"{" * 100_000,
        b'{"a":' * 100_000,
        b'{"a": ' + b"9" * 5_000 + b"}",
        b'{"a": 1e999, "b": Infinity}',
        b'{"a": "\\ud800"}',
        b"\x00" * 1_000,
    ],
    ids=range(10),
)
def test_a_root_that_is_no_document(episode: Path, codes: Codes, data: bytes) -> None:
    replace_root(episode, data)
    assert codes(episode) == ["DOC-001"]


def test_a_root_of_100_megabytes(episode: Path, codes: Codes) -> None:
    with (episode / "zarr.json").open("wb") as file:
        file.truncate(100 << 20)
    assert codes(episode) == ["DOC-001"]


def test_metadata_nested_as_deep_as_json_goes(episode: Path, codes: Codes) -> None:
    def nest(exumi: dict[str, object]) -> None:
        deep: object = 1
        for _ in range(600):
            deep = [deep]
        exumi["acme:deep"] = deep

    edit_metadata(episode, nest)
    assert codes(episode) == ["DOC-001"]


@pytest.mark.parametrize("value", [None, 3, "x", [], {}, [[]], {"": {}}, True])
@pytest.mark.parametrize(
    "field", ["streams", "calibration", "annotations", "source", "quality", "requires", "version"]
)
def test_fields_of_every_type(episode: Path, field: str, value: object) -> None:
    edit_metadata(episode, lambda exumi: exumi.update({field: value}))
    report = validate(episode)
    assert report.coverage.unchecked == ()


@pytest.mark.parametrize("value", [None, 3, "x", [], {}, -1, [-1], [1 << 70], "uint8"])
@pytest.mark.parametrize(
    "field",
    ["shape", "data_type", "chunk_grid", "codecs", "chunk_key_encoding", "dimension_names",
     "attributes", "fill_value", "node_type", "zarr_format", "storage_transformers"],
)  # fmt: skip
def test_array_documents_of_every_type(episode: Path, field: str, value: object) -> None:
    edit_json(episode / "streams/width/data/zarr.json", lambda node: node.update({field: value}))
    assert validate(episode).coverage.unchecked == ()


def test_names_that_are_paths(episode: Path) -> None:
    def rename(exumi: dict[str, dict[str, object]]) -> None:
        exumi["streams"]["../../evil"] = exumi["streams"].pop("width")
        exumi["calibration"] = {
            "map": {"value": None, "array": "calibration/../../../etc/passwd", "method": "guess"}
        }

    edit_metadata(episode, rename)
    report = validate(episode)
    assert report.coverage.unchecked == ()
    assert set(report.codes()) == {"META-002", "CAL-001", "HIER-001"}


def test_links_are_not_followed(episode: Path, codes: Codes) -> None:
    shard = episode / "streams/width/data/c/0"
    target = episode.parent / "elsewhere"
    shard.rename(target)
    shard.symlink_to(target)
    assert codes(episode) == ["SAFE-002", "SHARD-001"]


def test_a_folder_that_is_a_link(episode: Path) -> None:
    stream = episode / "streams/width"
    target = episode.parent / "elsewhere"
    stream.rename(target)
    stream.symlink_to(target)
    found = validate(episode).codes()
    assert found["SAFE-002"] == 1
    assert found["ARR-001"] == 3


def test_a_pipe_is_not_waited_for(episode: Path, codes: Codes) -> None:
    shard = episode / "streams/width/data/c/0"
    shard.unlink()
    os.mkfifo(shard)
    assert codes(episode) == ["SAFE-002", "SHARD-001"]


def test_names_that_mean_something_elsewhere(episode: Path, codes: Codes) -> None:
    (episode / "streams" / "a\\b").write_text("")
    (episode / "streams" / "c\nd").write_text("")
    Path(os.fsdecode(os.fsencode(episode) + b"/\xff")).write_text("")
    assert codes(episode) == ["SAFE-001"] * 3


def test_a_shape_that_asks_for_100_gigabytes(episode: Path, codes: Codes) -> None:
    def enlarge(node: dict[str, object]) -> None:
        node["shape"] = [25_000_000_000]
        node["chunk_grid"]["configuration"]["chunk_shape"] = [8192]  # type: ignore[index]
        node["codecs"][0]["configuration"]["chunk_shape"] = [8192]  # type: ignore[index]

    edit_json(episode / "streams/width/data/zarr.json", enlarge)
    tracemalloc.start()
    found = codes(episode)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert found == ["SHARD-001"]
    assert peak < 100 << 20


def test_an_index_of_a_gigabyte(episode: Path, codes: Codes) -> None:
    def divide(node: dict[str, object]) -> None:
        node["chunk_grid"]["configuration"]["chunk_shape"] = [1 << 24]  # type: ignore[index]
        node["codecs"][0]["configuration"]["chunk_shape"] = [1]  # type: ignore[index]

    edit_json(episode / "streams/width/data/zarr.json", divide)
    with (episode / "streams/width/data/c/0").open("wb") as file:
        file.truncate(1 << 30)
    assert codes(episode) == ["ZARR-010"]


def test_a_chunk_that_unpacks_to_more_than_it_may(episode: Path, codes: Codes) -> None:
    from numcodecs.zstd import Zstd

    from exumi_data.store.shards import crc32c

    bomb = bytes(Zstd(level=1, checksum=True).encode(bytes(64 << 20)))
    index = np.array([0, len(bomb)], dtype="<u8").tobytes()
    shard = bomb + index + crc32c(index).to_bytes(4, "little")
    (episode / "streams/width/data/c/0").write_bytes(shard)
    assert codes(episode) == ["SHARD-005"]


def test_a_jpeg_that_claims_to_be_huge(episode: Path) -> None:
    from tests.exumi_data.builders import jpegs

    shard = episode / "streams/tactile/data/c/0"
    data = bytearray(shard.read_bytes())
    at = data.index(b"\xff\xc0") + 5  # height and width of the first frame
    assert data[at : at + 4] == (24).to_bytes(2, "big") + (32).to_bytes(2, "big")
    data[at : at + 4] = b"\x40\x00\x40\x00"
    assert len(jpegs()[0]) > at
    shard.write_bytes(bytes(data))
    found = validate(episode).codes()
    # The frames that are left do not resemble the reference: what is said of touch is not at issue.
    assert {code: n for code, n in found.items() if not code.startswith("TACT-")} == {
        "IMG-005": 1,
        "IMG-007": 1,
    }


def test_a_playlist_in_place_of_a_video_is_not_opened(episode: Path) -> None:
    """Such lists name other files, which FFmpeg would read."""
    shard = episode / "streams/gopro/data/c/0"
    data = bytearray(shard.read_bytes())
    playlist = b"ffconcat version 1.0\nfile '/etc/hostname'\n"
    data[: len(playlist)] = playlist
    shard.write_bytes(bytes(data))
    report = validate(episode)
    assert report.codes() == {"VID-006": 1, "VID-007": 1}
    (found,) = [problem for problem in report.problems if problem.code == "VID-007"]
    assert "it is no video/mp4" in found.message


@pytest.mark.parametrize("at", [0.0, 0.1, 0.5, 0.9, 0.999])
def test_a_zip_cut_short(episode: Path, codes: Codes, at: float) -> None:
    archive = pack(episode)
    data = archive.read_bytes()
    archive.write_bytes(data[: int(len(data) * at)])
    assert codes(archive) == ["PACK-001"]


def test_a_zip_that_was_made_by_another_program(episode: Path) -> None:
    archive = episode.with_name("other.zarr.zip")
    with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as file:
        for path in sorted(episode.rglob("*")):
            file.write(path, path.relative_to(episode))
    report = validate(archive)
    assert {"PACK-002", "PACK-004", "PACK-005", "PACK-006"} == set(report.codes())
    assert report.coverage.streams == 0


def cases() -> list[Path]:
    found = [json.loads(p.read_text())["store"] for p in CORPUS.glob("valid/*/expected.json")]
    folders = sorted(p.parent for p in CORPUS.glob("valid/*/expected.json"))
    assert len(found) > 20
    return [f / json.loads((f / "expected.json").read_text())["store"] for f in folders]


def spoil(data: bytes, random: np.random.Generator) -> bytes:
    """Flip, cut, repeat or overwrite some bytes."""
    out = bytearray(data)
    way = random.integers(4)
    at = int(random.integers(max(1, len(out))))
    if way == 0 and out:
        out[at] ^= 1 << int(random.integers(8))
    elif way == 1:
        del out[at:]
    elif way == 2:
        out[at:at] = out[: int(random.integers(64))]
    else:
        out[at : at + 8] = random.bytes(8)
    return bytes(out)


@pytest.mark.parametrize("seed", range(5))
def test_spoiled_files_end_in_a_report(tmp_path: Path, seed: int) -> None:
    """Whatever bytes are changed, nothing crashes, and nothing is left unchecked."""
    random = np.random.default_rng(seed)
    stores = cases()
    for number in range(60):
        store = stores[int(random.integers(len(stores)))]
        files = [store] if store.is_file() else sorted(p for p in store.rglob("*") if p.is_file())
        chosen = files[int(random.integers(len(files)))]
        target = tmp_path / str(number) / store.name
        for file in files:
            copy = target if file == store else target / file.relative_to(store)
            copy.parent.mkdir(parents=True, exist_ok=True)
            data = file.read_bytes()
            copy.write_bytes(spoil(data, random) if file == chosen else data)
        report = validate(target, workers=1)
        assert report.coverage.unchecked == (), f"{chosen}, seed {seed}, number {number}"


# ----------------------------------------------------------------------------------- around a store


def pipe_at(path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    os.mkfifo(path)


def link_at(path: Path) -> None:
    path.parent.mkdir(exist_ok=True)
    path.unlink(missing_ok=True)
    path.symlink_to("/etc/passwd")


@pytest.mark.parametrize("make", [pipe_at, link_at])
@pytest.mark.parametrize(
    "name", ["catalog.parquet", "splits/x.json", "manifest.json", "episodes/a1/x.zarr.zip"]
)
def test_pipes_and_links_in_a_dataset(
    tmp_path: Path, make: Callable[[Path], None], name: str
) -> None:
    root = write_dataset(tmp_path / "d", 1)
    make(root / name)
    report = validate(root)
    assert report.coverage.unchecked == ()
    (found,) = [problem for problem in report.problems if problem.code == "SAFE-002"]
    assert found.location.path == name
    assert report.coverage.episodes == 1


@pytest.mark.parametrize("make", [pipe_at, link_at])
def test_a_root_document_that_is_no_file(episode: Path, make: Callable[[Path], None]) -> None:
    make(episode / "zarr.json")
    (found,) = validate(episode).problems
    assert (found.code, found.message) == ("ROOT-001", "zarr.json is a link or a special file")


def test_episodes_that_are_a_file(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 0)
    (root / "episodes").rmdir()
    (root / "episodes").write_text("")
    report = validate(root)
    assert report.codes()["SET-004"] == 1
    assert "0 episodes" in report.to_text().splitlines()[1]


def test_what_is_not_there_is_called_missing(episode: Path) -> None:
    edit_metadata(episode, lambda exumi: exumi.pop("format"))
    (found,) = (p for p in validate(episode).problems if p.code == "DOC-003")
    assert found.message == "`format` is missing, expected exumi-episode"
    assert found.found is None


def test_an_episode_that_is_a_link_is_neither_listed_nor_followed(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 2)
    (episode, _) = sorted((root / "episodes").glob("*/*"))
    episode.rename(tmp_path / "elsewhere.zarr")
    episode.symlink_to(tmp_path / "elsewhere.zarr")
    report = validate(root)
    assert report.codes()["SAFE-002"] == 1
    assert report.coverage.episodes == 1
    with pytest.warns(exumi_data.CatalogWarning):
        assert len(list(exumi_data.open(root))) == 1


def test_all_episodes_behind_a_link(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 1)
    (root / "episodes").rename(tmp_path / "elsewhere")
    (root / "episodes").symlink_to(tmp_path / "elsewhere")
    assert validate(root).codes()["SAFE-002"] == 1
    with pytest.raises(DamagedDataError, match="is a link"):
        exumi_data.open(root)


@pytest.mark.parametrize("make", [pipe_at, link_at])
def test_a_head_or_split_that_is_no_file_is_refused(
    tmp_path: Path, make: Callable[[Path], None]
) -> None:
    root = write_dataset(tmp_path / "d", 1, splits=["x"])
    make(root / "splits" / "x.json")
    opened = exumi_data.open(root)
    assert isinstance(opened, exumi_data.Dataset)
    with pytest.raises(DamagedDataError, match=r"is a link|is no file"):
        _ = opened.splits
    make(root / "dataset.json")
    with pytest.raises(DamagedDataError, match=r"is a link|is no file"):
        open_dataset(root)


@pytest.mark.parametrize("make", [pipe_at, lambda path: None])
def test_a_path_that_is_no_file_or_folder(tmp_path: Path, make: Callable[[Path], None]) -> None:
    make(tmp_path / "x.zarr.zip")
    with pytest.raises(NotAnEpisodeError):
        validate(tmp_path / "x.zarr.zip")


def test_a_folder_that_may_not_be_listed_is_said_to_be() -> None:
    # Whoever runs as root may list all; this one is not there, which takes the same path.
    assert list_folder("/nowhere").closed == {".": "No such file or directory"}


def test_a_thousand_nested_folders(episode: Path, codes: Codes) -> None:
    deep = episode / "/".join(["d"] * 900)
    deep.mkdir(parents=True)
    (deep / "x").write_text("")
    assert codes(episode) == ["SAFE-002"]
    with pytest.raises(DamagedDataError, match="nested too deeply"):
        open_episode(episode).digest()


def test_a_zip_whose_directory_fills_the_memory(tmp_path: Path) -> None:
    """Half a million entries of one empty member."""
    entry = struct.pack("<4s6H3L5H2L", b"PK\x01\x02", *[0] * 9, 1, *[0] * 6) + b"a"
    count = (20 << 20) // len(entry)
    directory = entry * count
    end = struct.pack("<4s4H2LH", b"PK\x05\x06", 0, 0, 65535, 65535, len(directory), 31, 0)
    path = tmp_path / "x.zarr.zip"
    path.write_bytes(b"PK\x03\x04" + bytes(27) + directory + end)
    tracemalloc.start()
    report = validate(path)
    with pytest.raises(DamagedDataError, match="a directory of 20,971,"):
        ZipStore(path)
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert report.codes() == {"PACK-001": 1}
    assert peak < 10 << 20


def test_a_zip_whose_members_share_their_bytes(tmp_path: Path, episode: Path) -> None:
    archive = pack(episode)
    data = bytearray(archive.read_bytes())
    starts, at = [], data.find(b"PK\x01\x02")
    while at >= 0:
        starts.append(at)
        at = data.find(b"PK\x01\x02", at + 46)
    for at in starts:  # each says that it is nearly as long as the whole file
        offset = int.from_bytes(data[at + 42 : at + 46], "little")
        length = max(0, starts[0] - offset - 400).to_bytes(4, "little")
        data[at + 20 : at + 28] = length * 2
    archive.write_bytes(data)
    with pytest.raises(DamagedDataError, match="members overlap"):
        ZipStore(archive)


# ----------------------------------------------------------------------------------------- contents


def test_a_third_party_may_mean_something_else_by_images(episode: Path) -> None:
    def change(exumi: dict[str, Any]) -> None:
        exumi["version"] = "1.9"
        exumi["streams"]["smell"]["images"] = {"encoding": "video", "files": 3}
        exumi["streams"]["pose"]["images"] = 7

    edit_metadata(episode, change)
    report = validate(episode)
    assert report.coverage.unchecked == ()
    assert set(report.codes()) <= {"META-004"}
    with open_episode(episode) as opened:
        assert not opened["smell"].is_image
        assert len(opened["pose"].data) == 5


def test_values_whose_squares_are_infinite(tmp_path: Path) -> None:
    store = tmp_path / "store.zarr"
    shutil.copytree(CORPUS / "valid" / "pose__minimal" / "store.zarr", store)
    data = store / "streams/pose/data"
    shutil.rmtree(data)
    writer = ArrayWriter(data, "f8", (7,), chunk_rows=4, zstd=True, dimension_names=("time", "xyz"))
    writer.append(np.full((4, 7), [1e308, -1e308, 0, 1e308, -1e308, 1e308, 1]))
    writer.finish()
    report = validate(store)
    assert report.coverage.unchecked == ()
    assert report.codes()["POSE-001"] == 1


def test_times_whose_difference_does_not_fit(episode: Path) -> None:
    for name, value in (("width", -(1 << 63)), ("pose", (1 << 63) - 1)):
        folder = episode / "streams" / name / "time"
        shutil.rmtree(folder)
        writer = ArrayWriter(folder, "i8", (), chunk_rows=5, zstd=True, dimension_names=("time",))
        writer.append(np.full(5, value, np.int64))
        writer.finish()
    assert validate(episode).coverage.unchecked == ()
    assert open_episode(episode).duration_s == pytest.approx(2.0**64 * 1e-9)


def test_a_split_of_a_million_mistakes(tmp_path: Path) -> None:
    root = write_dataset(tmp_path / "d", 1, splits=["x"])
    (root / "splits").mkdir()
    document = {"format": "exumi-split", "version": "1.0", "name": "x", "level": "part"}
    wrong = {**document, "lists": {"a": [{}] * 600_000}}
    (root / "splits" / "x.json").write_text(json.dumps(wrong))
    report = validate(root)
    assert report.codes()["META-002"] == 1
    assert report.coverage.unchecked == ()


def test_more_mistakes_than_anyone_reads(tmp_path: Path) -> None:
    """Half a million frames without a byte: judging each would take a minute."""
    count = 500_000
    draft = tmp_path / "store.zarr"
    shutil.copytree(CORPUS / "valid" / "images__encoded" / "store.zarr", draft)
    (stream,) = (draft / "streams").glob("[a-z]*/")
    offset = np.zeros(count + 1, "u8")
    offset[-1] = json.loads((stream / "data/zarr.json").read_text())["shape"][0]
    empty = {"time": np.arange(count), "offset": offset, "crc32c": np.zeros(count, "u4")}
    for name, rows in empty.items():
        names = ("edge",) if name == "offset" else ("time",)
        shutil.rmtree(stream / name)
        writer = ArrayWriter(
            stream / name, rows.dtype, (), chunk_rows=count + 1, zstd=True, dimension_names=names
        )
        writer.append(rows)
        writer.finish()
    report = validate(draft)
    (item,) = report.coverage.unchecked
    assert item.reason == "judging was stopped after 10,000 findings"
    assert not report.valid
    assert report.codes()["IMG-006"] == 10_000


def test_the_directory_of_a_zip_is_read_at_any_level_and_the_rest_is_not(episode: Path) -> None:
    archive = pack(episode)
    data = bytearray(archive.read_bytes())
    data[data.index(b"press")] ^= 1
    archive.write_bytes(data)
    assert "PACK-009" in validate(archive).codes()
    assert "PACK-009" not in validate(archive, levels=["hierarchy"]).codes()


def test_an_offset_that_no_file_has(episode: Path) -> None:
    """Records for large files, with a place beyond what a system call can take."""
    archive = pack(episode)
    data = archive.read_bytes()
    at = data.index(b"PK\x01\x02")
    name = int.from_bytes(data[at + 28 : at + 30], "little")
    extra = struct.pack("<2HQ", 1, 8, (1 << 64) - 1)
    spoiled = bytearray(data[: at + 46 + name] + extra + data[at + 46 + name :])
    spoiled[at + 30 : at + 32] = len(extra).to_bytes(2, "little")
    spoiled[at + 42 : at + 46] = b"\xff" * 4
    end = spoiled.rindex(b"PK\x05\x06")
    spoiled[end + 12 : end + 16] = (end - at).to_bytes(4, "little")
    archive.write_bytes(spoiled)
    assert validate(archive).codes()["PACK-007"] == 1
    with pytest.raises(DamagedDataError, match="beyond the end"):
        ZipStore(archive)
