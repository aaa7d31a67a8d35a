"""Journals become episodes that the validator finds valid, with all that was known in them."""

import json
import os
import shutil
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import simplejpeg

import exumi_data
from exumi_data.catalog import episode_path
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import DamagedDataError
from exumi_data.model import CalibrationItem
from exumi_data.store import jpeg
from exumi_recorders.calibration.apply import apply_calibration
from exumi_recorders.calibration.files import Calibration
from exumi_recorders.contract import Blocks, Event, Files, Port, Rows, Sample
from exumi_recorders.drivers.as5600 import As5600, As5600Options
from exumi_recorders.finalise.episode import finalise
from exumi_recorders.finalise.losses import FLAG
from exumi_recorders.finalise.verify import verify
from exumi_recorders.journal.header import KnownLatency
from exumi_recorders.journal.log import segment_name
from exumi_validators import validate
from tests.exumi_recorders.finalise.journals import (
    T0,
    S,
    make_dataset,
    make_journal,
    rows,
    samples,
)
from tests.exumi_recorders.numbered import (
    CAMERA,
    COUNTER,
    POSE,
    SIZE,
    a_picture,
    episode,
    picture,
    port,
    pose,
)

QUEST = Port(
    name="pose",
    kind="pose",
    payload=Rows({"raw": ("<f4", (7,))}),
    stamp_point="kernel_rx",
    nominal_rate="90",
    transform="world_frame",
    metadata={
        "frames": {"parent": "world", "child": "controller"},
        "raw": {"unit": "m", "reference_frame": "headset"},
    },
)
ENCODER = Port(
    name="width",
    kind="width",
    payload=Rows({"raw": ("<u2", ())}),
    stamp_point="bracket_mid",
    nominal_rate="200",
    transform="encoder_map",
    metadata={"raw": {"unit": "count", "modulus": 4096}},
)
WIDTH_MAP = CalibrationItem(
    value={"raw_to_data": {"raw": [3600, 3800, 4000, 4200], "data": [0.0, 0.03, 0.06, 0.08]}},
    unit="m",
    method="fitted",
)


@pytest.fixture
def dataset(tmp_path: Path) -> Path:
    return make_dataset(tmp_path / "set")


def open_final(dataset: Path) -> Episode:
    return open_episode(dataset / episode_path(episode().id))


def errors_of(dataset: Path) -> list[str]:
    report = validate(dataset / episode_path(episode().id))
    return [
        f"{found.rule} {found.message}" for found in report.problems if found.severity == "error"
    ]


def notes(found: Episode) -> dict[str, str]:
    return {note.code: note.message for note in found.metadata.quality}


def test_everything_that_came_is_in_the_episode(dataset: Path) -> None:
    journal = make_journal(
        dataset,
        {
            "pose": (POSE, samples("pose", 100, 90.0)),
            "camera": (CAMERA, samples("camera", 40)),
            "counter": (COUNTER, samples("counter", 600, 500.0)),
        },
        latency={"camera": KnownLatency(latency_ns=5_000, latency_sigma_ns=9.0, method="sweep")},
    )
    done = finalise(journal)
    assert done.outcome == "finalised"
    assert done.samples == {"pose": 100, "camera": 40, "counter": 600}
    assert not journal.exists()
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert notes(found) == {}
        camera = found["camera"]
        assert [camera.encoded(number) for number in range(40)] == list(map(picture, range(40)))
        assert camera.time_host is not None
        assert camera.time.tolist() == (camera.time_host - T0 - 5_000).tolist()
        clock = camera.metadata.clock
        assert (clock.source, clock.t_ref_ns, clock.raw_time) == ("hub_monotonic", T0, "time_host")
        assert (clock.latency_ns, clock.latency_sigma_ns, clock.method) == (5_000, 9.0, "sweep")
        assert found["pose"].data[:, 0].tolist() == list(range(100))
        assert found["counter"].data[:, 0, 0].tolist() == list(range(600))
        assert found["counter"].sequence is not None
        assert found["counter"].sequence.tolist() == list(range(600))
        assert found["pose"].metadata.gaps is None
        assert found["pose"].metadata.lost is None
        assert found.metadata.start is not None


