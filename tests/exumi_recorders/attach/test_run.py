"""The whole way: a card and a session in, one valid episode a clip out."""

import json
import shutil
from pathlib import Path
from typing import Any
from uuid import UUID

import numpy as np
import pytest
from typer.testing import CliRunner

import exumi_data
from exumi_converters import prepare
from exumi_data.catalog import read_catalog
from exumi_data.cli.app import app
from exumi_data.dataset import Dataset
from exumi_data.episode import open_episode
from exumi_data.errors import NotAnEpisodeError, UsageError
from exumi_data.model import CalibrationItem, Frames
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack
from exumi_data.store.video import VideoDecoder
from exumi_recorders.attach import AttachOptions, AttachReport, attach
from exumi_recorders.attach.writing import later
from exumi_recorders.calibration.apply import apply_calibration
from exumi_recorders.calibration.files import Calibration
from exumi_recorders.placed_clips import placed_by
from exumi_recorders.simulated.hub_run import HubRun, simulate_hub_run
from exumi_validators import validate

Demos = tuple[Path, AttachReport]
QUICK = AttachOptions(durable=False)
DRY = AttachOptions(dry_run=True)


def dataset(root: Path) -> Dataset:
    opened = exumi_data.open(root)
    assert isinstance(opened, Dataset)
    return opened


def tree(root: Path) -> dict[str, tuple[int, int]]:
    return {
        str(path.relative_to(root)): (path.stat().st_mtime_ns, path.stat().st_size)
        for path in sorted(root.rglob("*"))
        if path.is_file()
    }


def test_every_clip_that_belongs_is_attached_where_it_was_filmed(
    hub_run: HubRun, demos: Demos
) -> None:
    _, report = demos
    found = {clip.name: clip for clip in report.clips}
    assert set(found) == {*hub_run.starts_s, *hub_run.foreign}
    errors = []
    for name in hub_run.starts_s:
        clip = found[name]
        assert clip.status == "attached", (name, clip.reason)
        assert clip.start_s is not None
        assert clip.sigma_s is not None
        middle = 0.5 * clip.duration_s
        errors.append(clip.start_s + middle - hub_run.true_s(name, middle))
        assert abs(errors[-1]) < 2 * clip.sigma_s
    assert np.sqrt(np.mean(np.square(errors))) < 2e-3


def test_the_foreign_clip_is_left_out_and_the_missing_one_told(
    hub_run: HubRun, demos: Demos
) -> None:
    _, report = demos
    assert [clip.name for clip in report.left_out] == list(hub_run.foreign)
    assert report.left_out[0].status == "refused"
    assert report.left_out[0].reason
    ((start, stop),) = hub_run.missing_s
    (missing,) = report.missing
    assert missing.start_s < start + 0.5
    assert missing.stop_s > stop - 0.5
    assert len(report.notices) == 1
    assert "recording(s) that are not here" in report.notices[0]


def test_the_episodes_are_valid(demos: Demos) -> None:
    root, _ = demos
    problems = validate(root, workers=1).problems
    assert [(p.rule, p.path) for p in problems if p.severity == "error"] == []


def test_clips_are_kept_byte_for_byte(hub_run: HubRun, demos: Demos) -> None:
    root, report = demos
    episodes = dataset(root)
    assert len(episodes) == len(hub_run.starts_s)
    for clip in report.clips:
        if clip.episode is None:
            continue
        with episodes[clip.episode] as episode:
            view = episode["rgb"]
            assert view.container() == (hub_run.clips / clip.name).read_bytes()
            assert view.frames[0].shape == (32, 32, 3)


