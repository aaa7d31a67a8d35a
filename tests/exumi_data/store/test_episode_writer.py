"""An episode is there whole or not at all, whatever happens while it is written."""

import gc
import json
import os
import signal
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import zarr

from exumi_data.episode import open_episode
from exumi_data.errors import (
    EpisodeExistsError,
    MetadataError,
    NotAnEpisodeError,
    UnsupportedError,
    UsageError,
)
from exumi_data.model import (
    CalibrationItem,
    DerivedMetadata,
    ExtensionStream,
    QualityNote,
    TactileStream,
)
from exumi_data.store import files
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.shards import open_array
from tests.exumi_data.builders import (
    CLOCK,
    add_images,
    add_low_dimensional,
    array_images,
    encoded_images,
    episode_id,
    jpegs,
    metadata,
    pictures,
    times,
    write_episode,
    write_small,
)


def names(folder: Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def started(path: Path, **options: Any) -> EpisodeWriter:
    """A writer in the middle of its work."""
    writer = EpisodeWriter(path, metadata(), durable=False, **options)
    add_low_dimensional(writer)
    add_images(writer)
    return writer


# --------------------------------------------------------------------------------------- as it goes


def test_the_final_name_appears_at_the_end(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    with EpisodeWriter(path, metadata()) as writer:
        assert names(tmp_path) == [f".partial-{episode_id()}"]
        with pytest.raises(NotAnEpisodeError):
            open_episode(path)
        add_images(writer)
        assert not (tmp_path / f".partial-{episode_id()}" / "zarr.json").exists()
    assert names(tmp_path) == ["a.zarr"]
    open_episode(path).check_complete()
    assert writer.finish() == path  # again: it is done
    writer.abort()
    assert names(tmp_path) == ["a.zarr"]


def test_half_an_episode_is_not_opened(tmp_path: Path) -> None:
    writer = started(tmp_path / "a.zarr")
    with pytest.raises(Exception, match="an episode that was never finished"):
        open_episode(tmp_path / f".partial-{episode_id()}")
    writer.abort()
    assert names(tmp_path) == []


@pytest.mark.parametrize("error", [ValueError("mine"), KeyboardInterrupt(), SystemExit(3)])
def test_an_exception_leaves_nothing(tmp_path: Path, error: BaseException) -> None:
    def write() -> None:
        with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
            add_images(writer)
            raise error

    with pytest.raises(type(error)):
        write()
    assert names(tmp_path) == []


def test_a_finished_or_abandoned_writer_takes_no_more(tmp_path: Path) -> None:
    finished = EpisodeWriter(tmp_path / "a.zarr", metadata())
    stream = finished.add_stream("width", kind="width", clock=CLOCK)
    finished.finish()
    abandoned = EpisodeWriter(tmp_path / "b.zarr", metadata(1))
    abandoned.abort()
    for writer in (finished, abandoned):
        with pytest.raises(UsageError, match="finished or was given up"):
            writer.add_stream("pose", kind="width", clock=CLOCK)
        with pytest.raises(UsageError, match="finished or was given up"):
            writer.add_derived("a", "b", np.zeros(3), algorithm="x/1")
    with pytest.raises(UsageError):
        stream.append(0, 0.1)
    assert names(tmp_path) == ["a.zarr"]


def test_lists_that_are_filled_in_place_are_written(tmp_path: Path) -> None:
    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        writer.metadata.quality.append(QualityNote(code="dark", message="It was dark"))
        writer.metadata.calibration["mm_per_px"] = CalibrationItem(value=[0.1, 0.1])
    written = open_episode(tmp_path / "a.zarr").metadata
    assert [note.code for note in written.quality] == ["dark"]
    assert written.calibration["mm_per_px"].value == [0.1, 0.1]


# ---------------------------------------------------------------------------------- wrong arguments


BAD_NAMES = [
    "",
    "..",
    "../../evil",
    "a/b",
    "/evil",
    "Upper",
    "1st",
    "a" * 65,
    "ä",
    "a\n",
    "a b",
]


@pytest.mark.parametrize("name", BAD_NAMES)
def test_names_that_are_none(tmp_path: Path, name: str) -> None:
    (tmp_path / "in" / "side").mkdir(parents=True)
    with EpisodeWriter(tmp_path / "in" / "side" / "a.zarr", metadata()) as writer:
        writer.add_stream("width", kind="width", clock=CLOCK)
        for add in (
            lambda: writer.add_stream(name, kind="width", clock=CLOCK),
            lambda: writer.add_derived(name, "activity", np.zeros(3), algorithm="x/1"),
            lambda: writer.add_derived("width", name, np.zeros(3), algorithm="x/1"),
        ):
            with pytest.raises(UsageError, match="is no name"):
                add()
    assert names(tmp_path) == ["in"]
    assert names(tmp_path / "in") == ["side"]
    assert list(open_episode(tmp_path / "in" / "side" / "a.zarr")) == ["width"]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ({"kind": "video"}, "unknown stream kind"),
        ({"kind": "pose"}, r"required field missing @ \$\.streams\.s\.frames"),
        ({"kind": "rgb"}, r"required field missing @ \$\.streams\.s\.images"),
        ({"kind": "width", "colour": "red"}, "unknown key 'colour'"),
        ({"kind": "taxels", "grid": [2.0, 3], "unit": "adc"}, r"@ \$\.streams\.s\.grid"),
        ({"kind": "acme:x"}, "required field missing"),
    ],
)
def test_fields_are_checked_at_once(tmp_path: Path, fields: dict[str, Any], message: str) -> None:
    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        with pytest.raises(MetadataError, match=message) as caught:
            writer.add_stream("s", **fields)
        assert caught.value.problems
        writer.add_stream("s", kind="width", clock=CLOCK)
        with pytest.raises(UsageError, match="stream 's' is there already"):
            writer.add_stream("s", kind="width", clock=CLOCK)


