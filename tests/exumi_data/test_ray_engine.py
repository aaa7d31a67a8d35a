"""On a real cluster of two nodes, everything becomes what it becomes on one machine.

All in one module: the cluster is started once for it, on whichever process the tests run.
"""

import fcntl
import itertools
import json
import os
import secrets
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from typer.testing import CliRunner

from exumi_converters import convert, prepare
from exumi_data import __version__
from exumi_data.catalog import build_catalog
from exumi_data.cli.app import app
from exumi_data.demo.touches import TouchSettings, write_touch_dataset
from exumi_data.engine import Outcome, map_items, ray_cluster, ray_nodes, ray_worker
from exumi_data.engine.ray_cluster import find_cluster, ray_module
from exumi_data.engine.ray_engine import RayEngine, ray_engine
from exumi_data.engine.ray_nodes import check_nodes
from exumi_data.errors import ExumiError, MetadataError, MissingExtraError, UsageError
from exumi_data.opening import open as open_data
from exumi_data.stats import measure
from exumi_validators import validate
from tests.servers import web

ray: Any = pytest.importorskip("ray")
cluster_utils: Any = pytest.importorskip("ray.cluster_utils")

_STORE_BYTES = 80 << 20
EXUMI = [sys.executable, "-m", "exumi_data.cli"]


@pytest.fixture(scope="module")
def cluster() -> Iterator[Any]:
    """Two nodes of one processor each."""
    with pytest.MonkeyPatch.context() as patch:
        # Paths of sockets are short; and nobody else's cluster is met, or told of this one.
        folder = tempfile.mkdtemp(prefix="ray-", dir="/tmp")
        patch.setenv("RAY_TMPDIR", folder)
        patch.setenv("RAY_USAGE_STATS_ENABLED", "0")
        patch.delenv("RAY_ADDRESS", raising=False)
        node = {"num_cpus": 1, "object_store_memory": _STORE_BYTES, "include_dashboard": False}
        made = cluster_utils.Cluster(shutdown_at_exit=False)
        try:
            made.add_node(**node)
            made.add_node(**node)
            yield made
        finally:
            made.shutdown()
            shutil.rmtree(folder, ignore_errors=True)


@pytest.fixture(scope="module")
def engine(cluster: Any) -> Iterator[RayEngine]:
    before = signal.getsignal(signal.SIGTERM)
    with ray_engine(cluster.address) as joined:
        assert signal.getsignal(signal.SIGTERM) is before
        assert (joined.nodes, joined.processors, joined.own) == (2, 2, False)
        yield joined
    assert signal.getsignal(signal.SIGTERM) is before
    assert not ray.is_initialized()


def write_clip(path: Path, number: int, frames: int) -> None:
    import av

    y, x = np.mgrid[0:64, 0:80].astype(np.float32)
    blob = np.exp(-((x - 40) ** 2 + (y - 30) ** 2) / (60 + 40 * number))
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        stream.width, stream.height, stream.pix_fmt = 80, 64, "yuv420p"
        for depth in np.clip(np.sin(np.linspace(-0.5, 3.6, frames)), 0, 1):
            image = np.repeat((100 + 70 * depth * blob).astype(np.uint8)[..., None], 3, axis=2)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(image, format="rgb24")))
        container.mux(stream.encode(None))