def test_an_episode_holds_its_part_of_the_session(hub_run: HubRun, demos: Demos) -> None:
    root, report = demos
    clip = report.clips[3]
    assert clip.episode is not None
    assert clip.start_s is not None
    with open_episode(hub_run.session) as session, dataset(root)[clip.episode] as episode:
        assert set(episode) == {"rgb", *session}
        rgb = episode["rgb"]
        assert int(rgb.time[0]) == pytest.approx(0.5e9, abs=2)
        for name in session:
            view, whole = episode[name], session[name]
            assert int(view.time[0]) >= 0
            assert int(view.time[-1]) < int(rgb.time[-1]) + 0.6e9
            assert view.time_host is not None
            assert whole.time_host is not None
            first = int(np.searchsorted(whole.time_host, view.time_host[0]))
            assert (whole.time_host[first : first + len(view)] == view.time_host).all()
        meta = episode.metadata
        assert meta.calibration == session.metadata.calibration
        assert UUID(episode.id).version == 7
        assert UUID(episode.id).int >> 80 == UUID(session.id).int >> 80
        assert meta.source.type == "recorded"
        assert meta.source.parent_id == session.id
        assert meta.source.parent_digest == session.digest()
        assert [one.name for one in meta.source.inputs or []] == [clip.name]
        clock = rgb.metadata.clock
        assert clock.stamp_point == "container_pts"
        assert clock.offset_sigma_ns == pytest.approx(1e9 * (clip.sigma_s or 0.0), abs=1)
        assert "exumi-gyro-match/1" in (clock.method or "")
        assert placed_by(clock) == "pose"
        assert placed_by(session["pose"].metadata.clock) is None
        # What the hub's own clock says of the moment has not changed.
        at = view.metadata.clock
        assert at.t_ref_ns == session[name].metadata.clock.t_ref_ns + round(
            (clip.start_s - 0.5) * 1e9
        )
        assert meta.start == later(
            session.metadata.start, at.t_ref_ns - session[name].metadata.clock.t_ref_ns
        )


def test_again_writes_nothing(hub_run: HubRun, demos: Demos) -> None:
    root, first = demos
    before = tree(root)
    again = attach(hub_run.clips, hub_run.session, root, options=QUICK)
    assert tree(root) == before
    statuses = {clip.name: clip.status for clip in again.clips}
    assert set(statuses.values()) == {"present", "refused"}
    assert [c.episode for c in again.clips] == [c.episode for c in first.clips]


def test_what_was_lost_is_made_again_the_same(
    hub_run: HubRun, demos: Demos, tmp_path: Path
) -> None:
    root = tmp_path / "demos"
    shutil.copytree(demos[0], root)
    digests = dict(zip(*(read(root, column) for column in ("id", "digest")), strict=True))
    gone = demos[1].clips[2].episode
    shutil.rmtree(next(root.rglob(f"{gone}.zarr")))
    damaged = demos[1].clips[4].episode
    next(next(root.rglob(f"{damaged}.zarr")).rglob("streams/pose/data/c/0/0")).unlink()
    again = attach(hub_run.clips, hub_run.session, root, options=QUICK)
    attached = [clip.episode for clip in again.clips if clip.status == "attached"]
    assert attached == [gone, damaged]
    new = dict(zip(*(read(root, column) for column in ("id", "digest")), strict=True))
    assert {new[one] == digests[one] for one in new if one != damaged} == {True}


def read(root: Path, column: str) -> list[Any]:
    table = read_catalog(root)
    assert table is not None
    return list(table.column(column).to_pylist())


def test_other_options_make_another_revision(hub_run: HubRun, tmp_path: Path) -> None:
    card = tmp_path / "card"
    card.mkdir()
    for name in list(hub_run.starts_s)[:2]:
        shutil.copy(hub_run.clips / name, card)
    root = tmp_path / "demos"
    first = attach(card, hub_run.session, root, options=QUICK)
    wider = AttachOptions(durable=False, margin_s=1.0, without=("width",))
    second = attach(card, hub_run.session, root, options=wider)
    assert [c.episode for c in first.clips] == [c.episode for c in second.clips]
    assert [c.status for c in second.clips] == ["attached", "attached"]
    for episode in dataset(root):
        with episode:
            assert episode.metadata.revision == 2
            assert "width" not in episode
            assert int(episode["rgb"].time[0]) == pytest.approx(1e9, abs=2)