def test_frames_that_could_not_be_read_again_are_refused(tmp_path: Path) -> None:
    images: dict[str, Any] = {"encoding": "array", "height": 20_000, "width": 20_000, "channels": 3}
    with (
        EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer,
        pytest.raises(UsageError, match="frames of 20000x20000 are larger"),
    ):
        writer.add_stream("s", kind="rgb", clock=CLOCK, images=images)


@pytest.mark.parametrize(
    "values", [np.float32(3), np.array(["a"]), np.array([None]), np.zeros(3, complex)], ids=str
)
def test_derived_arrays_that_cannot_be_stored(tmp_path: Path, values: Any) -> None:
    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        writer.add_stream("s", kind="width", clock=CLOCK)
        with pytest.raises(UsageError, match="cannot be stored"):
            writer.add_derived("s", "activity", values, algorithm="x/1")


@pytest.mark.parametrize(
    ("spoil", "error"),
    [
        (lambda w: w.metadata.requires.append("acme-feature"), UnsupportedError),
        (lambda w: w.add_derived("no", "activity", np.zeros(3), algorithm="x/1"), UsageError),
        (
            lambda w: w.add_derived(
                "rgb", "salient", np.zeros(3), algorithm="x/1", parameters={"a": float("nan")}
            ),
            MetadataError,
        ),
        (
            lambda w: w.metadata.calibration.update(a=CalibrationItem(value=float("inf"))),
            MetadataError,
        ),
        (
            lambda w: w.metadata.calibration.update(a=CalibrationItem(value=np.zeros(3))),
            MetadataError,
        ),
        (lambda w: w.metadata.calibration.update(a=CalibrationItem(value="\udc80")), MetadataError),
    ],
)
def test_what_could_not_be_read_again_is_never_written(
    tmp_path: Path, spoil: Any, error: type[Exception]
) -> None:
    def write() -> None:
        with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
            add_images(writer)
            spoil(writer)

    with pytest.raises(error):
        write()
    assert names(tmp_path) == []


@pytest.mark.parametrize(
    ("name", "message"),
    [
        ("activty", "means nothing: expected activity, salient or <vendor>__<name>"),
        ("acme_slip", "means nothing"),
        ("acme__", "means nothing"),
        ("activity", "computed from streams of the kind tactile"),
    ],
)
def test_derived_arrays_that_mean_nothing_are_refused(
    tmp_path: Path, name: str, message: str
) -> None:
    """Whatever the validator calls DRV-007 is refused; of a kind, once the stream is known."""

    def write() -> None:
        with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
            writer.add_derived("width", name, np.zeros(3, np.float32), algorithm="x/1")
            writer.add_stream("width", kind="width", clock=CLOCK)

    with pytest.raises(UsageError, match=message) as caught:
        write()
    assert "<vendor>__<name>" in str(caught.value)
    assert names(tmp_path) == []


