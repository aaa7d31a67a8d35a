"""The three layouts of Octopi's data, and what becomes of clips that are odd."""

import hashlib
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path
from typing import Any

import av
import cv2
import numpy as np
import pytest

from exumi_converters import ConversionReport, ConvertOptions, convert
from exumi_converters.octopi_layout import detect_layout
from exumi_data.dataset import Dataset
from exumi_data.episode import Episode
from exumi_data.errors import SourceError, UsageError
from exumi_data.model import EncodedImages, TactileStream
from exumi_data.store.video import FramePixels
from exumi_data.tactile import (
    ActivityMeter,
    choose_reference,
    difference_energy,
    reference_image,
    salient_frames,
    thumbnail,
)

Run = Callable[..., tuple[ConversionReport, Dataset]]


def by_key(dataset: Dataset) -> dict[str | None, Episode]:
    return {episode.metadata.source.key: episode for episode in dataset}


def tactile(episode: Episode) -> TactileStream:
    model = episode["tactile"].metadata
    assert isinstance(model, TactileStream)
    return model


def codes(report: ConversionReport) -> set[tuple[str, str]]:
    return {(flag.name, flag.code) for flag in report.flagged}


# ----------------------------------------------------------------------------------------- Octopi-1


def test_every_clip_is_kept_byte_for_byte(octopi: Path, labels: Path, run: Run) -> None:
    report, dataset = run(octopi, "octopi", labels=labels)
    assert (report.total, report.converted, report.failed) == (5, 5, ())
    assert report.frames == 150
    for key, episode in by_key(dataset).items():
        original = (octopi / str(key)).read_bytes()
        stream = episode["tactile"]
        assert stream.container(0) == original
        (file,) = tactile(episode).images.files  # type: ignore[union-attr]  # a video stream
        assert (file.name, file.codec, file.bytes) == (key, "mpeg4", len(original))
        assert file.sha256 == hashlib.sha256(original).hexdigest()
        assert [(i.name, i.sha256) for i in episode.metadata.source.inputs or []] == [
            (key, file.sha256)
        ]


def test_frames_and_times_are_those_that_the_clip_decodes_to(octopi: Path, run: Run) -> None:
    _, dataset = run(octopi, "octopi")
    stream = by_key(dataset)["egg_1.mov"]["tactile"]
    with av.open(str(octopi / "egg_1.mov")) as container:
        frames = list(container.decode(video=0))
    expected = np.stack([FramePixels().rgb(frame) for frame in frames])
    assert np.array_equal(stream.frames[:], expected)
    backwards = np.arange(len(frames))[::-1]
    assert np.array_equal(stream.frames[backwards], expected[backwards])
    assert stream.time.tolist() == [40_000_000 * i for i in range(30)]
    model = stream.metadata
    assert (model.nominal_rate, model.clock.source) == ("25/1", "container")
    assert model.clock.stamp_point == "nominal_rate"
    assert model.sensor is not None
    assert model.sensor.model == "gelsight-mini"
    assert [step.step for step in dataset[0].metadata.source.lossy or []] == ["video-encode"]


def test_what_is_derived_is_what_the_tactile_maths_say(octopi: Path, run: Run) -> None:
    _, dataset = run(octopi, "octopi")
    episode = by_key(dataset)["egg_0.mov"]
    stream = episode["tactile"]
    greys = stream.frames.read(range(30), grey=True)[..., 0]
    choice = choose_reference([thumbnail(grey) for grey in greys])
    reference = reference_image(list(stream.frames[list(choice.frames)]))
    assert np.array_equal(stream.reference, reference)  # type: ignore[arg-type]  # there is one
    about = tactile(episode).reference
    assert about is not None
    assert about.method == "selected"
    assert about.frames == list(choice.frames)
    meter = ActivityMeter(reference)
    expected = np.array([meter.measure(grey) for grey in greys], np.float32)
    assert stream.activity is not None
    assert np.array_equal(stream.activity, expected)
    assert stream.activity.dtype == np.float32
    assert (stream.activity[10:20] > 1e-3).all()
    assert (stream.activity[:10] < 1e-3).all()
    energies = [0, *(difference_energy(a, b) for a, b in pairwise(greys))]
    assert np.array_equal(stream.salient, salient_frames(energies))  # type: ignore[arg-type]  # there are some
    assert episode.derived is not None
    activity = episode.derived.items["tactile/activity"]
    assert (activity.algorithm, activity.parameters["active_above"]) == ("exumi-activity/1", 1e-3)
    assert activity.inputs == ["streams/tactile/data", "streams/tactile/reference"]
    assert episode.derived.items["tactile/salient"].parameters == {"k": 10}