def test_a_dry_run_writes_nothing(hub_run: HubRun, tmp_path: Path) -> None:
    before = tree(hub_run.session.parent)
    report = attach(hub_run.clips, hub_run.session, tmp_path / "demos", options=DRY)
    assert list(tmp_path.iterdir()) == []
    assert tree(hub_run.session.parent) == before
    assert {clip.status for clip in report.clips} == {"placed", "refused"}
    assert report.dry_run
    json.dumps(report.to_json(), allow_nan=False)


def test_clips_of_two_sessions_each_find_their_own(hub_run: HubRun, tmp_path: Path) -> None:
    other = simulate_hub_run(tmp_path / "other", demonstrations=3, seed=5, foreign=0, seconds=6.0)
    sessions = tmp_path / "sessions"
    ids = []
    for path in (hub_run.session, other.session):
        with open_episode(path) as session:
            ids.append(session.id)
        shutil.copytree(path, sessions / "episodes" / ids[-1][-2:] / f"{ids[-1]}.zarr")
    (sessions / "dataset.json").write_text(
        '{"format": "exumi-dataset", "version": "1.0", "name": "s", "licence": "CC0-1.0"}'
    )
    card = tmp_path / "card"
    (card / "a").mkdir(parents=True)
    (card / "b").mkdir()
    for name in list(hub_run.starts_s)[:3]:
        shutil.copy(hub_run.clips / name, card / "a")
    for name in other.starts_s:
        shutil.copy(other.clips / name, card / "b")
    with pytest.raises(UsageError, match="holds 2 sessions"):
        attach(card, sessions, tmp_path / "demos", options=DRY)
    options = AttachOptions(dry_run=True, sessions=tuple(ids))
    report = attach(card, sessions, tmp_path / "demos", options=options)
    assert [(c.name[0], c.session) for c in report.clips] == [
        *[("a", ids[0])] * 3,
        *[("b", ids[1])] * 2,
    ]
    one = attach(
        card, sessions, tmp_path / "d", options=AttachOptions(dry_run=True, sessions=(ids[1],))
    )
    assert [clip.status for clip in one.clips] == ["refused"] * 3 + ["placed"] * 2
    with pytest.raises(UsageError, match="no episode"):
        attach(card, sessions, tmp_path / "d", options=AttachOptions(sessions=("x",)))


def test_a_damaged_clip_harms_no_other(hub_run: HubRun, tmp_path: Path) -> None:
    card = tmp_path / "card"
    shutil.copytree(hub_run.clips, card)
    names = list(hub_run.starts_s)
    for name in names[3:]:
        (card / name).unlink()
    (card / names[1]).write_bytes((card / names[1]).read_bytes()[:1000])
    report = attach(card, hub_run.session, tmp_path / "demos", options=QUICK)
    status = {clip.name: clip.status for clip in report.clips}
    assert [status[name] for name in names[:3]] == ["attached", "failed", "attached"]
    assert names[1] in next(clip.reason for clip in report.clips if clip.name == names[1])


def test_clips_without_gyroscope_say_what_to_do(tmp_path: Path) -> None:
    run = simulate_hub_run(
        tmp_path / "run", demonstrations=3, foreign=0, seconds=5.0, telemetry=False
    )
    report = attach(run.clips, run.session, tmp_path / "demos", options=QUICK)
    assert {clip.status for clip in report.clips} == {"refused"}
    assert all("no intrinsics/rgb says how its camera sees" in c.reason for c in report.clips)
    assert not (tmp_path / "demos").exists()