def test_derived_arrays_of_third_parties_and_of_newer_versions_are_written(tmp_path: Path) -> None:
    values = np.zeros(3, np.float32)
    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        writer.add_stream("width", kind="width", clock=CLOCK)
        writer.add_derived("width", "acme__speed", values, algorithm="x/1")
    with EpisodeWriter(tmp_path / "b.zarr", metadata(1)) as writer:
        read: Any = {"format": "exumi-derived", "version": "1.7", "items": {}}
        writer.derived = DerivedMetadata.model_validate(read, context={"newer_minor": True})
        writer.add_stream("width", kind="width", clock=CLOCK)
        writer.add_derived("width", "roughness", values, algorithm="x/1")
    for name, key in (("a", "width/acme__speed"), ("b", "width/roughness")):
        with open_episode(tmp_path / f"{name}.zarr") as episode:
            assert episode.derived is not None
            assert list(episode.derived.items) == [key]


def test_derived_arrays_are_taken_over_with_what_is_said_of_them(tmp_path: Path) -> None:
    values = np.arange(4, dtype=np.float32)
    with EpisodeWriter(tmp_path / "a.zarr", metadata()) as writer:
        writer.add_stream("width", kind="width", clock=CLOCK)
        writer.derived = DerivedMetadata.model_validate({"items": {}, "acme:by": "hand"})
        said: dict[str, Any] = {"parameters": {"k": 2}, "inputs": ["streams/width/data"]}
        said["acme:weather"] = "rain"
        writer.add_derived("width", "acme__speed", values, algorithm="x/1", **said)
    with open_episode(tmp_path / "a.zarr") as before:
        with EpisodeWriter(tmp_path / "b.zarr", metadata(1)) as writer:
            writer.copy_stream(before, "width")
            writer.copy_derived(before)
        with open_episode(tmp_path / "b.zarr") as after:
            assert after.derived == before.derived
            assert after.derived is not None
            assert after.derived.items["width/acme__speed"].parameters == {"k": 2}
            copied = after.derived_array("width/acme__speed")
            assert copied is not None
            np.testing.assert_array_equal(copied, values)


def test_the_name_of_an_episode(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"ends in \.zarr"):
        EpisodeWriter(tmp_path / "a.zip", metadata())
    assert names(tmp_path) == []


# -------------------------------------------------------------------------------------- overwriting


def test_the_old_one_stays_until_the_new_one_is_complete(tmp_path: Path) -> None:
    path = write_small(tmp_path / "a.zarr")
    with pytest.raises(EpisodeExistsError, match=r"a\.zarr: already exists"):
        EpisodeWriter(path, metadata())
    before = open_episode(path).digest()
    started(path, overwrite=True).abort()
    assert open_episode(path).digest() == before
    writer = started(path, overwrite=True)
    assert open_episode(path).digest() == before
    writer.finish()
    assert open_episode(path).digest() != before
    assert "gopro" in open_episode(path)
    assert names(tmp_path) == ["a.zarr"]


def test_what_else_has_the_name_is_replaced_only_on_request(tmp_path: Path) -> None:
    (tmp_path / "file.zarr").write_bytes(b"a file")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "link.zarr").symlink_to(tmp_path / "elsewhere")
    for name in ("file.zarr", "link.zarr"):
        with pytest.raises(EpisodeExistsError):
            EpisodeWriter(tmp_path / name, metadata())
        for _ in range(2):
            started(tmp_path / name, overwrite=True).finish()
            open_episode(tmp_path / name).check_complete()
    assert names(tmp_path) == ["elsewhere", "file.zarr", "link.zarr"]
    assert names(tmp_path / "elsewhere") == []


def test_an_episode_that_another_process_finished_meanwhile_stays(tmp_path: Path) -> None:
    writer = started(tmp_path / "a.zarr")
    write_small(tmp_path / "a.zarr", 7)
    with pytest.raises(EpisodeExistsError, match="by another process meanwhile"):
        writer.finish()
    writer.abort()
    assert open_episode(tmp_path / "a.zarr").id == episode_id(7)
    assert names(tmp_path) == ["a.zarr"]


