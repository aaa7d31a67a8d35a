"""Files from strangers: one clear error each, bounded memory, and never anything but our errors."""

import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numcodecs.zstd import Zstd

from exumi_data.episode import open_episode
from exumi_data.errors import (
    DamagedDataError,
    ExumiError,
    LimitError,
    MetadataError,
    UnsupportedError,
)
from exumi_data.store import jpeg
from exumi_data.store.pack import pack
from exumi_data.store.shards import ArrayWriter, crc32c
from tests.exumi_data.builders import (
    FRAMES,
    copy_of,
    edit_json,
    edit_metadata,
    jpegs,
    pictures,
    read_everything,
    write_episode,
)

ROOT = Path(__file__).resolve().parents[3]
GB = 10**9


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return write_episode(tmp_path_factory.mktemp("original") / "a.zarr")


@pytest.fixture
def episode(original: Path, tmp_path: Path) -> Path:
    return copy_of(original, tmp_path / "a.zarr")


def rewrite(episode: Path, name: str, values: Any, **options: Any) -> None:
    """Replace an array by another one."""
    shutil.rmtree(episode / name)
    values = np.asarray(values)
    options = {"chunk_rows": 8192, "zstd": True, **options}
    writer = ArrayWriter(episode / name, values.dtype, values.shape[1:], **options)
    writer.append(values)
    writer.finish()


def layout(
    episode: Path,
    name: str,
    *,
    shape: list[int],
    shard: int | None = None,
    chunk: int | None = None,
) -> None:
    """Declare another shape, and other rows of a shard and of an inner chunk."""

    def change(document: Any) -> None:
        document["shape"] = shape
        sharding = document["codecs"][0]["configuration"]
        if shard is not None:
            document["chunk_grid"]["configuration"]["chunk_shape"] = [shard, *shape[1:]]
        if chunk is not None:
            sharding["chunk_shape"] = [chunk, *shape[1:]]

    edit_json(episode / name / "zarr.json", change)


def foreign(episode: Path, name: str, shape: list[int], chunk: list[int], dtype: str) -> None:
    """Declare an array without shards, and without a single chunk."""
    shutil.rmtree(episode / name)
    (episode / name).mkdir()
    document = {
        "zarr_format": 3,
        "node_type": "array",
        "shape": shape,
        "data_type": dtype,
        "chunk_grid": {"name": "regular", "configuration": {"chunk_shape": chunk}},
        "chunk_key_encoding": {"name": "default", "configuration": {"separator": "/"}},
        "fill_value": 0,
        "codecs": [{"name": "bytes", "configuration": {"endian": "little"}}],
        "attributes": {},
    }
    (episode / name / "zarr.json").write_text(json.dumps(document))


# ----------------------------------------------------------------------------------- 100 GB, please