def test_what_makes_no_sense_is_refused(hub_run: HubRun, demos: Demos, tmp_path: Path) -> None:
    def run(session: Path = hub_run.session, **options: Any) -> None:
        attach(hub_run.clips, session, tmp_path / "d", options=AttachOptions(**options))

    with pytest.raises(UsageError, match="a stream 'pose' already"):
        run(stream="pose")
    with pytest.raises(UsageError, match="no pose stream 'hand'"):
        run(pose="hand")
    with pytest.raises(UsageError, match="no stream 'gel'"):
        run(without=("gel",))
    with pytest.raises(UsageError, match="is no name of a stream"):
        run(stream="../rgb")
    with pytest.raises(UsageError, match="margin"):
        run(margin_s=-1.0)
    with pytest.raises(UsageError, match="--session names episodes of a dataset"):
        run(sessions=("x",))
    with pytest.raises(NotAnEpisodeError, match="holds no session"):
        run(demos[0])
    with pytest.raises(NotAnEpisodeError):
        run(tmp_path / "nothing")
    (tmp_path / "d").mkdir()
    (tmp_path / "d" / "mine.txt").write_text("x")
    with pytest.raises(UsageError, match="no exUMI dataset"):
        run()


@pytest.mark.parametrize(
    ("start", "ns", "expected"),
    [
        ("2026-03-01T23:59:59.5Z", 500_000_001, "2026-03-02T00:00:00.000000001Z"),
        ("2026-03-01T00:00:00Z", -1, "2026-02-28T23:59:59.999999999Z"),
        ("2016-12-31T23:59:60.25Z", 1, "2017-01-01T00:00:00.250000001Z"),
        (None, 5, None),
    ],
)
def test_a_later_moment(start: str | None, ns: int, expected: str | None) -> None:
    assert later(start, ns) == expected


def test_the_command(hub_run: HubRun, demos: Demos, capsys: pytest.CaptureFixture[str]) -> None:
    arguments = ["attach", str(hub_run.clips), str(hub_run.session), "--out", str(demos[0])]

    def run(*more: str) -> tuple[int, str, str]:
        with pytest.raises(SystemExit) as ended:
            app([*arguments, *more])
        shown = capsys.readouterr()
        return int(ended.value.code or 0), shown.out, shown.err

    code, out, err = run("--dry-run")
    assert code == 1
    assert "11 placed, 1 refused of 12 clips" in out
    assert "GX010001.MP4" in out
    assert f"{hub_run.foreign[0]} was left out" in err
    assert "there is no clip of it" in err
    code, out, _ = run("--keep-going", "--quiet", "--format", "json")
    assert code == 0
    document = json.loads(out)
    assert [clip["status"] for clip in document["clips"]].count("present") == 11
    assert len(document["missing"]) == 1


def test_poses_that_claim_years_take_no_memory(hub_run: HubRun, tmp_path: Path) -> None:
    path = tmp_path / "s.zarr"
    with open_episode(hub_run.session) as session:
        meta = session.metadata.model_copy(update={"streams": {}})
        with EpisodeWriter(path, meta, durable=False) as writer:
            stream = writer.add_stream(
                "pose", kind="pose", frames=Frames(parent="world", child="tcp")
            )
            stream.append(np.array([0, 1, 2**61]), np.tile([0, 0, 0, 0, 0, 0, 1.0], (3, 1)))
    with pytest.raises(UsageError, match=r"covers 6.41e\+05 h"):
        attach(hub_run.clips, path, tmp_path / "demos", options=DRY)


def copied(hub_run: HubRun, folder: Path, count: int) -> Path:
    folder.mkdir()
    for name in list(hub_run.starts_s)[:count]:
        shutil.copy(hub_run.clips / name, folder / name)
    return folder