@pytest.mark.parametrize("step", [1, 2])
def test_an_end_between_the_two_renames_loses_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, step: int
) -> None:
    path = write_small(tmp_path / "a.zarr")
    writer = started(path, overwrite=True)
    rename, calls = Path.rename, []

    def interrupted(self: Path, target: Path) -> Path:
        calls.append(target)
        if len(calls) == step:
            raise KeyboardInterrupt
        return rename(self, target)

    with monkeypatch.context() as patch:
        patch.setattr(Path, "rename", interrupted)
        try:
            writer.finish()
        except KeyboardInterrupt:
            pass
        else:
            pytest.fail("nothing was renamed")
    aside = tmp_path / ".replaced-a.zarr"
    kept = path if step == 1 else aside
    assert open_episode(kept).id == episode_id()
    writer.abort()
    started(path, overwrite=True).finish()  # the next run succeeds
    assert "gopro" in open_episode(path)
    assert names(tmp_path) == ["a.zarr"]


# ---------------------------------------------------------------------------------- several writers


def test_an_episode_has_one_writer_at_a_time(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    first = started(path)
    with pytest.raises(UsageError, match="is being written by another process"):
        EpisodeWriter(path, metadata())
    other = EpisodeWriter(tmp_path / "b.zarr", metadata(1))  # another episode, the same folder
    first.finish()
    other.abort()
    open_episode(path).check_complete()
    abandoned = started(path, overwrite=True)
    abandoned.abort()
    started(path, overwrite=True).finish()


def test_a_writer_that_is_dropped_lets_go(tmp_path: Path) -> None:
    dropped = EpisodeWriter(tmp_path / "a.zarr", metadata())
    dropped.add_stream("width", kind="width", clock=CLOCK).append(0, 0.1)
    del dropped
    gc.collect()
    with EpisodeWriter(tmp_path / "a.zarr", metadata(), durable=False):
        assert names(tmp_path / f".partial-{episode_id()}") == ["streams"]  # nothing old is left
    assert list(open_episode(tmp_path / "a.zarr")) == []


def test_a_folder_is_claimed_whatever_is_there(tmp_path: Path) -> None:
    (tmp_path / "a" / "b").mkdir(parents=True)
    (tmp_path / "a" / "file").write_bytes(b"x")
    (tmp_path / "a" / "link").symlink_to(tmp_path)
    claim = files.claim_folder(tmp_path / "a")
    assert names(tmp_path / "a") == []
    with pytest.raises(UsageError):
        files.claim_folder(tmp_path / "a")
    os.close(claim)
    os.close(files.claim_folder(tmp_path / "a"))


# ---------------------------------------------------------------------------- in processes that end


WRITER = """
import os, random, signal, sys, time
from pathlib import Path
import numpy as np
from exumi_data.episode import open_episode
from exumi_data.model import ArrayImages, Clock, EncodedImages, EpisodeMetadata, Source, Task
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

path = Path(sys.argv[1]) / "a.zarr"
metadata = EpisodeMetadata(
    id="0190a1b2-0000-7000-8000-000000000000", task=Task(name="x"), regime="play",
    licence="CC0-1.0",
    source=Source(type="simulated", tool="tests", tool_version="1"))
clock = Clock(source="simulation", stamp_point="simulated")

def images(writer, side=64):
    size = dict(height=side, width=side, channels=3)
    return (
        writer.add_stream("raw", kind="rgb", clock=clock,
                          images=ArrayImages(encoding="array", **size)),
        writer.add_stream("jpeg", kind="rgb", clock=clock, images=EncodedImages(
            encoding="encoded", media_type="image/jpeg", **size)))

frame = np.random.default_rng(0).integers(0, 256, (64, 64, 3), dtype=np.uint8)
file = jpeg.encode(frame, 95)

def write(count, **options):
    with EpisodeWriter(path, metadata, durable=False, **options) as writer:
        raw, encoded = images(writer)
        writer.add_stream("width", kind="width", clock=clock).append(range(1000), np.zeros(1000))
        writer.add_derived("raw", "salient", np.arange(9), algorithm="x/1")
        for index in range(count):
            raw.append(index, frame)
            encoded.append(index, file)

def frames_in(path):
    episode = open_episode(path)
    episode.check_complete()
    return len(episode["jpeg"].frames[:])
"""


def run(script: str, folder: Path, **options: Any) -> subprocess.CompletedProcess[str]:
    """Run a program that writes an episode into a folder."""
    command = [sys.executable, "-W", "error", "-c", WRITER + script, str(folder)]
    return subprocess.run(command, check=False, capture_output=True, text=True, **options)


# A child is killed at moments spread over the whole time that it needs, and a little longer.
KILLED = """
import json
overwrite = sys.argv[2] == "overwrite"
if overwrite:
    write(5)
begin = time.monotonic()
write(30, overwrite=True)
needed = time.monotonic() - begin
trials, found = 30, {"absent": 0, "old": 0, "new": 0}
for trial in range(trials):
    if overwrite:
        write(5, overwrite=True)
    else:
        os.rename(path, path.with_name("gone.zarr")) if path.exists() else None
        __import__("shutil").rmtree(path.with_name("gone.zarr"), ignore_errors=True)
    child = os.fork()
    if not child:
        write(30, overwrite=overwrite)
        os._exit(0)
    time.sleep(3 * needed * trial / trials)
    if trial >= trials - 3:  # however slow the machine has become: it has ended then
        os.waitid(os.P_PID, child, os.WEXITED | os.WNOWAIT)
    os.kill(child, signal.SIGKILL)
    os.waitpid(child, 0)
    if path.exists():
        count = frames_in(path)
        assert count in (5, 30), count
        found["old" if count == 5 else "new"] += 1
    else:
        aside = path.with_name(".replaced-a.zarr")
        assert not overwrite or frames_in(aside) == 5
        found["absent"] += 1
write(30, overwrite=True)
assert frames_in(path) == 30
found["left"] = sorted(os.listdir(path.parent))
print(json.dumps(found))
"""


@pytest.mark.parametrize("mode", ["new", "overwrite"])
def test_killed_at_any_moment_it_is_absent_or_complete(tmp_path: Path, mode: str) -> None:
    # Warnings are allowed: forking beside the threads of a linear algebra library gives one.
    command = [sys.executable, "-c", WRITER + KILLED, str(tmp_path), mode]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    found = json.loads(done.stdout)
    assert found.pop("left") == ["a.zarr"]
    before = found["absent"] if mode == "new" else found["old"]
    assert before > 0, found
    assert found["new"] > 0, found


INTERRUPTED = """
def report(*_):
    print("ready", flush=True)
with EpisodeWriter(path, metadata) as writer:
    raw, encoded = images(writer)
    for index in range(10**9):
        encoded.append(index, file)
        if index == 20:
            report()
"""


@pytest.mark.parametrize("stop", [signal.SIGINT, signal.SIGKILL])
def test_ctrl_c_removes_what_was_written_and_a_kill_leaves_no_claim(
    tmp_path: Path, stop: signal.Signals
) -> None:
    command = [sys.executable, "-c", WRITER + INTERRUPTED, str(tmp_path)]
    with subprocess.Popen(
        command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True
    ) as child:
        assert child.stdout is not None
        assert child.stdout.readline() == "ready\n"
        child.send_signal(stop)
        child.communicate(timeout=60)
    left = [] if stop == signal.SIGINT else [".partial-0190a1b2-0000-7000-8000-000000000000"]
    assert names(tmp_path) == left
    done = run("write(3)\nassert frames_in(path) == 3", tmp_path)
    assert done.returncode == 0, done.stderr
    assert names(tmp_path) == ["a.zarr"]


FULL = """
import resource
if len(sys.argv) > 2:
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv[2]),) * 2)
try:
    write(1000)
except OSError as error:
    print(error.errno, sorted(os.listdir(path.parent)))
"""


@pytest.mark.parametrize("limit", [300, 20_000, 200_000])
def test_a_file_that_cannot_grow_leaves_nothing(tmp_path: Path, limit: int) -> None:
    import errno

    command = [sys.executable, "-W", "error", "-c", WRITER + FULL, str(tmp_path), str(limit)]
    done = subprocess.run(command, check=False, capture_output=True, text=True)
    assert done.stdout == f"{errno.EFBIG} []\n", done.stderr
    assert done.stderr == ""


def test_a_full_disk_leaves_nothing(tmp_path: Path) -> None:
    import errno

    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(tmp_path)]
    try:
        mounted = subprocess.run(mount, check=False, capture_output=True).returncode == 0
    except FileNotFoundError:
        mounted = False
    if not mounted:
        pytest.skip("a small file system cannot be mounted here")
    try:
        done = run(FULL, tmp_path)
        assert done.stdout == f"{errno.ENOSPC} []\n", done.stderr
        assert done.stderr == ""
        done = run("write(3)\nassert frames_in(path) == 3", tmp_path)
        assert done.returncode == 0, done.stderr
        # What is there stays there when the next one does not fit beside it.
        done = run(FULL.replace("write(1000)", "write(1000, overwrite=True)"), tmp_path)
        assert done.stdout == f"{errno.ENOSPC} ['a.zarr']\n", done.stderr
        assert len(open_episode(tmp_path / "a.zarr")["jpeg"].frames) == 3
    finally:
        subprocess.run(["umount", str(tmp_path)], check=True)


