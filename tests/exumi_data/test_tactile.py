"""Activity against its definition, salience against a sort, references on clips with truth."""

import csv
import itertools
from pathlib import Path

import cv2
import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from exumi_data.tactile import (
    ACTIVE_THRESHOLD,
    PIXEL_THRESHOLD,
    ActivityMeter,
    choose_reference,
    difference_energy,
    reference_image,
    representation,
    salient_frames,
    thumbnail,
    to_grey,
)

Image = npt.NDArray[np.uint8]

SIZES = [(240, 320), (340, 460), (480, 640), (224, 224), (448, 448), (225, 301), (560, 245)]
SMALL_SIZES = [(100, 90), (240, 200), (224, 223)]


# -------------------------------------------------------------------------------------------- grey


def test_grey_weighs_red_green_and_blue() -> None:
    frame = np.zeros((1, 3, 3), np.uint8)
    frame[0, 0, 0] = frame[0, 1, 1] = frame[0, 2, 2] = 200
    assert to_grey(frame).tolist() == [[60, 117, 23]]


def test_grey_of_grey_is_itself() -> None:
    frame = np.arange(6, dtype=np.uint8).reshape(2, 3)
    assert to_grey(frame) is frame
    np.testing.assert_array_equal(to_grey(frame[:, :, None]), frame)


@pytest.mark.parametrize(
    "frame", [np.zeros((2, 3)), np.zeros((2, 3, 4), np.uint8), np.zeros(3, np.uint8)]
)
def test_grey_refuses_other_arrays(frame: npt.NDArray[np.uint8]) -> None:
    with pytest.raises(ValueError, match="a frame must be"):
        to_grey(frame)


# -------------------------------------------------------------------------------- representation


@pytest.mark.parametrize(("difference", "scaled"), [(0, 0), (36, 252), (37, 255), (200, 255)])
def test_representation_clamps_where_the_released_code_wrapped(
    difference: int, scaled: int
) -> None:
    # times 7 in uint8, 36 grey levels give 252 and 37 give 3
    reference = np.full((2, 2), 20, np.uint8)
    pressed = np.full((2, 2), 20 + difference, np.uint8)
    grey, convex, concave = representation(pressed, reference)
    np.testing.assert_allclose(grey, (20 + difference) / 255, rtol=1e-6)
    np.testing.assert_allclose(convex, scaled / 255, rtol=1e-6)
    np.testing.assert_array_equal(concave, 0)
    _, convex, concave = representation(reference, pressed)
    np.testing.assert_array_equal(convex, 0)
    np.testing.assert_allclose(concave, scaled / 255, rtol=1e-6)


@given(arrays(np.uint8, (3, 4)), arrays(np.uint8, (3, 4)), st.sampled_from([1.0, 7.0, 20.5]))
def test_representation_is_its_formula(grey: Image, reference: Image, gain: float) -> None:
    got = representation(grey, reference[:, :, None], gain=gain)
    assert got.shape == (3, 3, 4)
    assert got.dtype == np.float32
    difference = grey.astype(float) - reference
    expected = np.stack(
        (
            grey / 255,
            np.clip(gain * np.maximum(difference, 0) / 255, 0, 1),
            np.clip(gain * np.maximum(-difference, 0) / 255, 0, 1),
        )
    )
    np.testing.assert_allclose(got, expected, atol=1e-6)


