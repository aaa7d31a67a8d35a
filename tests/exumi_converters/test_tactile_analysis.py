"""What is derived from a stream while it is converted, however little memory there is."""

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_converters.tactile_analysis import TactileAnalysis
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import SourceError
from exumi_data.model import ArrayImages, EpisodeMetadata, Source, Task
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import to_grey


class Reader:
    """Frames in memory; counts how often they are read again."""

    def __init__(self, frames: list[np.ndarray]) -> None:
        self.frames = frames
        self.passes = 0

    def greys(self) -> Iterator[np.ndarray]:
        self.passes += 1
        return (to_grey(frame) for frame in self.frames)

    def pictures(self, indices: Sequence[int]) -> list[np.ndarray]:
        return [self.frames[index] for index in indices]


def write(path: Path, frames: list[np.ndarray], kept_bytes: int) -> tuple[Episode, int]:
    metadata = EpisodeMetadata(
        id="0190a1b2-0000-7000-8000-000000000000",
        task=Task(name="touch"),
        regime="touch",
        licence="NOASSERTION",
        source=Source(type="simulated", tool="test", tool_version="1"),
    )
    height, width = frames[0].shape[:2]
    reader, analysis = Reader(frames), TactileAnalysis(kept_bytes=kept_bytes)
    with EpisodeWriter(path, metadata, durable=False) as writer:
        stream = writer.add_stream(
            "tactile",
            kind="tactile",
            images=ArrayImages(encoding="array", height=height, width=width, channels=3),
        )
        for index, frame in enumerate(frames):
            stream.append(index, frame)
            analysis.add(to_grey(frame))
        analysis.finish(writer, stream, reader)
    return open_episode(path), reader.passes


def test_a_long_clip_is_read_twice_and_gives_the_same(tmp_path: Path, make_frames: Any) -> None:
    frames = make_frames(45)
    short, passes = write(tmp_path / "a.zarr", frames, 64 << 20)
    assert passes == 0
    long, passes = write(tmp_path / "b.zarr", frames, 5 * frames[0].shape[0] * frames[0].shape[1])
    assert passes == 1
    a, b = short["tactile"], long["tactile"]
    assert a.activity is not None
    assert a.activity.max() > 0.01
    assert np.array_equal(a.activity, b.activity)  # type: ignore[arg-type]  # there is one
    assert np.array_equal(a.salient, b.salient)  # type: ignore[arg-type]  # there are some
    assert np.array_equal(a.reference, b.reference)  # type: ignore[arg-type]  # there is one


def test_a_clip_without_rest_says_that_its_reference_is_estimated(
    tmp_path: Path, make_frames: Any
) -> None:
    frames = make_frames(20, range(20))
    episode, _ = write(tmp_path / "a.zarr", frames, 64 << 20)
    (note,) = episode.metadata.quality
    assert (note.code, note.severity, note.stream) == ("reference-estimated", "info", "tactile")
    model = episode["tactile"].metadata
    assert model.reference.method == "estimated"  # type: ignore[attr-defined]  # a tactile stream
    assert model.reference.contact_free is None  # type: ignore[attr-defined]  # a tactile stream


def test_frames_of_two_sizes_are_refused() -> None:
    analysis = TactileAnalysis()
    analysis.add(np.zeros((40, 60), np.uint8))
    with pytest.raises(SourceError, match="frame 1 is 50x40, the ones before are 60x40"):
        analysis.add(np.zeros((40, 50), np.uint8))


def test_one_frame_is_enough(tmp_path: Path, make_frames: Any) -> None:
    episode, _ = write(tmp_path / "a.zarr", make_frames(1), 64 << 20)
    assert episode["tactile"].activity is not None
    assert episode["tactile"].activity.tolist() == [0.0]
    assert episode["tactile"].salient is not None
    assert episode["tactile"].salient.tolist() == [0]