MEMORY = """
write(1)
frame = np.random.default_rng(0).integers(0, 256, (512, 512, 3), dtype=np.uint8)
file = jpeg.encode(frame, 98)
def peak():  # not ru_maxrss, which begins at what the parent had
    lines = Path("/proc/self/status").read_text().splitlines()
    return int(next(line for line in lines if "VmHWM" in line).split()[1])
with EpisodeWriter(path.with_name("b.zarr"), metadata, durable=False) as writer:
    raw, encoded = images(writer, 512)
    taxels = writer.add_stream("taxels", kind="taxels", clock=clock, grid=[64, 64], unit="adc")
    before = peak()
    for index in range(25):
        raw.append(np.arange(10) + 10 * index, np.broadcast_to(frame, (10, *frame.shape)))
    for index in range(250, 280):
        raw.append(index, frame)
    for index in range(200_000_000 // len(file)):
        encoded.append(index, file)
    for index in range(100):
        taxels.append(np.arange(100) + 100 * index, np.ones((100, 64, 64), np.float32))
print((peak() - before) / 1024)
"""


def test_memory_is_bounded_however_much_is_written(tmp_path: Path) -> None:
    if not Path("/proc/self/status").exists():
        pytest.skip("this system does not say how much memory a process has")
    # 220 MB as raw frames, 200 MB as JPEG files, 160 MB as taxels.
    done = run(MEMORY, tmp_path)
    assert done.returncode == 0, done.stderr
    assert float(done.stdout) < 60