def test_a_clip_that_begins_in_contact_has_a_reference_without(
    tmp_path: Path, make_clip: Any, make_frames: Any, run: Run
) -> None:
    frames = make_frames(60, range(25))
    make_clip(tmp_path / "in" / "egg_0.mov", frames)
    _, dataset = run(tmp_path / "in", "octopi")
    stream = dataset[0]["tactile"]
    chosen = tactile(dataset[0]).reference
    assert chosen is not None
    assert min(chosen.frames or []) >= 25
    assert stream.activity is not None
    assert (stream.activity[:24] > 1e-3).all()
    assert (stream.activity[30:] < 1e-3).all()


def test_labels_come_with_scale_provenance_and_origin(octopi: Path, labels: Path, run: Run) -> None:
    report, dataset = run(octopi, "octopi", labels=labels)
    episodes = by_key(dataset)
    about = episodes["egg_1.mov"].metadata.annotations
    assert about is not None
    assert (about.part_id, about.object_id, about.object) == ("egg", "an_egg", "an egg")
    assert (about.trial, about.pad_type, about.procedure) == (1, "plain", None)
    found = {label.property: label for label in about.labels or []}
    assert found["hardness"].value == 7.67
    assert found["hardness"].scale == [0.0, 10.0]
    assert found["hardness"].provenance == "human"
    assert found["hardness"].origin == "labels.csv: mean of about three raters"
    assert found["hardness"].raters is None
    assert found["hardness_class"].value == "hard"
    assert found["adjectives"].value == ["smooth", "hard"]
    # An id that is the beginning of another gets its own labels only.
    rice = episodes["rice_0.mov"].metadata.annotations
    spatula = episodes["rice_spatula_base_0.mov"].metadata.annotations
    assert rice is not None
    assert spatula is not None
    assert (rice.part_id, rice.object_id) == ("rice", "a_scoop_of_rice")
    assert (spatula.part_id, spatula.part) == ("rice_spatula_base", "scoop")
    assert [label.property for label in spatula.labels or []] == ["hardness"]
    # A clip without a row is converted, and says so.
    apple = episodes["apple_0.mov"].metadata.annotations
    assert apple is not None
    assert (apple.part_id, apple.labels) == ("apple", None)
    assert codes(report) == {("apple_0.mov", "no-labels")}
    assert any("no row for 1 id(s) of clips: apple (1)" in text for text in report.notices)


def test_published_splits_are_files_of_the_dataset(octopi: Path, labels: Path, run: Run) -> None:
    _, dataset = run(octopi, "octopi", labels=labels)
    ids = {key: episode.id for key, episode in by_key(dataset).items()}
    split = dataset.splits["octopi1"]
    assert split.level == "part"
    assert split.lists == {
        "train": sorted([ids["egg_0.mov"], ids["egg_1.mov"], ids["rice_0.mov"]]),
        "test": [ids["rice_spatula_base_0.mov"]],
    }
    assert list(dataset.splits) == ["octopi1"]


def test_an_unknown_label_id_is_named(octopi: Path, labels: Path, run: Run) -> None:
    with labels.open("a") as file:
        file.write("eggplant,an eggplant,,,3,3,,,\n")
    report, _ = run(octopi, "octopi", labels=labels)
    assert any("1 id(s) match no clip: eggplant" in text for text in report.notices)


def test_files_that_are_no_clips_are_named(octopi: Path, run: Run) -> None:
    (octopi / "notes.txt").write_text("hello")
    (octopi / "more").mkdir()
    report, _ = run(octopi, "octopi")
    assert any("2 file(s) and folder(s)" in n and "notes.txt" in n for n in report.notices)


def test_a_name_without_a_trial_is_converted_and_named(
    tmp_path: Path, make_clip: Any, run: Run
) -> None:
    make_clip(tmp_path / "in" / "egg.mov")
    make_clip(tmp_path / "in" / "egg_new.mov")
    report, dataset = run(tmp_path / "in", "octopi")
    about = by_key(dataset)["egg.mov"].metadata.annotations
    other = by_key(dataset)["egg_new.mov"].metadata.annotations
    assert about is not None
    assert other is not None
    assert (about.part_id, about.trial) == (None, None)
    assert (other.part_id, other.trial) == ("egg", None)
    assert any("their part is not known: egg.mov" in text for text in report.notices)