def test_no_image_is_decoded_but_those_of_a_reference(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    decoded: list[bytes] = []
    real = simplejpeg.decode_jpeg

    def decode(data: bytes, *given: Any, **named: Any) -> Any:
        decoded.append(bytes(data))
        return real(data, *given, **named)

    monkeypatch.setattr(simplejpeg, "decode_jpeg", decode)
    touch = port(CAMERA, kind="tactile")
    given = samples("camera", 40)
    finalise(make_journal(dataset, {"camera": (CAMERA, given), "touch": (touch, given)}))
    assert decoded == []
    times = {"stream": "touch", "from_ns": T0, "until_ns": T0 + S}
    event = Event("reference", T0 + S, times)
    streams = {"camera": (CAMERA, given), "touch": (touch, given)}
    finalise(make_journal(dataset, streams, events=[event], metadata=episode(2)))
    assert decoded == list(map(picture, range(9)))


def test_a_second_run_changes_nothing(dataset: Path) -> None:
    streams = {"pose": (POSE, samples("pose", 10, 90.0))}
    journal = make_journal(dataset, streams)
    finalise(journal)
    before = {path: path.stat().st_mtime_ns for path in dataset.rglob("*") if path.is_file()}
    again = make_journal(dataset, streams)  # as if it had not been dropped any more
    assert finalise(again).outcome == "present"
    assert not again.exists()
    after = {path: path.stat().st_mtime_ns for path in dataset.rglob("*") if path.is_file()}
    assert before == after


def test_what_was_dropped_and_lost_is_told(dataset: Path) -> None:
    given = samples("camera", 20)
    given[5] = given[6] = None
    del given[12]
    counters = {
        "lost": {"camera": {"queue": 4, "kernel": 3}},
        "stamp_sigma_ns": {"toy": 250.0},
    }
    event = Event("counters", T0, counters)
    journal = make_journal(dataset, {"camera": (CAMERA, given)}, events=[event])
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        stream = found["camera"].metadata
        assert [(gap.after, gap.lost) for gap in stream.gaps or []] == [(4, 2), (9, 1), (16, 2)]
        assert stream.lost == {"kernel": 3, "queue": 4, "sequence": 1}
        assert stream.clock.offset_sigma_ns == 250.0
        flags = found["camera"].flags
        assert flags is not None
        assert np.flatnonzero(flags).tolist() == [5, 10]


def test_a_device_that_was_silent_leaves_a_gap_though_its_numbers_go_on(dataset: Path) -> None:
    given = samples("pose", 200, 90.0)
    for number in range(100, 200):
        sample = given[number]
        assert sample is not None
        given[number] = replace(sample, time_host_ns=sample.time_host_ns + 2 * S)
    finalise(make_journal(dataset, {"pose": (POSE, given)}))
    with open_final(dataset) as found:
        gaps = found["pose"].metadata.gaps or []
        assert [(gap.after, gap.lost, gap.reason) for gap in gaps] == [(99, None, "no sample came")]
        assert found["pose"].flags is not None
        assert np.flatnonzero(found["pose"].flags & 4).tolist() == [100]
        assert found["pose"].metadata.lost is None


def test_what_waited_in_the_air_leaves_no_gap_where_the_device_tells_its_time(
    dataset: Path,
) -> None:
    stamped = replace(POSE, time_device_unit="us")
    given: list[Sample | None] = []
    order = [*range(50), 52, 50, 51, *range(53, 100), *range(200, 250)]
    for came, number in enumerate(order):
        # From 60 to 70 nothing comes; then all of it at once.
        at = max(number, 70 + came / 1000) if 60 <= number <= 70 else number
        sent_us = round(number * 1e6 / 90)
        host_ns = T0 + S + round(at * S / 90)
        sequence = number if number < 100 else number - 100  # it was silent, and nothing is lost
        sample = Sample("pose", host_ns, pose(came), time_device_ns=sent_us, sequence=sequence)
        given.append(sample)
    finalise(make_journal(dataset, {"pose": (stamped, given)}))
    with open_final(dataset) as found:
        gaps = found["pose"].metadata.gaps or []
        assert [(gap.after, gap.lost) for gap in gaps] == [(99, None)]


def test_poses_are_in_the_world_that_was_marked(dataset: Path) -> None:
    raw = [(0.1 * np.sin(n / 20), 1.0, 0.2, 0, 0, 0, 1 if n < 60 else -1) for n in range(120)]
    raw[70] = (0, 0, 0, 0, 0, 0, 0)
    marked = [0.0, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    moved = [0.5, 1.0, 0.0, 0.0, 0.0, 0.0, 1.0]
    events = [
        Event("world_frame", T0 - 60 * S, {"pose": [9.0, 9, 9, 0, 0, 0, 1]}),
        Event("world_frame", T0 - 50 * S, {"pose": marked}),
        Event("world_frame", T0 + round(100.5 / 90 * S), {"pose": moved}),
        Event("world_frame", T0 + S, {"pose": ["bad"]}),
    ]
    journal = make_journal(
        dataset, {"pose": (QUEST, rows("pose", raw, "<7f", 90.0))}, events=events
    )
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        pose = found["pose"]
        assert pose.raw is not None
        assert pose.raw.dtype == np.float32
        assert pose.flags is not None
        assert np.flatnonzero(pose.flags).tolist() == [70]
        good = np.arange(120) != 70
        np.testing.assert_allclose(pose.data[good, 1], 0.2, atol=1e-6)  # z of Unity is y here
        np.testing.assert_allclose(pose.data[good, 2], 0.0, atol=1e-6)
        np.testing.assert_allclose(pose.data[:70, 0], pose.raw[:70, 0], atol=1e-6)
        np.testing.assert_allclose(pose.data[100:, 0], pose.raw[100:, 0] - 0.5, atol=1e-6)
        np.testing.assert_allclose(pose.data[good, 6], 1.0)
        items = found.metadata.calibration
        assert items["world_frame"].value == marked
        assert items["world_frame/2"].value == moved
        model: Any = pose.metadata
        assert model.raw.transform == "world_frame"
        assert "world-frame-moved" in notes(found)


def test_without_a_world_poses_stay_in_the_headset(dataset: Path) -> None:
    raw = [(0.0, 1.0, 2.0, 0, 0, 0, 1)] * 10
    finalise(make_journal(dataset, {"pose": (QUEST, rows("pose", raw, "<7f", 90.0))}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert found["pose"].data[0].tolist() == [0, 2, 1, 0, 0, 0, 1]
        assert set(notes(found)) == {"world-frame-missing"}


def test_counts_become_widths(dataset: Path) -> None:
    counts = [*range(3600, 4096, 8), *range(0, 104, 8), 104, 140]
    journal = make_journal(
        dataset,
        {"width": (ENCODER, rows("width", [(each,) for each in counts], "<H", 200.0))},
        metadata=episode(calibration={"width_map": WIDTH_MAP}),
    )
    finalise(journal)
    assert errors_of(dataset) == []
    assert validate(dataset / episode_path(episode().id)).problems == ()
    with open_final(dataset) as found:
        width = found["width"]
        assert width.raw is not None
        assert width.raw.tolist() == counts
        assert width.data[0] == 0.0
        # Beyond the map's end that is held, as it is when the calibration is applied again.
        assert width.data[-2] == width.data[-1] == np.float32(0.08)
        assert (np.diff(width.data[:-1]) > 0).all()
        assert width.flags is not None
        assert np.flatnonzero(width.flags & 16).tolist() == [len(counts) - 1]
        model: Any = width.metadata
        assert (model.raw.transform, model.raw.modulus) == ("width_map", 4096)


def test_counts_with_their_turns_become_widths(dataset: Path) -> None:
    long = {"raw_to_data": {"raw": [-6000, 400], "data": [0.08, 0.0]}}
    items = {"width_map": CalibrationItem(value=long, method="gauge", unit="m")}
    counting = As5600(As5600Options(home=400)).ports[0]
    counts = [400, -2800, -6000, -6001]
    journal = make_journal(
        dataset,
        {"width": (counting, rows("width", [(each,) for each in counts], "<i", 200.0))},
        metadata=episode(calibration=items),
    )
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert found["width"].data == pytest.approx([0.0, 0.04, 0.08, 0.08])
        assert found["width"].flags is not None
        assert found["width"].flags.tolist() == [0, 0, 0, 16]


def test_a_map_of_several_turns_tells_nothing_of_counts_that_wrap(dataset: Path) -> None:
    long = {"raw_to_data": {"raw": [-6000, 400], "data": [0.08, 0.0]}}
    items = {"width_map": CalibrationItem(value=long, method="gauge", unit="m")}
    journal = make_journal(
        dataset,
        {"width": (ENCODER, rows("width", [(7,), (8,)], "<H", 200.0))},
        metadata=episode(calibration=items),
    )
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert np.isnan(found["width"].data).all()
        assert "width-not-calibrated" in notes(found)


def test_counts_without_a_map_are_kept_as_they_are(dataset: Path) -> None:
    journal = make_journal(dataset, {"width": (ENCODER, rows("width", [(7,), (8,)], "<H", 200.0))})
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert found["width"].raw is not None
        assert found["width"].raw.tolist() == [7, 8]
        assert np.isnan(found["width"].data).all()
        assert "width-not-calibrated" in notes(found)


def test_a_map_that_is_made_later_makes_widths_of_counts(dataset: Path) -> None:
    counts = [(number,) for number in range(0, 40, 4)]
    recorded = rows("width", counts, "<H", 200.0)
    assert recorded[3] is not None
    recorded[3] = replace(recorded[3], flags=FLAG["invalid"])  # the magnet was not seen
    journal = make_journal(dataset, {"width": (ENCODER, recorded)})
    finalise(journal)
    path = dataset / episode_path(episode().id)
    apply_calibration(path, Calibration({"width_map": WIDTH_MAP}), "a file")
    assert validate(path).problems == ()
    with open_final(dataset) as found:
        flags = found["width"].flags
        assert flags is not None
        assert np.flatnonzero(flags & FLAG["invalid"]).tolist() == [3]
        assert np.isfinite(found["width"].data).all()
        assert "width-not-calibrated" not in notes(found)


def test_files_that_are_no_images_are_left_out(dataset: Path) -> None:
    given = samples("camera", 12)
    wrong = jpeg.encode(np.zeros((16, 16, 3), np.uint8), 80)
    for number, bad in ((0, b""), (4, b"no JPEG"), (5, a_picture()[:-20]), (9, wrong), (11, b"x")):
        sample = given[number]
        assert sample is not None
        given[number] = replace(sample, payload=bad)
    finalise(make_journal(dataset, {"camera": (CAMERA, given)}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        stream = found["camera"]
        assert len(stream) == 7
        gaps = [(gap.after, gap.lost) for gap in stream.metadata.gaps or []]
        assert gaps == [(-1, 1), (2, 2), (5, 1), (6, 1)]
        assert stream.metadata.lost == {"unreadable": 5}
        assert "5 payloads of camera were no JPEG of 64x48" in notes(found)["files-left-out"]


def test_poses_that_jumped_are_told_of(dataset: Path) -> None:
    events = [Event("pose_jump", T0 + S, {"port": "pose", "distance_m": m}) for m in (0.4, 1.25)]
    events.append(Event("pose_jump", T0 + S, {"port": "headset", "distance_m": 3.0}))
    finalise(make_journal(dataset, {"tool": (POSE, samples("pose", 9, 90.0))}, events=events))
    with open_final(dataset) as found:
        assert notes(found) == {"pose-jumped": "the pose jumped 2 times, by up to 1.25 m"}


def test_a_stream_without_a_sample_is_left_out(dataset: Path) -> None:
    streams = {"pose": (POSE, samples("pose", 5, 90.0)), "camera": (CAMERA, [])}
    bad = {"camera2": (CAMERA, [Sample("camera", T0 + 1, b"no JPEG")])}
    finalise(make_journal(dataset, {**streams, **bad}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert list(found.streams) == ["pose"]
        codes = [(note.code, note.stream) for note in found.metadata.quality]
        assert codes == [
            ("stream-empty", None),
            ("files-left-out", None),
            ("stream-empty", None),
        ]


def test_sound_is_kept_in_blocks(dataset: Path) -> None:
    sound = Port(
        name="sound",
        kind="audio",
        payload=Blocks(2, "48000"),
        nominal_rate="100",
        stamp_point="user_rx",
        droppable=True,
    )
    blocks = [
        struct.pack("<960h", *(n % 100 for n in range(k, k + 960))) if k != 3 else b"odd"
        for k in range(20)
    ]
    given = [Sample("sound", T0 + k * 10_000_000, data) for k, data in enumerate(blocks)]
    finalise(make_journal(dataset, {"sound": (sound, given)}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert len(found["sound"]) == 19
        assert found["sound"].metadata.lost == {"unreadable": 1}


def test_taxels_have_their_mask_and_numbers_that_are_none_are_flagged(dataset: Path) -> None:
    taxels = Port(
        name="taxels",
        kind="taxels",
        payload=Rows({"data": ("<f4", (1, 2))}),
        stamp_point="user_rx",
        valid=((True, False),),
        metadata={"grid": (1, 2), "unit": "1", "sign": -1, "offset": 3500.0},
    )
    values = [(1.0, 2.0), (float("inf"), 2.0), (float("nan"), 0.0), (4.0, 5.0)]
    finalise(make_journal(dataset, {"taxels": (taxels, rows("taxels", values, "<2f", 100.0))}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        stream = found["taxels"]
        assert stream.valid is not None
        assert stream.valid.tolist() == [[True, False]]
        assert stream.flags is not None
        assert stream.flags.tolist() == [0, 8, 8, 0]
        assert stream.data[3].tolist() == [[4.0, 5.0]]


def test_kinds_of_others_and_device_times_are_written_as_they_are(dataset: Path) -> None:
    wrench = Port(
        name="force",
        kind="wrench",
        payload=Rows({"data": ("<f4", (2,)), "raw": ("<i4", (2,))}),
        stamp_point="user_rx",
        time_device_unit="us",
        modulus=256,
        metadata={"components": ["fx", "fz"], "raw": {"unit": "count"}},
    )
    heat = Port(
        name="heat",
        kind="acme:thermal",
        payload=Rows({"data": ("<u2", (2, 2))}),
        stamp_point="user_rx",
        metadata={"extension_version": "1", "schema_url": "https://acme.example/thermal"},
    )
    forces = [
        Sample("force", T0 + k * S // 10, struct.pack("<2f2i", k, -k, k, -k), k * 7, k % 256)
        for k in range(300)
    ]
    warm = [Sample("heat", T0 + k * S // 10, struct.pack("<4H", k, 1, 2, 3)) for k in range(4)]
    finalise(make_journal(dataset, {"force": (wrench, forces), "heat": (heat, warm)}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        force = found["force"]
        assert force.time_device is not None
        assert force.time_device.tolist() == [k * 7 for k in range(300)]
        assert force.sequence is not None
        assert force.sequence.tolist() == list(range(300))
        assert force.raw is not None
        assert force.raw[5].tolist() == [5, -5]
        assert found["heat"].data[3].tolist() == [[3, 1], [2, 3]]
        assert found["heat"].sequence is None


def test_a_silence_without_numbers_is_a_gap(dataset: Path) -> None:
    given = [sample for k, sample in enumerate(samples("pose", 90, 90.0)) if not 40 <= k < 60]
    given = [replace(sample, sequence=None) for sample in given if sample is not None]
    finalise(make_journal(dataset, {"pose": (POSE, given)}))
    with open_final(dataset) as found:
        assert [(gap.after, gap.lost) for gap in found["pose"].metadata.gaps or []] == [(39, None)]
    assert errors_of(dataset) == []


def test_the_reference_of_a_finger_is_the_calibrations(dataset: Path) -> None:
    touch = port(CAMERA, kind="tactile")
    image = np.full(SIZE, 90, np.uint8)
    item = CalibrationItem(
        value=None, method="captured", array="calibration/tactile_reference/touch"
    )
    lost = CalibrationItem(value=None, method="captured", array="calibration/gone")
    journal = make_journal(
        dataset,
        {"touch": (touch, samples("camera", 10))},
        metadata=episode(calibration={"tactile_reference/touch": item, "gone": lost}),
        arrays={"tactile_reference/touch": image},
    )
    finalise(journal)
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert found["touch"].reference is not None
        assert (found["touch"].reference == 90).all()
        assert found.calibration_array("tactile_reference/touch").shape == SIZE
        assert "gone" not in found.metadata.calibration
        assert set(notes(found)) == {"calibration-lost"}


@pytest.mark.parametrize("what", ["pipe", "link", "words", "rubbish"])
def test_calibration_arrays_that_are_none(dataset: Path, what: str) -> None:
    item = CalibrationItem(value=None, array="calibration/map")
    journal = make_journal(
        dataset,
        {"pose": (POSE, samples("pose", 5, 90.0))},
        metadata=episode(calibration={"map": item}),
        arrays={"map": np.array(["a", "b"]) if what == "words" else np.eye(2)},
    )
    path = journal / "calibration" / "map.npy"
    if what != "words":
        path.unlink()
    if what == "pipe":
        os.mkfifo(path)
    elif what == "link":
        path.symlink_to("/dev/zero")
    elif what == "rubbish":
        path.write_bytes(b"\x93NUMPY rubbish")
    finalise(journal)
    with open_final(dataset) as found:
        assert set(notes(found)) == {"calibration-lost"}


def test_quiet_frames_that_the_operator_named_are_the_reference(dataset: Path) -> None:
    touch = port(CAMERA, kind="tactile")
    times = {"stream": "touch", "from_ns": T0 + S // 10, "until_ns": T0 + S // 5}
    events = [Event("reference", T0 + S // 5, times)]
    given = samples("camera", 20)
    finalise(make_journal(dataset, {"touch": (touch, given)}, events=events))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        model: Any = found["touch"].metadata
        assert model.reference.method == "captured"
        assert model.reference.frames == [2, 3, 4, 5]
        expected = np.empty(SIZE, np.uint8)
        jpeg.decode_into(a_picture(), expected)
        assert found["touch"].reference is not None
        assert (found["touch"].reference == expected).all()


def test_what_happened_is_kept_with_the_source(dataset: Path) -> None:
    events = [
        Event("record_flag", T0 + 5, {"on": True}),
        Event("device_lost", T0 + S, {"error": "gone"}),
    ]
    streams = {"pose": (port(POSE, lossy="rounded"), samples("pose", 5, 90.0))}
    finalise(make_journal(dataset, streams, events=events, state="recording"))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert set(notes(found)) == {"recovered", "device-lost"}
        settings = found.metadata.source.settings
        assert settings is not None
        kept = [(each["time_ns"], each["name"]) for each in settings["events"]]
        assert kept == [(5, "record_flag"), (S, "device_lost")]
        assert [step.detail for step in found.metadata.source.lossy or []] == ["rounded"]
        gaps = [(gap.after, gap.lost) for gap in found["pose"].metadata.gaps or []]
        assert gaps == [(4, None)]


def test_events_that_no_document_can_hold_do_no_harm(dataset: Path) -> None:
    deep: Any = []
    for _ in range(200):
        deep = [deep]
    details: list[Any] = [
        {"value": float("nan")},
        {"value": float("inf")},
        {"text": "\ud800"},
        {"deep": deep},
        {"long": "x" * 100_000},
        {"many": list(range(5000))},
    ]
    counters = {"lost": {"pose": {"a\nb": 2, "late": True, "crc": 1, "sequence": -3}}, "x": 1}
    events = [Event("odd", T0 + 1, detail) for detail in details]
    events += [Event("counters", T0 + 2, counters), Event("fine", T0 + 3, {"a": 1})]
    events += [Event("again", T0 + 4 + k, {"list": [0] * 100}) for k in range(1000)]
    streams = {"pose": (POSE, samples("pose", 5, 90.0))}
    finalise(make_journal(dataset, streams, events=events))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        settings = found.metadata.source.settings
        assert settings is not None
        names = [event["name"] for event in settings["events"]]
        assert names[: len(details) + 1] == ["unreadable"] * len(details) + ["fine"]
        assert len(names) + settings["events_left_out"] == len(details) + 1 + 1000
        assert found["pose"].metadata.lost == {"crc": 1, "other": 2}


def test_a_driver_that_stops_to_count_costs_no_sample(dataset: Path) -> None:
    many = samples("pose", 8200, 90.0)
    given = [
        replace(each, sequence=None) if k > 8190 else each for k, each in enumerate(many) if each
    ]
    finalise(make_journal(dataset, {"pose": (POSE, given)}))
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert len(found["pose"]) == 8200


def test_damage_is_reported_with_its_place(dataset: Path) -> None:
    journal = make_journal(dataset, {"camera": (CAMERA, samples("camera", 20))})
    path = journal / "camera" / segment_name(0)
    data = bytearray(path.read_bytes())
    size = len(data) // 20
    data[7 * size + 100] ^= 1
    path.write_bytes(data[:-5])
    done = finalise(journal)
    assert [(damage.offset, damage.bytes, damage.lost) for damage in done.damages] == [
        (7 * size, size, 1),
        (19 * size, size - 5, None),
    ]
    assert errors_of(dataset) == []
    with open_final(dataset) as found:
        assert len(found["camera"]) == 18
        assert found["camera"].metadata.lost == {"journal": 1}
        assert "000000.log at" in notes(found)["journal-damaged"]


def test_an_episode_that_does_not_read_back_is_not_published(
    dataset: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    journal = make_journal(dataset, {"camera": (CAMERA, samples("camera", 5))})
    before = {path: path.read_bytes() for path in journal.rglob("*") if path.is_file()}

    def spoil(path: Path, counts: dict[str, int]) -> None:
        shard = path / "streams" / "camera" / "data" / "c" / "0"
        data = bytearray(shard.read_bytes())
        data[1000] ^= 1
        shard.write_bytes(data)
        verify(path, counts)

    monkeypatch.setattr("exumi_recorders.finalise.episode.verify", spoil)
    with pytest.raises(DamagedDataError, match="wrong checksum"):
        finalise(journal)
    assert {path: path.read_bytes() for path in journal.rglob("*") if path.is_file()} == before
    assert not list((dataset / "episodes").rglob("*.zarr"))
    monkeypatch.undo()
    assert finalise(journal).outcome == "finalised"


def test_fewer_samples_than_were_read_are_noticed(dataset: Path) -> None:
    finalise(make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))}))
    path = dataset / episode_path(episode().id)
    verify(path, {"pose": 5, "camera": 0})
    with pytest.raises(DamagedDataError, match="expected"):
        verify(path, {"pose": 6})


def test_a_header_of_another_journal_is_refused(dataset: Path) -> None:
    journal = make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))})
    other = json.loads((journal / "header.json").read_text())
    other["episode"]["id"] = episode(2).id
    (journal / "header.json").write_text(json.dumps(other))
    shutil.rmtree(journal / "header")
    with pytest.raises(DamagedDataError, match="the header is that of"):
        finalise(journal)
    assert journal.exists()


def test_the_dataset_opens(dataset: Path) -> None:
    finalise(make_journal(dataset, {"pose": (POSE, samples("pose", 5, 90.0))}))
    with pytest.warns(exumi_data.CatalogWarning):
        assert len(exumi_data.open(dataset)) == 1  # type: ignore[arg-type]


def test_a_file_form_states_its_size() -> None:
    assert Files(*SIZE).media_type == "image/jpeg"
