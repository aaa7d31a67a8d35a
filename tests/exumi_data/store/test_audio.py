"""Sound is stored block by block, and read in parts."""

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.episode import Episode, open_episode
from exumi_data.errors import MetadataError, UsageError
from exumi_data.model.streams import AudioStream
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_data.builders import CLOCK, metadata


@pytest.fixture
def writer(tmp_path: Path) -> Iterator[EpisodeWriter]:
    with EpisodeWriter(tmp_path / "a.zarr", metadata(), durable=False) as writer:
        yield writer


def sound(writer: EpisodeWriter, channels: int = 2) -> Any:
    return writer.add_stream("s", kind="audio", clock=CLOCK, rate="48000", channels=channels)


def block(first: int, count: int, channels: int = 2) -> np.ndarray:
    ramp = np.arange(first, first + count, dtype=np.int16)
    return np.stack([ramp + channel for channel in range(channels)], axis=1)


def read(writer: EpisodeWriter) -> Episode:
    return open_episode(writer.finish())


def test_blocks_of_any_length_are_kept(writer: EpisodeWriter) -> None:
    stream = sound(writer)
    stream.append(0, block(0, 480), time_host=7, sequence=0, flags=0)
    parts = [block(480, 1), block(481, 9000)]
    stream.append([10_000_000, 10_020_833], parts, time_host=[8, 9], sequence=[1, 2], flags=[0, 4])
    with read(writer) as episode:
        view = episode["s"]
        assert isinstance(view.metadata, AudioStream)
        assert (view.metadata.rate, view.metadata.channels) == ("48000", 2)
        assert len(view) == 3
        assert view.array("offset").tolist() == [0, 480, 481, 9481]
        assert view.array("offset").dtype == np.uint64
        np.testing.assert_array_equal(view.data, block(0, 9481))
        np.testing.assert_array_equal(view.samples(470, 485), block(470, 15))
        assert view.samples(9481, 9481).shape == (0, 2)
        assert view.flags is not None
        assert view.flags.tolist() == [0, 0, 4]
        assert not view.is_image


@pytest.mark.parametrize(("start", "stop"), [(-1, 2), (3, 2), (0, 481)])
def test_samples_that_are_not_there(writer: EpisodeWriter, start: int, stop: int) -> None:
    sound(writer).append(0, block(0, 480))
    with read(writer) as episode, pytest.raises(UsageError, match="of 480"):
        episode["s"].samples(start, stop)


def test_only_sound_has_samples(writer: EpisodeWriter) -> None:
    writer.add_stream("w", kind="width", clock=CLOCK).append(0, 0.1)
    with read(writer) as episode, pytest.raises(UsageError, match="not audio"):
        episode["w"].samples(0, 1)


@pytest.mark.parametrize(
    "bad",
    [
        block(0, 5).astype(np.float32),
        block(0, 5)[:, :1],
        block(0, 0),
        block(0, 5).reshape(-1),
        block(0, 5).astype(np.int32),
    ],
)
def test_what_is_no_block_is_refused_whole(writer: EpisodeWriter, bad: np.ndarray) -> None:
    stream = sound(writer)
    stream.append(0, block(0, 4))
    with pytest.raises(UsageError, match="expected \\(samples, 2\\) int16"):
        stream.append([10, 20], [block(4, 2), bad])
    with pytest.raises(UsageError, match="1 blocks, 2 times"):
        stream.append([10, 20], [block(4, 2)])
    with pytest.raises(UsageError, match="does not increase"):
        stream.append(0, block(4, 2))
    stream.append(10, block(4, 2))
    with read(writer) as episode:
        assert episode["s"].array("offset").tolist() == [0, 4, 6]


@pytest.mark.parametrize("fields", [{"rate": "48000.5"}, {"channels": 0}, {"channels": 65}])
def test_what_sound_cannot_be(writer: EpisodeWriter, fields: dict[str, Any]) -> None:
    with pytest.raises((UsageError, MetadataError)):
        writer.add_stream(
            "s", kind="audio", clock=CLOCK, **{"rate": "48000", "channels": 1, **fields}
        )