@pytest.fixture
def clips(tmp_path: Path) -> Path:
    """Six tactile videos, and a broken one."""
    folder = tmp_path / "clips"
    folder.mkdir()
    for number in range(6):
        write_clip(folder / f"ball_{number}.mov", number, 40)
    whole = (folder / "ball_0.mov").read_bytes()
    (folder / "broken_0.mov").write_bytes(whole[: len(whole) // 2])
    return folder


def square(number: int) -> int:
    return number * number


def this_node() -> str:
    return str(ray.get_runtime_context().get_node_id())


def where(_: int) -> str:
    time.sleep(0.05)
    return this_node()


def meet(_: int, *, folder: str) -> str:
    """Return the node when an item has come to another one as well."""
    Path(folder, this_node()).touch()
    wait_until(lambda: len(list(Path(folder).iterdir())) == 2)
    return this_node()


class Awkward(Exception):  # noqa: N818  # what it is called does not matter
    """An exception that another process cannot rebuild from its arguments."""

    def __init__(self, first: str, second: str) -> None:
        super().__init__(f"{first} and {second}")


def troubled(number: int) -> Any:
    if number == 1:
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 2:
        sys.exit(4)
    if number == 3:
        raise Awkward("this", "that")
    if number == 4:
        raise MetadataError("bad", where="x", problems=("a @ $",))
    return threading.Lock() if number == 5 else number


def dies_once(number: signal.Signals, *, folder: str) -> int:
    """Be ended by a signal the first time; leave a note of each time, and of what was tidied up."""
    again = any(Path(folder).glob(f"{number}-*"))
    name = f"{number}-{secrets.token_hex(4)}"
    Path(folder, name).touch()
    try:
        if not again:
            os.kill(os.getpid(), number)
            time.sleep(1)
    finally:
        Path(folder, f"tidied-{name}").touch()
    return int(number)


def half_written(number: int, *, folder: str) -> int:
    note = Path(folder, f"{number}")
    note.write_text(str(os.getpid()))
    try:
        for _ in range(600):
            time.sleep(0.05)
    finally:
        note.unlink()
    return number


def stuck_on(node: str, number: int, *, folder: str) -> int:
    """Never end on one node; elsewhere, end when something is stuck there."""
    if this_node() == node:
        Path(folder, str(number)).touch()
        time.sleep(120)
    wait_until(lambda: any(Path(folder).iterdir()))
    return number


def by_item(outcomes: Iterator[Outcome[int, Any]]) -> dict[int, Outcome[int, Any]]:
    listed = list(outcomes)
    assert [item for item, n in Counter(one.item for one in listed).items() if n > 1] == []
    return {outcome.item: outcome for outcome in listed}


def tree(root: Path) -> dict[str, bytes]:
    """Every file of a folder."""
    return {
        str(path.relative_to(root)): path.read_bytes()
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def wait_until(condition: Any, seconds: float = 60) -> None:
    end = time.monotonic() + seconds
    while not condition():
        assert time.monotonic() < end
        time.sleep(0.01)


def test_every_item_has_one_outcome(engine: RayEngine) -> None:
    outcomes = by_item(map_items(square, range(100), engine=engine))
    assert {item: outcome.value for item, outcome in outcomes.items()} == {
        number: number * number for number in range(100)
    }
    assert list(map_items(square, [], engine=engine)) == []


def test_both_nodes_work(engine: RayEngine, tmp_path: Path) -> None:
    function = partial(meet, folder=str(tmp_path))
    nodes = {outcome.value for outcome in map_items(function, range(2), engine=engine)}
    assert nodes == {node["NodeID"] for node in ray.nodes() if node["Alive"]}


def test_exceptions_and_deaths_are_outcomes(engine: RayEngine, capfd: Any) -> None:
    outcomes = by_item(map_items(troubled, range(7), engine=engine))
    assert (outcomes[0].value, outcomes[6].value) == (0, 6)
    assert "died" in str(outcomes[1].error)
    assert "3 times" in str(outcomes[1].error)
    assert "status 4" in str(outcomes[2].error)
    assert "Awkward: this and that" in str(outcomes[3].error)
    assert isinstance(outcomes[4].error, MetadataError)
    assert outcomes[4].error.problems == ("a @ $",)
    assert isinstance(outcomes[5].error, ExumiError)
    assert "lock" in str(outcomes[5].error)
    assert capfd.readouterr().out == ""  # where a result may be printed as JSON


def test_a_function_that_cannot_be_sent_is_an_outcome(engine: RayEngine) -> None:
    lock = threading.Lock()
    outcomes = list(map_items(lambda _: lock, range(3), engine=engine))
    assert ["serialize" in str(outcome.error) for outcome in outcomes] == [True] * 3


def test_an_item_whose_worker_ends_is_tried_again(engine: RayEngine, tmp_path: Path) -> None:
    """Killed by the system, and told to end, as Ray does when a node leaves."""
    signals = (signal.SIGKILL, signal.SIGTERM)
    function = partial(dies_once, folder=str(tmp_path))
    outcomes = by_item(map_items(function, signals, engine=engine))
    assert {item: outcome.value for item, outcome in outcomes.items()} == {9: 9, 15: 15}
    notes = Counter(path.name.rpartition("-")[0] for path in tmp_path.iterdir())
    assert notes == {"9": 2, "tidied-9": 1, "15": 2, "tidied-15": 2}


def test_items_are_taken_as_needed(engine: RayEngine) -> None:
    taken = 0

    def endless() -> Iterator[int]:
        nonlocal taken
        for number in itertools.count():
            taken = number + 1
            yield number

    for workers, most in ((None, 4 * 2), (1, 1)):
        taken = 0
        outcomes = map_items(square, endless(), workers=workers, engine=engine)
        seen = [next(outcomes) for _ in range(20)]
        assert len(seen) <= taken <= 20 + most
        outcomes.close()


def test_an_error_of_the_source_is_the_callers(engine: RayEngine) -> None:
    def broken() -> Iterator[int]:
        yield 1
        raise UsageError("the list ends here")

    with pytest.raises(UsageError, match="the list ends here"):
        list(map_items(square, broken(), engine=engine))


def test_who_stops_early_leaves_nothing_half_written(engine: RayEngine, tmp_path: Path) -> None:
    function = partial(half_written, folder=str(tmp_path))
    outcomes = map_items(function, range(20), engine=engine)

    def interrupt() -> None:
        wait_until(lambda: len(list(tmp_path.iterdir())) == 2)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    with pytest.raises(KeyboardInterrupt):
        next(outcomes)
    assert list(tmp_path.iterdir()) == []
    assert by_item(map_items(square, range(4), engine=engine)).keys() == set(range(4))


def test_convert_prepare_validate_stats_and_index_give_the_same(
    engine: RayEngine, clips: Path, tmp_path: Path
) -> None:
    made = {}
    for name, chosen in (("local", None), ("ray", engine)):
        root = tmp_path / name
        root.mkdir()
        reports: list[Any] = [
            convert(clips, root / "data", from_format="clips", engine=chosen),
            prepare(root / "data", root / "training", size=32, engine=chosen),
        ]
        found = [replace(report, destination="", seconds=0.0) for report in reports]
        assert [len(report.failed) for report in found] == [1, 0]
        with_source = replace(found[1], source="")
        judged = validate(root / "data", engine=chosen)
        dataset = open_data(root / "training")
        table, failed = build_catalog(root / "data", engine=chosen)
        made[name] = (
            tree(root),
            found[0],
            with_source,
            judged.to_json().replace(str(root), ""),
            json.dumps(asdict(measure(dataset, engine=chosen)), default=str).replace(str(root), ""),
            (table.to_pylist(), failed),
        )
    assert len(made["local"][0]) > 50
    assert made["local"] == made["ray"]


def test_what_loaders_compute_is_the_same(engine: RayEngine, tmp_path: Path) -> None:
    from exumi_loaders import TextureEncoder, TimelineSettings, build_timeline, encode_clips
    from exumi_loaders.layout import Layout

    dataset = write_touch_dataset(tmp_path / "data", TouchSettings(parts=2, clips=2), workers=1)
    encoder, engines = TextureEncoder(), (None, engine)
    here, there = (encode_clips(dataset, encoder, workers=None, engine=one) for one in engines)
    assert np.array_equal(here.vectors, there.vectors)
    assert [entry.origins for entry in here.entries] == [entry.origins for entry in there.entries]
    layout, settings = Layout(("tactile",), ()), TimelineSettings()
    first, second = (build_timeline(dataset, layout, settings, engine=one) for one in engines)
    assert len(first.frame["tactile"]) > 0
    assert np.array_equal(first.frame["tactile"], second.frame["tactile"])
    assert np.array_equal(first.edges, second.edges)


def test_the_program_gives_the_same(
    cluster: Any, engine: RayEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)  # not where the nodes were started: paths are relative
    write_touch_dataset(tmp_path / "data", TouchSettings(parts=2, clips=2), workers=1)
    on_ray = ["--engine", "ray", "--ray-address", cluster.address]
    for verb in (
        ["validate", "data", "--format", "json"],
        ["validate", "data", "--fix"],
        ["stats", "data", "--format", "json"],
        ["index", "data", "--all", "--format", "json"],
        ["index", "build", "data", "an-index", "--quiet"],
        ["convert", "data", "exported", "--to", "octopi", "--quiet"],
        ["prepare", "data", "training", "--size", "32", "--quiet"],
    ):
        given = tree(tmp_path / "data")
        runs = []
        for options in (["--workers", "1"], on_ray):
            done = CliRunner().invoke(app, [*verb, *options])
            assert done.exit_code == 0, done.output
            made = {
                name: tree(tmp_path / name)
                for name in ("exported", "training")
                if Path(name).exists()
            }
            for name in ("an-index", *made):
                shutil.rmtree(name, ignore_errors=True)
            assert bool(made) is (verb[0] in ("convert", "prepare"))
            runs.append((made, "" if verb[-1] == "--quiet" else done.stdout))
        assert runs[0] == runs[1]
        assert tree(tmp_path / "data") == given
    told = CliRunner().invoke(app, ["stats", "data", *on_ray]).stderr
    assert told == "note: on the Ray cluster: 2 nodes, 2 processors\n"
    refused = CliRunner().invoke(app, ["stats", "data", "--ray-address", cluster.address])
    assert (refused.exit_code, "goes with --engine ray" in refused.stderr) == (2, True)
    refused = CliRunner().invoke(
        app, ["index", "build", "data", "an-index", "--model", "tower.pt", *on_ray]
    )
    assert (refused.exit_code, "not sent to a cluster" in refused.stderr) == (2, True)


def test_a_node_without_the_files_is_named(
    engine: RayEngine, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(ray_nodes, "_SEEN_WITHIN_S", 0.1)
    monkeypatch.chdir(tmp_path)
    check_nodes([tmp_path], [tmp_path / "new" / "dataset"])
    assert list(tmp_path.iterdir()) == []  # nothing is left of looking
    # What only this process has: a file that it has open, and where it works.
    with (tmp_path / "file").open("wb") as file:
        mine = Path(f"/proc/self/fd/{os.dup2(file.fileno(), 543)}")
        try:
            with pytest.raises(UsageError, match=rf"has no {mine}.*has no {mine}") as caught:
                check_nodes([mine], [])
        finally:
            os.close(543)
    for node in ray.nodes():
        if node["Alive"]:
            assert node["NodeID"][:8] in caught.value.what
    assert "shared file system" in (caught.value.fix or "")
    with pytest.raises(UsageError, match="cwd is another folder than ours"):
        check_nodes([], [Path("/proc/self/cwd")])


def test_a_node_with_another_version_is_named(
    engine: RayEngine, monkeypatch: pytest.MonkeyPatch
) -> None:

    monkeypatch.setattr(ray_worker, "__version__", "9.9.9")
    with pytest.raises(UsageError, match=f"has exumi-data {__version__}, this is 9.9.9"):
        check_nodes([], [])
    monkeypatch.undo()
    monkeypatch.setattr(ray_worker, "_PACKAGES", ("numpy", "pytest"))
    with pytest.warns(UserWarning, match="pytest missing"):
        check_nodes([], [])


def test_a_node_without_the_library_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    question = ray_nodes._question([], [], 0)
    monkeypatch.setitem(sys.modules, "exumi_data.engine.ray_worker", None)
    assert "ray_worker" in str(question())


@pytest.mark.parametrize(
    ("address", "message"),
    [
        ("127.0.0.1:1", "no Ray cluster at 127.0.0.1:1: Connection refused"),
        ("somewhere", "not like host:port"),
        ("ray://10.0.0.1:10001", "address of a Ray client"),
        ("auto", "none was started on this machine"),
    ],
)
def test_an_address_where_there_is_no_cluster(
    address: str, message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    with pytest.raises(UsageError, match=message):
        find_cluster(address)
    monkeypatch.setenv("RAY_ADDRESS", address)
    with pytest.raises(UsageError, match=message):
        find_cluster(None)
    assert find_cluster("local") is None


def test_an_address_where_something_else_listens(tmp_path: Path) -> None:
    with web(tmp_path) as site, pytest.raises(UsageError, match="something else listens there"):
        find_cluster(site.url.removeprefix("http://"))


def test_a_cluster_of_this_machine_is_found(
    cluster: Any, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    assert find_cluster(None) == find_cluster("auto") == cluster.address
    monkeypatch.setenv("RAY_TMPDIR", str(tmp_path))
    assert find_cluster(None) is None
    monkeypatch.setenv("RAY_ADDRESS", cluster.address)
    assert find_cluster(None) == cluster.address
    (tmp_path / "ray").mkdir()
    (tmp_path / "ray" / "ray_current_cluster").write_text("127.0.0.1:1")  # it is gone by now
    monkeypatch.delenv("RAY_ADDRESS")
    assert find_cluster(None) is None


def test_folders_of_programs_that_were_killed_are_removed(tmp_path: Path) -> None:
    alive, dead, new, foreign = (tmp_path / f"exumi-ray-{n}" for n in range(4))
    for folder in (alive, dead, new, foreign):
        folder.mkdir()
        (folder / "socket").touch()
    for folder in (alive, dead, new):
        (folder / "in-use").touch()
    for folder in (alive, dead):
        os.utime(folder / "in-use", (0, 0))
    (tmp_path / "exumi-ray-link").symlink_to(dead)
    with (alive / "in-use").open() as mark:
        fcntl.flock(mark, fcntl.LOCK_EX)
        ray_cluster._remove_left_behind(tmp_path)
    left = sorted(path.name for path in tmp_path.iterdir())
    assert left == ["exumi-ray-0", "exumi-ray-2", "exumi-ray-3", "exumi-ray-link"]


def test_ray_is_an_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(MissingExtraError, match=r"exumi-data\[ray\]"):
        ray_module()


def test_nothing_imports_ray_before_it_is_asked_for() -> None:
    code = "import sys, exumi_data.engine, exumi_data.cli.app; print('ray' in sys.modules)"
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True)
    assert done.stdout == "False\n"


def test_when_a_node_goes_its_items_are_done_elsewhere(
    cluster: Any, engine: RayEngine, tmp_path: Path
) -> None:
    third = cluster.add_node(num_cpus=1, object_store_memory=_STORE_BYTES)
    with pytest.MonkeyPatch.context() as patch, ray_engine(cluster.address) as joined:
        # It is asked as one that came after this engine; and it lacks what only we have.
        joined._late._known.discard(third.node_id)
        patch.setattr(ray_worker, "__version__", "9.9.9")
        with pytest.warns(UserWarning, match=f"{third.node_id[:8]}.*has exumi-data"):
            nodes = {one.value for one in map_items(where, range(12), engine=joined)}
        assert third.node_id not in nodes
        assert len(nodes) == 2
    function = partial(stuck_on, third.node_id, folder=str(tmp_path))
    done: list[Outcome[int, int]] = []
    for outcome in map_items(function, range(12), engine=engine):
        done.append(outcome)
        if third in cluster.worker_nodes:
            cluster.remove_node(third, allow_graceful=False)
    assert len(list(tmp_path.iterdir())) == 1  # it was begun there
    assert sorted(outcome.item for outcome in done) == list(range(12))
    assert [outcome.error for outcome in done if outcome.error] == []


def processes_of_session(session: int) -> list[str]:
    """Command lines of what a program started that is still there."""
    found = []
    for folder in Path("/proc").glob("[0-9]*"):
        try:
            fields = (folder / "stat").read_text().rpartition(")")[2].split()
            if int(fields[3]) == session and fields[0] != "Z":
                found.append((folder / "cmdline").read_text().replace("\0", " "))
        except (OSError, ValueError):
            continue
    return found


def test_ctrl_c_leaves_nothing_half_written_and_no_process(tmp_path: Path) -> None:
    clips, data = tmp_path / "clips", tmp_path / "data"
    clips.mkdir()
    for number in range(2):
        write_clip(clips / f"long_{number}.mov", number, 1500)
    command = [*EXUMI, "convert", str(clips), str(data), "--from", "clips", "--workers", "2"]
    command += ["--engine", "ray", "--ray-address", "local"]
    if RAYS_OWN in stopped(command, data, final=False):
        shutil.rmtree(data)
        stopped(command, data, final=True)
    convert(clips, data, from_format="clips")
    assert validate(data).valid


RAYS_OWN = "You have likely discovered a bug in Ray"


def stopped(command: list[str], data: Path, *, final: bool) -> str:
    """Press Ctrl-C twice while a program writes; return what it said on stderr.

    Ray's own library may abort the program when a task ends in the moment that it is cancelled.
    That is given a second chance, and nothing else.
    """
    folder = Path(tempfile.mkdtemp(prefix="ray-", dir="/tmp"))
    try:
        with subprocess.Popen(
            command,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
            env={**os.environ, "TMPDIR": str(folder)},
            start_new_session=True,
        ) as program:
            try:
                wait_until(lambda: list(data.glob("episodes/*/.partial-*")))
                os.killpg(program.pid, signal.SIGINT)
                time.sleep(0.3)
                os.killpg(program.pid, signal.SIGINT)  # for the impatient
                out, err = program.communicate(timeout=30)
            except BaseException:
                os.killpg(program.pid, signal.SIGKILL)
                raise
        if RAYS_OWN in err and not final:
            with suppress(ProcessLookupError):
                os.killpg(program.pid, signal.SIGKILL)
            return err
        assert (program.returncode, out) == (130, ""), err
        assert err == (
            "note: on a Ray cluster of its own: 1 node, 2 processors\n"
            "error: interrupted\n"
            "       What was complete stays; nothing half-written is left.\n"
        )
        assert [path for path in data.rglob(".*") if path.is_dir()] == []
        wait_until(lambda: not processes_of_session(program.pid), 10)
        assert list(folder.glob("exumi-ray-*")) == []
        return err
    finally:
        shutil.rmtree(folder, ignore_errors=True)