def test_extension_streams_keep_their_fields(tmp_path: Path) -> None:
    episode = open_episode(write_episode(tmp_path / "a.zarr"))
    stream = episode["smell"].metadata
    assert isinstance(stream, ExtensionStream)
    assert stream.schema_url == "https://acme.example/smell.json"
    assert episode["smell"].data.tolist() == [0, 1, 2, 3, 4]
    assert times().tolist() == episode["smell"].time.tolist()
    assert array_images().encoding == "array"


def test_calibration_arrays_and_keys_of_third_parties_are_written(tmp_path: Path) -> None:
    path = tmp_path / "a.zarr"
    values = np.arange(6, dtype=np.float32).reshape(3, 2)
    item = CalibrationItem(value=None, unit="px", array="calibration/map")
    with EpisodeWriter(path, metadata(calibration={"lens": item}), durable=False) as writer:
        writer.add_calibration_array("map", values, dimension_names=("y", "x"))
        with pytest.raises(UsageError, match="there already"):
            writer.add_calibration_array("map", values)
        with pytest.raises(UsageError, match="cannot be stored"):
            writer.add_calibration_array("text", np.array(["a"]))
        with pytest.raises(UsageError, match="is no name"):
            writer.add_calibration_array("../out", values)
        writer.add_calibration_array("tactile_reference/tactile", values)
        with pytest.raises(UsageError, match="inside another array"):
            writer.add_calibration_array("map/inner", values)
        stream = writer.add_stream("tactile", kind="tactile", images=encoded_images())
        stream.append(times(), jpegs())
        more: dict[str, Any] = {"acme:lamp": 3}
        stream.set_reference(pictures()[0], method="captured", **more)
        activity = np.zeros(len(times()), np.float32)
        writer.add_derived("tactile", "activity", activity, algorithm="x/1", **more)
        with pytest.raises(MetadataError, match=r"unknown key 'lamp'.*\$\.items\.tactile/activity"):
            writer.add_derived("tactile", "activity", activity, algorithm="x/1", lamp=3)
    with open_episode(path) as episode:
        np.testing.assert_array_equal(open_array(episode.store, "calibration/map").read(), values)
        model = episode["tactile"].metadata
        assert isinstance(model, TactileStream)
        assert model.reference is not None
        assert model.reference.model_extra == more
        assert episode.derived is not None
        assert episode.derived.items["tactile/activity"].model_extra == more
    array = zarr.open_group(path, mode="r", zarr_format=3)["calibration/map"]
    assert isinstance(array, zarr.Array)
    assert array.metadata.to_dict()["dimension_names"] == ("y", "x")