def no_shards(episode: Path) -> None:
    layout(episode, "streams/width/time", shape=[100 * GB // 8])


def a_bomb(episode: Path, total: int = 100 * GB) -> None:
    """A complete array of zeros: a few MB of shards stand for 100 GB."""
    rows = (64 << 20) // 8
    frame = bytes(Zstd().encode(bytes(64 << 20)))
    count = -(-total // (64 << 20))
    layout(episode, "streams/width/time", shape=[total // 8], shard=rows * count, chunk=rows)
    index = np.array([(i * len(frame), len(frame)) for i in range(count)], "<u8").tobytes()
    shard = frame * count + index + crc32c(index).to_bytes(4, "little")
    assert len(shard) < 16 << 20
    (episode / "streams/width/time/c/0").write_bytes(shard)


def a_small_bomb(episode: Path) -> None:
    a_bomb(episode, 19 * GB // 10)


def a_giant_chunk(episode: Path) -> None:
    layout(episode, "streams/width/time", shape=[5], shard=10 * GB // 8, chunk=10 * GB // 8)


def a_giant_index(episode: Path) -> None:
    layout(episode, "streams/width/time", shape=[5], shard=100 * GB // 16, chunk=1)


def giant_frames(episode: Path) -> None:
    def change(document: Any) -> None:
        document["streams"]["tactile"]["images"].update(height=65535, width=65535)

    edit_metadata(episode, change)


def many_frames(episode: Path) -> None:
    count = 100 * GB // (24 * 32 * 3)
    rewrite(episode, "streams/rgb/time", np.arange(5))
    layout(episode, "streams/rgb/data", shape=[count, 24, 32, 3])
    a_shape(episode, "streams/rgb/time", count)


def a_shape(episode: Path, name: str, count: int) -> None:
    edit_json(episode / name / "zarr.json", lambda document: document.update(shape=[count]))


def a_giant_file(episode: Path) -> None:
    sizes = np.array([0, 100 * GB, *[100 * GB] * (FRAMES - 1)], np.uint64)
    rewrite(episode, "streams/tactile/offset", sizes)
    a_shape(episode, "streams/tactile/data", 100 * GB)


def a_giant_container(episode: Path) -> None:
    rewrite(episode, "streams/gopro/offset", np.array([0, 100 * GB], np.uint64))
    a_shape(episode, "streams/gopro/data", 100 * GB)


def a_giant_picture(episode: Path) -> None:
    """A JPEG whose header says 65500x65500."""
    file = bytearray(jpegs()[0])
    start = file.index(b"\xff\xc0") + 5
    file[start : start + 4] = (65500).to_bytes(2, "big") * 2
    assert jpeg.size_of(bytes(file)) == (65500, 65500, 3)
    content = bytes(file) + b"".join(jpegs()[1:])
    rewrite(episode, "streams/tactile/data", np.frombuffer(content, np.uint8), zstd=False)
    checksums = [crc32c(bytes(file)), *(crc32c(file) for file in jpegs()[1:])]
    rewrite(episode, "streams/tactile/crc32c", np.array(checksums, np.uint32))


def a_giant_foreign_chunk(episode: Path) -> None:
    foreign(episode, "streams/width/data", [5], [10 * GB], "float32")


def many_codecs(episode: Path) -> None:
    """A chain that would make terabytes of a kilobyte, in any reader that follows it."""
    foreign(episode, "streams/width/data", [5], [5], "float32")

    def chain(document: Any) -> None:
        document["codecs"] += [{"name": "gzip", "configuration": {"level": 1}}] * 20

    edit_json(episode / "streams/width/data/zarr.json", chain)


def sparse(episode: Path) -> None:
    """A metadata file that takes no room on disk."""
    os.truncate(episode / "streams" / "width" / "time" / "zarr.json", 100 * GB)


def a_giant_derived_array(episode: Path) -> None:
    a_shape(episode, "derived/tactile/activity", 25 * GB)


GIANTS: dict[Callable[[Path], None], type[ExumiError]] = {
    no_shards: LimitError,
    a_bomb: LimitError,
    a_small_bomb: LimitError,  # below the fixed limit, but more than there is
    a_giant_chunk: LimitError,
    a_giant_index: LimitError,
    giant_frames: LimitError,
    many_frames: DamagedDataError,
    a_giant_file: DamagedDataError,
    a_giant_container: DamagedDataError,
    a_giant_picture: DamagedDataError,
    a_giant_foreign_chunk: UnsupportedError,
    many_codecs: UnsupportedError,
    sparse: LimitError,
    a_giant_derived_array: LimitError,
}

READ = """
import json, resource, sys
from pathlib import Path
import av, cv2
from exumi_data.episode import open_episode
from exumi_data.errors import ExumiError
from tests.exumi_data.builders import read_everything

def frames(path):
    for stream in open_episode(path).of_kind("tactile") + open_episode(path).of_kind("rgb"):
        stream.frames[:]

def container(path):
    open_episode(path)["gopro"].container()

root = Path(sys.argv[1])
read_everything(root / "original.zarr")  # what is loaded lazily is loaded now
pages = int(Path("/proc/self/statm").read_text().split()[0])
limit = pages * resource.getpagesize() + (600 << 20)
resource.setrlimit(resource.RLIMIT_AS, (limit, limit))
found = {}
for path in sorted(root.glob("*.zarr*")):
    for read in (read_everything, frames, container):
        try:
            read(path)
        except Exception as error:
            found.setdefault(path.name.partition(".")[0], []).append(
                [type(error).__name__, isinstance(error, ExumiError), str(error)])
    assert path.name.startswith("original") or path.name.partition(".")[0] in found, path
# Not ru_maxrss, which begins at what the parent had.
(peak,) = [line for line in Path("/proc/self/status").read_text().splitlines() if "VmHWM" in line]
found["peak"] = int(peak.split()[1]) * 1024
print(json.dumps(found))
"""


@pytest.mark.parametrize("packed", [False, True], ids=["folder", "zip"])
def test_a_small_file_cannot_ask_for_100_gb(original: Path, tmp_path: Path, packed: bool) -> None:
    if not Path("/proc/self/statm").exists():
        pytest.skip("this system does not say how much memory a process has")
    # A member of a zip cannot be larger than the zip.
    giants = {make: kind for make, kind in GIANTS.items() if not packed or make is not sparse}
    copy_of(original, tmp_path / "original.zarr")
    for make in giants:
        path = copy_of(original, tmp_path / f"{make.__name__}.zarr")
        make(path)
        if packed:
            pack(path)
            shutil.rmtree(path)
    done = subprocess.run(
        [sys.executable, "-W", "error", "-c", READ, str(tmp_path)],
        check=False,
        capture_output=True,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("peak") < 800 << 20
    assert found.keys() == {make.__name__ for make in giants}
    for make, kind in giants.items():
        for name, is_ours, message in found[make.__name__]:
            assert is_ours, (make.__name__, name, message)
            assert message.startswith(str(tmp_path)), message
        assert kind.__name__ in [name for name, _, _ in found[make.__name__]], make


# ----------------------------------------------------------------------------------------- contents


def offsets(values: list[int]) -> Callable[[Path], None]:
    return lambda episode: rewrite(episode, "streams/tactile/offset", np.array(values, np.uint64))


def total(files: tuple[bytes, ...] = jpegs()) -> int:
    return sum(map(len, files))


def wrong_checksum(episode: Path) -> None:
    rewrite(episode, "streams/tactile/crc32c", np.zeros(FRAMES, np.uint32))


def swapped_picture(episode: Path) -> None:
    """A picture of another size, with the right checksum."""
    files = [*jpegs()[:-1], jpeg.encode(pictures(1, height=48)[0], 50)]
    content = np.frombuffer(b"".join(files), np.uint8)
    rewrite(episode, "streams/tactile/data", content, zstd=False)
    offset = np.cumsum([0, *map(len, files)], dtype=np.uint64)
    rewrite(episode, "streams/tactile/offset", offset)
    sums = [crc32c(file) for file in files]
    rewrite(episode, "streams/tactile/crc32c", np.array(sums, np.uint32))


def no_picture(episode: Path) -> None:
    content = np.random.default_rng(0).integers(0, 256, total(), dtype=np.uint8)
    rewrite(episode, "streams/tactile/data", content, zstd=False)
    offset = np.cumsum([0, *map(len, jpegs())])
    sums = [crc32c(content[a:b].tobytes()) for a, b in pairwise(offset)]
    rewrite(episode, "streams/tactile/crc32c", np.array(sums, np.uint32))


def array(name: str, values: Any) -> Callable[[Path], None]:
    return lambda episode: rewrite(episode, name, values)


def missing(name: str) -> Callable[[Path], None]:
    return lambda episode: shutil.rmtree(episode / name)


def images(**changes: Any) -> Callable[[Path], None]:
    def change(document: Any) -> None:
        document["streams"]["tactile"]["images"].update(changes)

    return lambda episode: edit_metadata(episode, change)


WRONG: list[tuple[Callable[[Path], None], str]] = [
    (offsets([0, 5, 4, 7, 8, 9]), "`offset` does not ascend within `data`"),
    (offsets([1, 2, 3, 4, 5, 6]), "`offset` does not ascend within `data`"),
    (offsets([0, 1, 2, 3, 4, total() + 1]), "`offset` does not ascend within `data`"),
    (offsets([0, 1, 2, 3, 4, 2**64 - 1]), "`offset` does not ascend within `data`"),
    (offsets([0, 1, 2, 3]), r"`offset` has shape \(4,\)"),
    (array("streams/tactile/offset", np.zeros(6)), "`offset` has shape"),
    (array("streams/tactile/offset", np.zeros((6, 1), np.uint64)), "`offset` has shape"),
    (offsets([0] * 6), "frame 0 has a wrong checksum"),
    (wrong_checksum, "frame 0 has a wrong checksum"),
    (array("streams/tactile/crc32c", np.zeros(4, np.uint32)), "`crc32c` does not match"),
    (array("streams/tactile/crc32c", np.zeros(5, np.int64)), "`crc32c` does not match"),
    (array("streams/tactile/data", np.zeros(9000, np.int16)), "`data` is not one-dimensional"),
    (array("streams/tactile/data", np.zeros((9000, 1), np.uint8)), "`data` is not one-dimensional"),
    (swapped_picture, "frame 4: the JPEG is 32x48, the metadata says 32x24"),
    (no_picture, "frame 0: "),
    (images(height=25), "frame 0: the JPEG is 32x24, the metadata says 32x25"),
    (images(height=23), "frame 0: the JPEG is 32x24, the metadata says 32x23"),
    (images(height=0), r"@ \$\.streams\.tactile\.images\.height"),
    (images(height=-1), r"@ \$\.streams\.tactile\.images\.height"),
    (images(channels=2), r"@ \$\.streams\.tactile\.images\.channels"),
    (images(media_type="image/png"), r"@ \$\.streams\.tactile\.images\.media_type"),
    (images(encoding="zip"), r"@ \$\.streams\.tactile\.images"),
    (array("streams/rgb/data", np.zeros((5, 24, 32, 1), np.uint8)), "`data` has shape"),
    (array("streams/rgb/data", np.zeros((5, 24, 32, 3), np.int8)), "`data` has shape"),
    (array("streams/rgb/data", np.zeros((4, 24, 32, 3), np.uint8)), "`data` has shape"),
    (array("streams/gopro/offset", np.array([5, 0], np.uint64)), "`offset` does not ascend"),
    (array("streams/gopro/offset", np.array([0, 10**6], np.uint64)), "outside the array"),
    (array("streams/gopro/offset", np.array([0, 5, 9], np.uint64)), "`offset` does not match"),
    (array("streams/gopro/file", np.array([0, 0, 1, 0, 0], np.uint32)), "`file` does not ascend"),
    (array("streams/gopro/file", np.array([0, 0, 0, 0, 7], np.uint32)), "`file` does not ascend"),
    (array("streams/gopro/keyframe", np.full(5, 9, np.uint64)), "`keyframe` points forward"),
    (array("streams/gopro/keyframe", np.zeros(5, np.int64)), "`keyframe` has shape"),
    (array("streams/gopro/pts", np.arange(5) * 7 + 3), "cannot be decoded"),
    (array("streams/gopro/pts", np.full(5, 2**62)), "cannot be decoded"),
    (array("streams/gopro/data", np.zeros(20_000, np.uint8)), "not a readable video"),
    (array("streams/width/time", np.zeros(5)), r"`time` is \(5,\) float64"),
    (array("streams/width/time", np.zeros((5, 1), np.int64)), r"`time` is \(5, 1\) int64"),
    (array("streams/tactile/time", np.arange(7)), "expected"),
    (array("derived/tactile/activity", np.zeros(3, np.float32)), r"activity of \(3,\) for 5"),
    (missing("streams/tactile/crc32c"), "crc32c: array is missing"),
    (missing("streams/tactile/data/c"), "shard is missing"),
    (missing("derived/tactile/salient"), "salient: array is missing"),
]


@pytest.mark.parametrize(("spoil", "message"), WRONG)
def test_contents_that_contradict_each_other(
    episode: Path, spoil: Callable[[Path], None], message: str
) -> None:
    spoil(episode)
    with pytest.raises((DamagedDataError, MetadataError, ExumiError), match=message) as caught:
        read_everything(episode)
    assert str(episode) in str(caught.value)


def test_a_damaged_frame_does_not_hide_the_others(episode: Path) -> None:
    shard = episode / "streams" / "tactile" / "data" / "c" / "0"
    content = bytearray(shard.read_bytes())
    content[len(jpegs()[0]) + 100] ^= 1
    shard.write_bytes(content)
    frames = open_episode(episode)["tactile"].frames
    with pytest.raises(DamagedDataError, match="frame 1 has a wrong checksum"):
        _ = frames[1]
    assert frames[[0, 2, 3, 4]].shape == (4, 24, 32, 3)


# --------------------------------------------------------------------------------------------- fuzz


def test_any_flipped_byte_gives_our_error_or_none(episode: Path) -> None:
    files = sorted(path for path in episode.rglob("*") if path.is_file())
    generator = np.random.default_rng(20)
    outcomes = {"read": 0, "refused": 0}
    for number in range(250):
        path = files[number % len(files)]
        content = path.read_bytes()
        changed = bytearray(content)
        position = int(generator.integers(len(content)))
        changed[position] ^= int(generator.integers(1, 256))
        path.write_bytes(changed)
        try:
            read_everything(episode)
        except ExumiError:
            outcomes["refused"] += 1
        else:
            outcomes["read"] += 1
            assert not path.match("streams/tactile/data/c/0"), position
        path.write_bytes(content)
    read_everything(episode)
    assert outcomes["refused"] > outcomes["read"] > 0, outcomes


def test_any_flipped_byte_of_a_zip(episode: Path) -> None:
    packed = pack(episode)
    content = packed.read_bytes()
    directory = content.index(b"PK\x01\x02")
    generator = np.random.default_rng(21)
    # Half of them in the directory at the end, where a flip changes most.
    positions = [
        *generator.integers(0, directory, 60),
        *generator.integers(directory, len(content), 140),
    ]
    refused = 0
    for position in positions:
        changed = bytearray(content)
        changed[position] ^= int(generator.integers(1, 256))
        packed.write_bytes(changed)
        try:
            read_everything(packed)
        except ExumiError:
            refused += 1
    assert refused > 60


def test_files_cut_short_give_our_error_or_none(episode: Path) -> None:
    refused = 0
    files = sorted(path for path in episode.rglob("*") if path.is_file())
    for path in files:
        content = path.read_bytes()
        for length in (0, len(content) // 2, len(content) - 2):
            path.write_bytes(content[:length])
            try:
                read_everything(episode)
            except ExumiError:
                refused += 1
        path.write_bytes(content)
    # The documents of groups below the root say nothing, and are not read.
    groups = [p for p in files if p.name == "zarr.json" and b'"group"' in p.read_bytes()]
    assert refused >= 3 * (len(files) - len(groups))