def test_two_equal_files_are_two_episodes(octopi: Path, run: Run) -> None:
    (octopi / "egg_7.mov").write_bytes((octopi / "egg_0.mov").read_bytes())
    report, dataset = run(octopi, "octopi")
    assert report.converted == len(dataset) == 6


# ------------------------------------------------------------------------------- clips that are odd


def test_a_cut_clip_is_converted_and_flagged(tmp_path: Path, make_clip: Any, run: Run) -> None:
    whole = make_clip(tmp_path / "egg_0.mov", 60, faststart=True).read_bytes()
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "egg_0.mov").write_bytes(whole[: len(whole) * 6 // 10])
    report, dataset = run(tmp_path / "in", "octopi")
    stream = dataset[0]["tactile"]
    assert 10 < len(stream) < 60
    assert stream.container(0) == (tmp_path / "in" / "egg_0.mov").read_bytes()
    assert stream.frames[:].shape[0] == len(stream)
    (flag,) = (flag for flag in report.flagged if flag.code == "truncated")
    assert flag.severity == "warning"
    assert f"declares 60 frames, {len(stream)} can be decoded" in flag.message


def test_the_incomplete_last_frame_is_left_out(tmp_path: Path, make_clip: Any, run: Run) -> None:
    whole = make_clip(tmp_path / "egg_0.mov", 60, faststart=True).read_bytes()
    (tmp_path / "in").mkdir()
    cut = tmp_path / "in" / "egg_0.mov"
    cut.write_bytes(whole[: len(whole) * 6 // 10])
    with av.open(str(cut)) as container:
        corrupt = [bool(frame.is_corrupt) for frame in container.decode(video=0)]
    assert corrupt[-1]
    assert not any(corrupt[:-1])
    _, dataset = run(tmp_path / "in", "octopi")
    assert len(dataset[0]["tactile"]) == len(corrupt) - 1


def test_a_clip_that_is_short_beside_its_siblings_is_flagged(
    tmp_path: Path, make_clip: Any, run: Run
) -> None:
    for trial in range(6):
        make_clip(tmp_path / "in" / f"egg_{trial}.mov", 30, seed=trial)
    make_clip(tmp_path / "in" / "rice_0.mov", 7)
    make_clip(tmp_path / "in" / "rice_1.mov", 27)
    make_clip(tmp_path / "in" / "rice_2.mov", 12, rate="10")
    report, dataset = run(tmp_path / "in", "octopi")
    found = {flag.name: flag for flag in report.flagged if flag.code in ("truncated", "short")}
    assert (found["rice_0.mov"].code, found["rice_0.mov"].severity) == ("truncated", "warning")
    assert "has 7 frames" in found["rice_0.mov"].message
    assert "have 30" in found["rice_0.mov"].message
    assert (found["rice_1.mov"].code, found["rice_1.mov"].severity) == ("short", "info")
    assert set(found) == {"rice_0.mov", "rice_1.mov"}  # another rate has other siblings
    assert by_key(dataset)["rice_2.mov"]["tactile"].metadata.nominal_rate == "10/1"


@pytest.mark.parametrize("what", ["no frames", "no header", "no video", "empty"])
def test_what_cannot_be_read_fails_by_name_and_the_rest_is_converted(
    octopi: Path, make_clip: Any, run: Run, tmp_path: Path, what: str
) -> None:
    bad = octopi / "bad_0.mov"
    whole = make_clip(tmp_path / "x_0.mov", 30, faststart=True).read_bytes()
    header = whole.index(b"mdat") + 4
    content = {
        "no frames": whole[:header],
        "no header": make_clip(tmp_path / "y_0.mov", 30).read_bytes()[:3000],
        "no video": b"This is a text, not a video.",
        "empty": b"",
    }
    bad.write_bytes(content[what])
    report, dataset = run(octopi, "octopi")
    (failure,) = report.failed
    assert failure.name == "bad_0.mov"
    assert "bad_0.mov" in failure.reason
    assert (
        "no frame can be decoded" if what == "no frames" else "not a readable"
    ) in failure.reason
    assert not report.complete
    assert (report.total, report.converted, len(dataset)) == (6, 5, 5)
    assert not list((tmp_path / "out").rglob(".partial-*"))


# --------------------------------------------------------------------------------------- Octopi-1.5


def test_the_raw_tree(raw_tree: Path, labels: Path, run: Run) -> None:
    report, dataset = run(raw_tree, "octopi", labels=labels)
    assert report.layout.startswith("Octopi-1.5 raw: ")
    assert report.failed == ()
    episodes = by_key(dataset)
    facts = {}
    for key, episode in episodes.items():
        about = episode.metadata.annotations
        assert about is not None
        sensor = episode["tactile"].metadata.sensor
        assert sensor is not None
        facts[key] = (about.part_id, about.procedure, about.trial, about.pad_type, sensor.model)
    assert facts == {
        "physiclear/Pressing/egg_0.mov": ("egg", "press", 0, "plain", "gelsight-mini"),
        "physiclear/Sliding/egg_0.mov": ("egg", "slide", 0, "plain", "gelsight-mini"),
        "physicleardotted/Rolling/egg_0.mov": ("egg", "rolling", 0, "dotted", "gelsight-mini"),
        "hardness/basic/ball_soft_x_4.mp4": (
            "hardness_ball_soft",
            None,
            4,
            None,
            "gelsight-2017",
        ),
        "objectfolder/12/tactile_data/3/0/gelsight": (
            "objectfolder_12",
            "press",
            3,
            "plain",
            "gelsight",
        ),
    }
    assert any("12 file(s) and folder(s) outside the layout" in text for text in report.notices)
    egg = episodes["physicleardotted/Rolling/egg_0.mov"].metadata.annotations
    assert egg is not None
    assert egg.object_id == "an_egg"


def test_png_frames_are_kept_as_pixels(raw_tree: Path, run: Run) -> None:
    report, dataset = run(raw_tree, "octopi")
    key = "objectfolder/12/tactile_data/3/0/gelsight"
    stream = by_key(dataset)[key]["tactile"]
    assert tactile(by_key(dataset)[key]).images.encoding == "array"
    for index in range(12):
        image = cv2.imread(str(raw_tree / key / f"{index}.png"))
        assert image is not None
        assert np.array_equal(stream.frames[index], image[..., ::-1])
    assert stream.time.tolist() == [40_000_000 * i for i in range(12)]
    assert stream.activity is not None
    assert stream.activity.shape == (12,)
    assert (key, "assumed-rate") in codes(report)


def test_processed_samples_keep_their_jpegs(samples: Path, run: Run) -> None:
    report, dataset = run(samples, "octopi")
    assert report.layout.startswith("Octopi-1.5 samples: 3 folder(s)")
    episode = by_key(dataset)["physiclear_0"]
    stream = episode["tactile"]
    paths = sorted((samples / "physiclear_0" / "tactile").iterdir())
    assert [stream.encoded(i) for i in range(5)] == [path.read_bytes() for path in paths]
    # The files' numbers are the frames' numbers in the clip: what lies between is missing.
    assert stream.time.tolist() == [40_000_000 * n for n in (4, 5, 6, 11, 12)]
    model = stream.metadata
    assert [(gap.after, gap.lost) for gap in model.gaps or []] == [(2, 4)]
    assert (model.clock.source, model.clock.stamp_point) == ("none", "nominal_rate")
    images = tactile(episode).images
    assert isinstance(images, EncodedImages)
    steps = [step.step for step in episode.metadata.source.lossy or []]
    assert steps == ["frame-selection", "jpeg-encode"]
    about = episode.metadata.annotations
    assert about is not None
    assert (about.part_id, about.part, about.trial) == ("egg", "an egg", 3)
    assert (about.procedure, about.pad_type) == ("press", "plain")
    assert {label.property: label.value for label in about.labels or []} == {
        "hardness": 7.67,
        "roughness": 1.33,
    }
    assert codes(report) >= {("physiclear_0", "assumed-rate")}
    dotted = by_key(dataset)["physicleardotted_0"].metadata.annotations
    assert dotted is not None
    assert (dotted.pad_type, dotted.procedure) == ("dotted", "slide")
    assert dataset.splits["octopi15"].lists["val"] == [by_key(dataset)["physicleardotted_0"].id]
    unlabelled = by_key(dataset)["hardness_7"].metadata.annotations
    assert unlabelled is not None
    assert (unlabelled.object_id, unlabelled.labels) == ("hardness_ball_soft", None)


def test_the_user_can_state_the_rate_of_samples(samples: Path, run: Run) -> None:
    report, dataset = run(samples, "octopi", rate="10")
    stream = by_key(dataset)["physiclear_0"]["tactile"]
    assert stream.time.tolist() == [100_000_000 * n for n in (4, 5, 6, 11, 12)]
    assert not any(code == "assumed-rate" for _, code in codes(report))


@pytest.mark.parametrize(
    ("document", "reason"),
    [
        ("{", "cannot be read"),
        ('{"object": "an egg"}', "no object_id"),
        (
            '{"object_id": "physiclear_egg", "properties": {"hardness": "soft"}}',
            "hardness is 'soft'",
        ),
        ('{"object_id": "physiclear_egg", "properties": {"hardness": 11}}', "not a number from 0"),
    ],
)
def test_a_sample_with_a_broken_document_fails_by_name(
    samples: Path, run: Run, document: str, reason: str
) -> None:
    (samples / "physiclear_0" / "data.json").write_text(document)
    report, dataset = run(samples, "octopi")
    (failure,) = report.failed
    assert failure.name == "physiclear_0"
    assert reason in failure.reason
    assert (report.total, len(dataset)) == (3, 2)


@pytest.mark.parametrize(
    ("name", "content", "reason"),
    [
        ("cover.jpg", b"", "cover.jpg is not the number of a frame"),
        ("4.jpg", b"", "there are two frames 4"),
        ("0000000099.png", b"", "both JPEG and PNG"),
    ],
)
def test_a_sample_with_odd_frames_fails_by_name(
    samples: Path, run: Run, name: str, content: bytes, reason: str
) -> None:
    (samples / "physiclear_0" / "tactile" / name).write_bytes(content)
    report, _ = run(samples, "octopi")
    (failure,) = report.failed
    assert (failure.name, reason in failure.reason) == ("physiclear_0", True)


def test_a_damaged_jpeg_is_left_out_and_leaves_a_gap(samples: Path, run: Run) -> None:
    bad = samples / "physiclear_0" / "tactile" / "0000000005.jpg"
    bad.write_bytes(bad.read_bytes()[:500])
    report, dataset = run(samples, "octopi")
    stream = by_key(dataset)["physiclear_0"]["tactile"]
    assert stream.time.tolist() == [40_000_000 * n for n in (4, 6, 11, 12)]
    assert [(gap.after, gap.lost) for gap in stream.metadata.gaps or []] == [(0, 1), (1, 4)]
    (flag,) = (flag for flag in report.flagged if flag.code == "damaged-frames")
    assert "1 of 5 frames cannot be decoded and were left out: 1 (" in flag.message


# -------------------------------------------------------------------------------- what is no source


def test_layouts_are_recognised_and_the_reason_is_said(
    octopi: Path, raw_tree: Path, samples: Path
) -> None:
    found = {path: detect_layout(path) for path in (octopi, raw_tree, samples, samples.parent)}
    assert found[octopi].name == "Octopi-1"
    assert found[octopi].reason == "5 clip(s) directly in the folder"
    assert found[raw_tree].name == "Octopi-1.5 raw"
    assert "hardness, objectfolder, physiclear, physicleardotted" in found[raw_tree].reason
    assert found[samples].name == "Octopi-1.5 samples"
    # The folder above one that is called samples is taken, too.
    assert found[samples.parent].name == "Octopi-1.5 samples"


def test_a_folder_with_two_layouts_is_refused(octopi: Path, make_clip: Any, tmp_path: Path) -> None:
    make_clip(octopi / "physiclear" / "Pressing" / "egg_0.mov")
    with pytest.raises(UsageError, match=r"more than one layout: Octopi-1 .* Octopi-1\.5 raw"):
        convert(octopi, tmp_path / "out", from_format="octopi")
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("what", ["missing", "file", "empty", "foreign"])
def test_what_is_no_source_is_refused_before_anything_is_written(tmp_path: Path, what: str) -> None:
    source = tmp_path / "in"
    if what == "file":
        source.write_text("x")
    elif what != "missing":
        source.mkdir()
    if what == "foreign":
        (source / "readme.txt").write_text("x")
    with pytest.raises(SourceError) as caught:
        convert(source, tmp_path / "out", from_format="octopi")
    assert str(source) in str(caught.value)
    assert caught.value.fix
    assert not (tmp_path / "out").exists()


def test_a_rate_that_is_none_is_refused(samples: Path, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match=r"29\.97"):
        convert(
            samples, tmp_path / "out", from_format="octopi", options=ConvertOptions(rate="29.97")
        )
    assert not (tmp_path / "out").exists()
