"""Touch clips: what is known of them, and their salient frames."""

import pickle
import subprocess
import sys
import warnings
from typing import Any

import numpy as np
import pytest

from exumi_data.errors import DamagedDataError, UsageError
from exumi_data.model import Label
from exumi_loaders.clips import Clips, SalienceWarning


def label(value: Any, whose: Any = "human", scale: Any = (0, 10), name: str = "hardness") -> Label:
    limits = None if scale is None else [float(end) for end in scale]
    number = float(value) if isinstance(value, int) else value
    return Label(property=name, value=number, scale=limits, provenance=whose)


def test_a_clip_says_what_was_touched(make_touches: Any, touch: Any) -> None:
    words = label(["smooth", "flat", "smooth"], scale=None, name="adjectives")
    dataset = make_touches(
        touch("lid", "box", labels=[label(7), words], trial=2, procedure="press", pad="dotted")
    )
    (clip,) = Clips(dataset).table
    assert (clip.episode, clip.id, clip.stream) == (0, dataset.ids[0], "tactile")
    assert (clip.part_id, clip.object_id, clip.trial) == ("lid", "box", 2)
    assert (clip.procedure, clip.kind) == ("press", ("gelsight-mini", "dotted"))
    assert clip.labels == {"hardness": 7.0}
    assert clip.adjectives == ("smooth", "flat")
    assert clip.provenance == {"hardness": "human", "adjectives": "human"}


@pytest.mark.parametrize(
    ("labels", "person", "either"),
    [
        ([label(3, "model")], {}, {"hardness": 3.0}),
        ([label(3, "model"), label(8)], {"hardness": 8.0}, {"hardness": 8.0}),
        ([label(4), label(7)], {"hardness": 5.5}, {"hardness": 5.5}),
        ([label(3, scale=(1, 5))], {"hardness": 5.0}, {"hardness": 5.0}),
        ([label(3, scale=None)], {}, {}),
        ([label(11)], {}, {}),
        ([label("hard", scale=None)], {}, {}),
    ],
)
def test_ratings_are_persons_unless_asked_otherwise(
    make_touches: Any, touch: Any, labels: Any, person: Any, either: Any
) -> None:
    dataset = make_touches(touch("lid", labels=labels))
    assert Clips(dataset).table[0].labels == person
    assert Clips(dataset, provenance="any").table[0].labels == either


def test_there_are_limits_to_the_number_of_frames(make_touches: Any, touch: Any) -> None:
    dataset = make_touches(touch())
    for frames in (0, 5000, 10**12):
        with pytest.raises(UsageError, match="from 1 to 4096"):
            Clips(dataset, frames=frames)


def test_the_most_salient_frames_come_in_time_order(make_touches: Any, touch: Any) -> None:
    clips = Clips(make_touches(touch(brightness=(0, 1, 9, 9, 4, 5))), frames=2)
    with pytest.warns(SalienceWarning, match="decodes the whole clip"):
        chosen = clips.salient(0)
    assert chosen.numbers.tolist() == [2, 4]
    assert not chosen.stored
    frames, reference = clips.read(0)
    assert frames.shape == (2, 8, 8, 1)
    assert frames[:, 0, 0, 0].tolist() == [9, 4]
    assert reference is not None
    assert reference[0, 0].tolist() == [7]


def test_a_short_clip_repeats_its_last_frame(make_touches: Any, touch: Any) -> None:
    clips = Clips(make_touches(touch(brightness=(0, 5), stored=10)), frames=4)
    frames, _ = clips.read(0)
    assert frames[:, 0, 0, 0].tolist() == [0, 5, 5, 5]
    assert clips.salient(0).valid.tolist() == [True, True, False, False]
    assert clips.salient(0).stored  # all frames are salient, whatever the selection was made for


@pytest.mark.parametrize(("stored", "wanted", "used"), [(3, 3, True), (3, 2, False), (2, 3, False)])
def test_a_stored_selection_is_used_if_it_is_of_as_many(
    make_touches: Any, touch: Any, stored: int, wanted: int, used: bool
) -> None:
    clips = Clips(make_touches(touch(brightness=(0, 3, 6, 9, 12), stored=stored)), frames=wanted)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", SalienceWarning)
        chosen = clips.salient(0)
    assert chosen.stored is used
    if used:
        assert chosen.numbers.tolist() == [2, 3, 4]  # what the test stored: the last three


def test_every_stream_is_a_clip_unless_one_is_named(make_touches: Any, touch: Any) -> None:
    both = ("tactile_left", "tactile_right")
    dataset = make_touches(
        touch(streams=both), touch(), touch(brightness=()), touch(streams=(), part="nothing")
    )
    clips = Clips(dataset)
    assert [(c.episode, c.stream) for c in clips.table] == [
        (0, "tactile_left"),
        (0, "tactile_right"),
        (1, "tactile"),
    ]
    assert clips.left_out == {"without a frame": 1, "without such a tactile stream": 1}
    assert [c.stream for c in Clips(dataset, stream="tactile_right").table] == ["tactile_right"]
    assert "3 of 4 episodes" in repr(clips)


def test_wrong_arguments_are_said(make_touches: Any, touch: Any) -> None:
    dataset = make_touches(touch())
    with pytest.raises(UsageError, match="frames is 0"):
        Clips(dataset, frames=0)
    with pytest.raises(UsageError, match="provenance"):
        Clips(dataset, provenance="robot")  # type: ignore[arg-type]  # the point of the test
    with pytest.raises(UsageError, match="no touch clip in 1 episode"):
        Clips(dataset, stream="tactile_left")


def test_a_selection_outside_the_stream_is_damage(make_touches: Any, touch: Any) -> None:
    clips = Clips(make_touches(touch(brightness=(0, 3, 6), stored=2, salient=(1, 3))), frames=2)
    with pytest.raises(DamagedDataError, match=r"\[1, 3\] of 3 frames"):
        clips.read(0)


def test_clips_cross_process_borders(make_touches: Any, touch: Any) -> None:
    clips = Clips(make_touches(touch("lid", stored=2)), frames=2)
    again = pickle.loads(pickle.dumps(clips))  # noqa: S301  # its own bytes
    assert again.table == clips.table
    np.testing.assert_array_equal(again.read(0)[0], clips.read(0)[0])


def test_no_torch_is_needed() -> None:
    code = "import sys, exumi_loaders; exumi_loaders.Clips; assert 'torch' not in sys.modules"
    done = subprocess.run([sys.executable, "-c", code], check=False)
    assert done.returncode == 0
