"""States of a journal, and the room that it needs."""

import json
from pathlib import Path

import numpy as np
import pytest

from exumi_data.errors import EpisodeExistsError, UnsupportedError, UsageError
from exumi_recorders.contract import Blocks, Port, Rows
from exumi_recorders.journal import space
from exumi_recorders.journal.header import JournalHeader, StreamHeader, port_document
from exumi_recorders.journal.journal import JournalWriter
from exumi_recorders.journal.space import (
    NoRoomError,
    Reserve,
    SpaceLimits,
    bytes_per_second,
    check_room,
    seconds_left,
)
from exumi_recorders.journal.states import (
    STATE_NAME,
    discard,
    journal_folder,
    list_journals,
    locked,
    purge,
    read_state,
    undo_discard,
)
from tests.exumi_recorders.numbered import CAMERA, POSE, episode


def make(dataset: Path, number: int = 1) -> JournalWriter:
    stream = StreamHeader(device="d", port=port_document(POSE))
    header = JournalHeader(
        boot_id="b", t0_monotonic_ns=0, episode=episode(number), streams={"pose": stream}
    )
    return JournalWriter(dataset, header, arrays={"rectification/left": np.eye(3)})


def test_a_journal_goes_through_its_states(tmp_path: Path) -> None:
    writer = make(tmp_path)
    assert read_state(writer.path).state == "recording"
    assert list_journals(tmp_path) == [writer.path] == [journal_folder(tmp_path, episode().id)]
    assert np.load(writer.path / "calibration" / "rectification" / "left.npy").shape == (3, 3)
    with pytest.raises(UsageError, match="being recorded"):
        discard(writer.path, "no")
    writer.stop()
    writer.stop()
    assert read_state(writer.path).state == "stopped"
    with pytest.raises(UsageError, match="it is stopped"):
        undo_discard(writer.path)
    with pytest.raises(UsageError, match="not discarded"):
        purge(writer.path)
    discard(writer.path, "dropped the cup")
    assert read_state(writer.path).reason == "dropped the cup"
    undo_discard(writer.path)
    assert read_state(writer.path).state == "stopped"
    assert read_state(writer.path).reason is None
    discard(writer.path, "again")
    purge(writer.path)
    assert sorted(path.name for path in writer.path.iterdir()) == ["header.json", STATE_NAME]
    with pytest.raises(UsageError, match="logs are gone"):
        undo_discard(writer.path)


def test_an_episode_has_one_journal(tmp_path: Path) -> None:
    writer = make(tmp_path)
    with pytest.raises(EpisodeExistsError):
        make(tmp_path)
    writer.stop(truncated="disk_full")
    assert read_state(writer.path).truncated == "disk_full"


def test_a_journal_is_held_by_one(tmp_path: Path) -> None:
    writer = make(tmp_path)
    with pytest.raises(BlockingIOError), locked(writer.path):
        pass
    writer.abandon()
    with locked(writer.path):
        assert read_state(writer.path).state == "recording"


@pytest.mark.parametrize("content", [b"", b"{", b'{"state": "lost"}', b"[]"])
def test_a_state_that_cannot_be_read_is_that_of_a_crash(tmp_path: Path, content: bytes) -> None:
    (tmp_path / STATE_NAME).write_bytes(content)
    assert read_state(tmp_path).state == "recording"


def test_names_of_arrays_do_not_lead_out(tmp_path: Path) -> None:
    stream = StreamHeader(device="d", port=port_document(POSE))
    header = JournalHeader(
        boot_id="b", t0_monotonic_ns=0, episode=episode(), streams={"pose": stream}
    )
    with pytest.raises(UsageError, match="no name"):
        JournalWriter(tmp_path, header, arrays={"../../up": np.eye(3)})
    assert not list(tmp_path.rglob("up*"))


def test_what_is_no_journal_is_not_listed(tmp_path: Path) -> None:
    assert list_journals(tmp_path) == []
    folder = tmp_path / ".recording"
    folder.mkdir()
    (folder / "a.rec").write_text("a file")
    (folder / "b.rec").symlink_to(tmp_path)
    (folder / "c.rec").mkdir()
    (folder / "d").mkdir()
    assert [path.name for path in list_journals(tmp_path)] == ["c.rec"]
    with pytest.raises(UsageError, match="not there"):
        discard(folder / "gone.rec", "no")


def test_growth_is_estimated_from_what_makers_state() -> None:
    taxels = Port(
        name="t", kind="taxels", payload=Rows({"data": ("<i2", (11, 6))}), stamp_point="user_rx"
    )
    sound = Port(
        name="s", kind="audio", payload=Blocks(2, "48000"), nominal_rate="50", stamp_point="user_rx"
    )
    assert bytes_per_second([POSE]) == pytest.approx(90 * (48 + 56))
    assert bytes_per_second([taxels]) == pytest.approx(100 * (48 + 132))
    assert bytes_per_second([sound]) == pytest.approx(48000 * 4 + 50 * 48)
    assert bytes_per_second([CAMERA]) == pytest.approx(30 * (48 + 0.3 * 48 * 64))


def test_a_disk_that_is_nearly_full_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    limits = SpaceLimits(soft_bytes=1000, hard_bytes=500)
    monkeypatch.setattr(space, "free_bytes", lambda _: 1000)
    check_room(tmp_path, limits)
    assert seconds_left(tmp_path, [POSE], limits) == pytest.approx(500 / (2 * 90 * 104))
    assert seconds_left(tmp_path, [], limits) == float("inf")
    monkeypatch.setattr(space, "free_bytes", lambda _: 999)
    with pytest.raises(NoRoomError, match="to begin an episode"):
        check_room(tmp_path, limits)


def test_the_reserve_is_real_room(tmp_path: Path) -> None:
    reserve = Reserve(tmp_path, 1 << 20)
    reserve.hold()
    reserve.hold()
    assert reserve.path.stat().st_blocks * 512 >= 1 << 20
    reserve.release()
    reserve.release()
    assert not reserve.path.exists()
    Reserve(tmp_path, 0).hold()
    assert not reserve.path.exists()


def test_a_state_of_a_newer_version_is_not_taken_for_a_crash(tmp_path: Path) -> None:
    writer = make(tmp_path)
    writer.stop()
    discard(writer.path, "dropped the cup")
    path = writer.path / STATE_NAME
    document = json.loads(path.read_text())
    path.write_text(json.dumps(document | {"version": "1.9", "mood": "good"}))
    assert read_state(writer.path).state == "discarded"
    path.write_text(json.dumps(document | {"version": "2.0"}))
    with pytest.raises(UnsupportedError, match="newer"):
        read_state(writer.path)