def test_frames_that_cannot_be_decoded_are_left_out_on_request(
    hub_run: HubRun, tmp_path: Path
) -> None:
    card = copied(hub_run, tmp_path / "card", 1)
    (path,) = card.iterdir()
    with VideoDecoder(str(path), path) as decoder:
        packet = list(decoder.packets())[70]
        start, size = packet.pos, packet.size
    damaged = bytearray(path.read_bytes())
    damaged[start : start + size] = bytes(size)
    path.write_bytes(damaged)
    whole = attach(card, hub_run.session, tmp_path / "demos", options=QUICK).clips[0]
    assert (whole.status, whole.notes) == ("attached", ())
    assert {p.code for p in validate(tmp_path / "demos").problems} == {"VID-008"}
    checked = AttachOptions(durable=False, check_frames=True)
    # It is another episode by what it lists, and takes the place of the first.
    sound = attach(card, hub_run.session, tmp_path / "demos", options=checked).clips[0]
    assert (sound.status, sound.episode) == ("attached", whole.episode)
    assert "frames are damaged" in sound.notes[0]
    report = validate(tmp_path / "demos")
    assert [p.rule for p in report.problems if p.severity == "error"] == []
    again = attach(card, hub_run.session, tmp_path / "demos", options=checked).clips[0]
    assert (again.status, again.notes) == ("present", sound.notes)


def test_what_a_killed_run_left_is_cleaned(hub_run: HubRun, tmp_path: Path) -> None:
    card, root = copied(hub_run, tmp_path / "card", 2), tmp_path / "demos"
    attach(card, hub_run.session, root, options=QUICK)
    before = tree(root)
    first, second = (path for path in sorted((root / "episodes").rglob("*.zarr")))
    shutil.copytree(first, first.with_name(f".partial-{first.stem}"))
    second.rename(second.with_name(f".replaced-{second.name}"))
    report = attach(card, hub_run.session, root, options=QUICK)
    assert [clip.status for clip in report.clips] == ["present", "present"]
    assert tree(root) == before
    assert "half-written" in report.notices[0]
    assert "brought back" in report.notices[1]


def test_a_packed_episode_that_is_made_anew_is_not_there_twice(
    hub_run: HubRun, tmp_path: Path
) -> None:
    card, root = copied(hub_run, tmp_path / "card", 1), tmp_path / "demos"
    attach(card, hub_run.session, root, options=QUICK)
    (path,) = (root / "episodes").rglob("*.zarr")
    packed = pack(path)
    shutil.rmtree(path)
    again = attach(card, hub_run.session, root, options=QUICK)
    assert (again.clips[0].status, path.exists()) == ("present", False)
    options = AttachOptions(durable=False, margin_s=0.2)
    again = attach(card, hub_run.session, root, options=options)
    assert (again.clips[0].status, path.exists(), packed.exists()) == ("attached", True, False)
    assert [p.rule for p in validate(root).problems if p.severity == "error"] == []


def test_nothing_is_to_be_validated_where_nothing_was_written(
    hub_run: HubRun, tmp_path: Path
) -> None:
    card = tmp_path / "card"
    card.mkdir()
    shutil.copy(hub_run.clips / hub_run.foreign[0], card)
    arguments = ["attach", str(card), str(hub_run.session), "--out", str(tmp_path / "demos")]
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 1
    assert "Next" not in done.output


def test_a_training_set_of_attached_clips_is_valid_and_can_be_calibrated(
    demos: Demos, tmp_path: Path
) -> None:
    root, _ = demos
    train = tmp_path / "train"
    assert prepare(root, train, size=32, workers=1).failed == ()
    assert [p.code for p in validate(train).problems if p.severity == "error"] == []
    path = next((train / "episodes").rglob("*.zarr"))
    with open_episode(path) as episode:
        before = {name: episode[name].time for name in ("rgb", "pose")}
        latency = episode["pose"].metadata.clock.latency_ns
        assert "exumi-gyro-match/1" in (episode["rgb"].metadata.clock.method or "")
    item = CalibrationItem(value=latency + 7_000_000, unit="ns", uncertainty=1e6, method="sweep")
    rig = Calibration({"latency/pose": item})
    done = apply_calibration(path, rig, "rig.json", durable=False)
    assert set(done.times) == {"rgb", "pose"}
    with open_episode(path) as episode:
        for name, time in before.items():
            assert np.array_equal(episode[name].time, time - 7_000_000)
    assert [p.code for p in validate(path).problems if p.severity == "error"] == []