def test_representation_wants_two_frames_of_one_size() -> None:
    with pytest.raises(ValueError, match="differ in size"):
        representation(np.zeros((2, 3), np.uint8), np.zeros((3, 2), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        representation(np.zeros((2, 3)), np.zeros((2, 3), np.uint8))  # type: ignore[arg-type]


# ---------------------------------------------------------------------------------------- activity


def _activity_as_defined(
    grey: Image, reference: Image, threshold: float = PIXEL_THRESHOLD
) -> float:
    difference = grey.astype(np.float32) - reference.astype(np.float32)
    up, down = (
        cv2.resize(part, (224, 224), interpolation=cv2.INTER_AREA)
        for part in (np.maximum(difference, 0), np.maximum(-difference, 0))
    )
    return float((np.maximum(up, down) > threshold).mean())


def _area_weights(source: int, target: int) -> npt.NDArray[np.float64]:
    """Matrix that averages `source` pixels to `target`; numerators are exact."""
    cell = np.arange(target)[:, None] * source
    pixel = np.arange(source) * target
    overlap = np.minimum(cell + source, pixel + target) - np.maximum(cell, pixel)
    weights: npt.NDArray[np.float64] = np.maximum(overlap, 0) / source
    return weights


def _scene(shape: tuple[int, int], seed: int, spots: int, noise: int) -> tuple[Image, Image]:
    """A reference, and a frame with noise and some spots of contact, some of them faint."""
    rng = np.random.default_rng(seed)
    reference = rng.integers(60, 180, shape)
    frame = (reference + rng.integers(-noise, noise + 1, shape)).astype(np.float64)
    rows, columns = np.indices(shape)
    for _ in range(spots):
        row, column = rng.uniform(0, shape[0]), rng.uniform(0, shape[1])
        distance = (rows - row) ** 2 + (columns - column) ** 2
        depth = rng.choice([-1, 1]) * rng.uniform(15, 40)
        frame += depth * np.exp(-distance / rng.uniform(5, 500))
    return reference.astype(np.uint8), np.clip(frame, 0, 255).astype(np.uint8)


@settings(max_examples=60)
@given(
    shape=st.sampled_from(SIZES + SMALL_SIZES),
    seed=st.integers(0, 2**32 - 1),
    spots=st.integers(0, 6),
    noise=st.sampled_from([0, 2, 6, 12]),
)
def test_activity_is_its_definition(
    shape: tuple[int, int], seed: int, spots: int, noise: int
) -> None:
    reference, frame = _scene(shape, seed, spots, noise)
    meter = ActivityMeter(reference)
    # a mean that equals the threshold but for rounding may fall on either side: one pixel
    assert meter.measure(frame) == pytest.approx(
        _activity_as_defined(frame, reference), abs=1.5 / 224**2
    )


@pytest.mark.parametrize("shape", [(240, 320), (340, 460), (480, 640), (225, 301)])
@pytest.mark.parametrize("spots", [1, 40])
def test_activity_averages_areas(shape: tuple[int, int], spots: int) -> None:
    # the definition again without OpenCV, through sparse (1 spot) and dense (40) frames
    reference, frame = _scene(shape, 7, spots, 2)
    rows, columns = _area_weights(shape[0], 224), _area_weights(shape[1], 224)
    difference = frame.astype(float) - reference
    up, down = (
        rows @ part @ columns.T for part in (np.maximum(difference, 0), np.maximum(-difference, 0))
    )
    expected = float((np.maximum(up, down) > PIXEL_THRESHOLD).mean())
    assert expected > 0
    assert ActivityMeter(reference).measure(frame) == pytest.approx(expected, abs=2.5 / 224**2)


def test_activity_of_a_single_pixel() -> None:
    reference = np.full((224, 224), 100, np.uint8)
    frame = reference.copy()
    frame[17, 200] = 105
    assert ActivityMeter(reference).measure(frame) == 0  # 5 is below 5.83
    frame[17, 200] = 106
    assert ActivityMeter(reference).measure(frame) == 1 / 224**2
    frame[17, 200] = 94
    assert ActivityMeter(reference).measure(frame) == 1 / 224**2


def test_activity_does_not_let_brighter_and_darker_cancel() -> None:
    reference = np.full((448, 448), 100, np.uint8)
    frame = reference.copy()
    frame[::2] = 130
    frame[1::2] = 70
    assert ActivityMeter(reference).measure(frame) == 1.0


def test_activity_takes_views_colour_references_and_other_thresholds() -> None:
    reference, frame = _scene((480, 640), 3, 5, 0)
    meter = ActivityMeter(reference[::2, ::2], threshold=12.0)
    assert meter.threshold == 12.0
    assert meter.size == 224
    assert meter.measure(frame[::2, ::2]) == pytest.approx(
        _activity_as_defined(frame[::2, ::2], reference[::2, ::2], 12.0), abs=1.5 / 224**2
    )
    colour = np.repeat(reference[:, :, None], 3, axis=2)
    assert ActivityMeter(colour).measure(frame) == ActivityMeter(reference).measure(frame)


def test_a_meter_does_not_follow_its_reference_array() -> None:
    reference = np.full((240, 320), 100, np.uint8)
    meter = ActivityMeter(reference)
    frame = reference.copy()
    reference[:] = 0
    assert meter.measure(frame) == 0


def test_activity_refuses_what_does_not_fit() -> None:
    meter = ActivityMeter(np.zeros((240, 320), np.uint8))
    with pytest.raises(ValueError, match="differ in size"):
        meter.measure(np.zeros((320, 240), np.uint8))
    with pytest.raises(ValueError, match="uint8"):
        meter.measure(np.zeros((240, 320, 3), np.uint8))
    with pytest.raises(ValueError, match="positive"):
        ActivityMeter(np.zeros((240, 320), np.uint8), threshold=0)


# ---------------------------------------------------------------------------------------- salience


@given(arrays(np.uint8, (2, 5, 7)))
def test_energy_is_the_sum_of_differences(frames: Image) -> None:
    expected = np.abs(frames[1].astype(int) - frames[0]).sum()
    assert difference_energy(frames[0], frames[1]) == expected


def test_energy_of_large_frames_does_not_overflow() -> None:
    size = (3000, 4000)
    assert difference_energy(np.zeros(size, np.uint8), np.full(size, 255, np.uint8)) == 3060000000


@given(
    energy=st.lists(st.integers(0, 6), max_size=30),
    k=st.integers(0, 12),
    dtype=st.sampled_from([np.int64, np.uint32, np.float64]),
)
def test_salient_frames_are_the_plain_sort(energy: list[int], k: int, dtype: type) -> None:
    got = salient_frames(np.array(energy, dtype), k)
    assert got.dtype == np.int64
    candidates = sorted(range(1, len(energy)), key=lambda i: (-energy[i], i))
    if energy:
        candidates.append(0)
    assert got.tolist() == sorted(candidates[:k])


def test_the_first_frame_is_salient_only_when_needed() -> None:
    assert salient_frames([9, 1, 1], 2).tolist() == [1, 2]
    assert salient_frames([9, 1, 1], 3).tolist() == [0, 1, 2]
    with pytest.raises(ValueError, match=r"\(N,\)"):
        salient_frames([[1]])
    with pytest.raises(ValueError, match="negative"):
        salient_frames([1], -1)


# --------------------------------------------------------------------------------------- reference


def _press(n: int, contact: list[float], seed: int = 0) -> Image:
    """A clip of a smooth gel under a ridged object that slides; `contact` is depth by frame."""
    rng = np.random.default_rng(seed)
    rows, columns = np.indices((120, 160))
    lighting = 120 + 40 * np.exp(-((rows - 60) ** 2 + (columns - 80) ** 2) / 4000)
    clip = np.empty((n, 120, 160), np.uint8)
    for i, depth in enumerate(contact):
        patch = np.exp(-((rows - 60) ** 2 + (columns - 60 - i % 40) ** 2) / 400)
        ridges = 1 + np.sin((rows + 0.5 * columns - 3 * i) / 2)
        noise = rng.normal(0, 1, (120, 160))
        clip[i] = np.clip(lighting + 25 * depth * patch * ridges + noise, 0, 255)
    return clip


def _ramp(*levels: tuple[float, int]) -> list[float]:
    return [level for level, n in levels for _ in range(n)]


@pytest.mark.parametrize(
    "contact",
    [
        pytest.param(_ramp((0, 30), (1, 30), (0, 30)), id="touch in the middle"),
        pytest.param(_ramp((1, 40), (0, 30)), id="starts in contact"),
        pytest.param(_ramp((0, 20), (1, 60)), id="ends in contact"),
        pytest.param(_ramp((1, 30), (0, 20), (0.6, 30)), id="free only between"),
        pytest.param(_ramp((1, 300), (0, 30), (1, 300)), id="free for a twentieth"),
    ],
)
def test_a_reference_is_found_wherever_the_clip_is_free(contact: list[float]) -> None:
    clip = _press(len(contact), contact)
    choice = choose_reference([thumbnail(frame) for frame in clip])
    assert choice.method == "selected"
    assert choice.contact_free
    assert 1 <= len(choice.frames) <= 5
    assert list(choice.frames) == sorted(set(choice.frames))
    assert all(contact[i] == 0 for i in choice.frames)
    assert choice.score > 0
    free = [len(list(run)) for level, run in itertools.groupby(contact) if level == 0]
    assert choice.rest_frames in free


def test_frames_far_from_contact_are_taken() -> None:
    contact = _ramp((0, 40), (1, 40))
    choice = choose_reference(_press(80, contact))
    assert max(choice.frames) < 20


def test_a_clip_in_contact_throughout_is_said_to_be_so() -> None:
    rng = np.random.default_rng(1)
    choice = choose_reference(_press(60, rng.uniform(0.3, 1, 60).tolist()))
    assert choice.method == "estimated"
    assert not choice.contact_free
    assert "no rest" in choice.reason
    assert len(choice.frames) == 5


@pytest.mark.parametrize("n", [1, 2, 7, 50])
def test_a_clip_in_which_nothing_changes_proves_nothing(n: int) -> None:
    choice = choose_reference(_press(n, [0.0] * n))
    assert choice.method == "estimated"
    assert choice.reason == "nothing changes"
    assert len(choice.frames) == min(n, 5)


@settings(max_examples=30)
@given(
    arrays(
        np.uint8,
        st.tuples(st.integers(1, 20), st.integers(1, 12), st.integers(1, 12)),
    )
)
def test_any_clip_gives_frames_of_the_clip(clip: Image) -> None:
    choice = choose_reference(clip)
    assert 1 <= len(choice.frames) <= 5
    assert list(choice.frames) == sorted(set(choice.frames))
    assert choice.frames[0] >= 0
    assert choice.frames[-1] < len(clip)
    assert -1 <= choice.score <= 1
    assert choice == choose_reference(list(clip))


def test_large_frames_are_shrunk() -> None:
    contact = _ramp((1, 20), (0, 20))
    clip = np.repeat(np.repeat(_press(40, contact), 2, axis=1), 2, axis=2)
    assert choose_reference(clip) == choose_reference([thumbnail(frame) for frame in clip])


def test_no_frames_and_unequal_frames_are_refused() -> None:
    with pytest.raises(ValueError, match="no frame"):
        choose_reference([])
    with pytest.raises(ValueError, match="frame 1 is"):
        choose_reference([np.zeros((3, 4), np.uint8), np.zeros((4, 3), np.uint8)])
    with pytest.raises(ValueError, match=r"\(h, w\)"):
        choose_reference(np.zeros((2, 3, 4, 3), np.uint8))


@pytest.mark.parametrize(
    ("shape", "small"),
    [
        ((240, 320), (60, 80)),
        ((480, 640), (60, 80)),
        ((340, 460), (68, 92)),
        ((60, 80), (60, 80)),
        ((1, 10**5), (1, 10**5)),
    ],
)
def test_thumbnails_are_means_over_squares(shape: tuple[int, int], small: tuple[int, int]) -> None:
    frame = np.random.default_rng(0).integers(0, 256, shape, np.uint8)
    got = thumbnail(frame)
    assert got.shape == small
    n = shape[0] // small[0]
    squares = frame[: small[0] * n, : small[1] * n].reshape(small[0], n, small[1], n)
    assert np.abs(got - squares.mean((1, 3))).max() <= 1.5


def test_thumbnails_of_other_arrays_are_refused() -> None:
    for frame in (np.zeros((0, 4), np.uint8), np.zeros((3, 4, 3), np.uint8), np.zeros((3, 4))):
        with pytest.raises(ValueError, match="grey frame"):
            thumbnail(frame)  # type: ignore[arg-type]


@given(
    arrays(np.uint8, st.tuples(st.integers(1, 6), st.integers(1, 4), st.integers(1, 4), st.just(3)))
)
def test_reference_image_is_the_lower_median(frames: Image) -> None:
    before = frames.copy()
    expected = np.sort(frames, axis=0)[(len(frames) - 1) // 2]
    got = reference_image(list(frames))
    np.testing.assert_array_equal(got, expected)
    np.testing.assert_array_equal(frames, before)
    assert not np.shares_memory(got, frames)


def test_reference_image_of_nothing() -> None:
    with pytest.raises(ValueError, match="no frame"):
        reference_image([])


# --------------------------------------------------------------------------------------- real data


def _decode(path: Path) -> list[Image]:
    import av

    reformatter = av.video.reformatter.VideoReformatter()
    greys = []
    with av.open(str(path)) as container:
        for frame in container.decode(video=0):
            plane = reformatter.reformat(frame, format="gray").planes[0]
            rows = np.frombuffer(memoryview(plane), np.uint8).reshape(-1, plane.line_size)
            greys.append(rows[:, : plane.width].copy())
    return greys


def _activity(greys: list[Image]) -> npt.NDArray[np.float64]:
    choice = choose_reference([thumbnail(grey) for grey in greys])
    meter = ActivityMeter(reference_image([greys[i] for i in choice.frames]))
    return np.array([meter.measure(grey) for grey in greys])


@pytest.mark.parametrize("drop", [0, 15])
@pytest.mark.parametrize("grasp", ["foam_brick_1", "golf_ball_1", "purple_ball_hardest_1"])
def test_activity_follows_force_on_real_grasps(real_data: Path, grasp: str, drop: int) -> None:
    # dropping the first frames makes the clip start in contact
    path = real_data / "gelsight_wedge" / "2023-12-06" / f"{grasp}.avi"
    with path.with_suffix(".csv").open() as file:
        force = [float(row["force_N"]) for row in csv.DictReader(file)]
    activity = _activity(_decode(path)[drop:])
    assert np.corrcoef(activity, force[drop:])[0, 1] > 0.9


@pytest.mark.parametrize("clip", ["apple_0", "scissor_handle_2", "tsa_lock_numbers_0"])
def test_real_touches_come_and_go(real_data: Path, clip: str) -> None:
    activity = _activity(_decode(real_data / "physiclear" / "videos" / f"{clip}.mov"))
    active = activity > ACTIVE_THRESHOLD
    assert 0.2 < active.mean() < 0.9
    # the second starts in contact and ends free, the third the other way round
    assert active[0] == (clip == "scissor_handle_2")
    assert active[-1] == (clip == "tsa_lock_numbers_0")
