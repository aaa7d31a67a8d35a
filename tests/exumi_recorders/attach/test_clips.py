"""Clips: what their containers say, frames listed without decoding, damage told."""

from datetime import UTC, datetime, timedelta
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import pytest

from exumi_data.clips.clip import find_clips, list_frames, read_clip, timecode_s
from exumi_data.errors import SourceError, UsageError
from exumi_data.simulation.gopro import timecode_text
from exumi_recorders.simulated.hub_run import HubRun

NTSC, DOUBLE, FILM = Fraction(30_000, 1001), Fraction(60_000, 1001), Fraction(24)


@pytest.mark.parametrize(
    ("text", "rate", "seconds"),
    [
        ("00:00:00:00", NTSC, 0.0),
        ("00:00:10:15", FILM, 10.625),
        ("01:00:00;00", NTSC, 3599.9964),  # frame 107892
        ("00:01:00;02", NTSC, 60.06),  # follows 00:00:59;29 at once
        ("00:00:59;29", NTSC, 60.0266),
        ("00:10:00;00", DOUBLE, 599.9994),
        ("23:59:59:29", NTSC, 86399.9667),
    ],
)
def test_timecode(text: str, rate: Fraction, seconds: float) -> None:
    assert timecode_s(text, rate) == pytest.approx(seconds, abs=1e-4)


@pytest.mark.parametrize(
    "text", ["", "24:00:00:00", "10:60:00:00", "10:00:60:00", "10:00:00:30", "10:00:00", "a:b:c:d"]
)
def test_what_is_no_timecode(text: str) -> None:
    assert timecode_s(text, NTSC) is None


@pytest.mark.parametrize("rate", [NTSC, DOUBLE, FILM, Fraction(25)])
def test_timecode_there_and_back(rate: Fraction) -> None:
    midnight = datetime(2026, 3, 1, tzinfo=UTC)
    for seconds in np.linspace(0.0, 86399.0, 997).tolist():
        text = timecode_text(midnight + timedelta(seconds=seconds), rate)
        assert timecode_s(text, rate) == pytest.approx(seconds, abs=1.01 / float(rate))


def test_a_clip_says_what_it_is(hub_run: HubRun) -> None:
    path = hub_run.clips / "GX010001.MP4"
    clip = read_clip(path, path.name)
    assert clip.number == (1, 1)
    assert clip.timecode is not None
    assert ";" in clip.timecode
    assert clip.gyro is not None
    assert clip.gyro.time_s[-1] == pytest.approx(clip.duration_s, abs=0.05)
    assert clip.clock_s == timecode_s(clip.timecode, NTSC)


def test_frames_are_those_that_a_decoder_gives(hub_run: HubRun) -> None:
    path = hub_run.clips / "GX010001.MP4"
    frames = list_frames(path, path.name)
    with av.open(str(path)) as container:
        decoded = [(frame.pts, frame.key_frame) for frame in container.decode(video=0)]
    assert frames.pts.tolist() == [pts for pts, _ in decoded]
    assert np.flatnonzero(frames.keyframe == np.arange(len(decoded))).tolist() == [
        index for index, (_, is_key) in enumerate(decoded) if is_key
    ]
    assert (frames.height, frames.width, frames.channels) == (32, 32, 3)
    assert frames.problem is None
    assert frames.file.bytes == path.stat().st_size
    first, stop = frames.span_ns
    assert first == 0
    assert stop == pytest.approx(1e9 * len(decoded) / NTSC, rel=1e-6)


def test_frames_shown_in_another_order_than_stored(tmp_path: Path) -> None:
    path = tmp_path / "b.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25, options={"bf": "2", "g": "8"})
        stream.width = stream.height = 32
        for number in range(20):
            pixels = np.full((32, 32, 3), 10 * number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode(None))
    frames = list_frames(path, "b.mp4")
    with av.open(str(path)) as container:
        assert frames.pts.tolist() == [f.pts for f in container.decode(video=0)]
    assert (np.diff(frames.pts) > 0).all()


def test_a_clip_that_was_cut_short_keeps_the_frames_that_are_there(
    hub_run: HubRun, tmp_path: Path
) -> None:
    whole = hub_run.clips / "GX010001.MP4"
    # The tables first, as a camera that writes them ahead would leave it.
    early = tmp_path / "early.mp4"
    with (
        av.open(str(whole)) as source,
        av.open(str(early), "w", options={"movflags": "faststart"}) as target,
    ):
        stream = target.add_stream_from_template(source.streams.video[0])
        for packet in source.demux(video=0):
            if packet.dts is not None:
                packet.stream = stream
                target.mux(packet)
    data = early.read_bytes()
    path = tmp_path / "cut.mp4"
    path.write_bytes(data[: len(data) - len(data) // 3])
    frames = list_frames(path, path.name)
    total = len(list_frames(whole, whole.name).pts)
    assert 0 < len(frames.pts) < total
    assert frames.problem is not None
    assert f"{total} frames are declared, {len(frames.pts)} are there" in frames.problem
    with av.open(str(path)) as container:
        good = 0
        try:
            for frame in container.decode(video=0):
                good += not frame.is_corrupt
        except av.FFmpegError:
            pass
    assert len(frames.pts) <= good


@pytest.mark.parametrize("content", [b"", b"\0" * 100, b"\0\0\0\x18ftypmp42" + bytes(40)])
def test_what_is_no_video_is_refused(content: bytes, tmp_path: Path) -> None:
    path = tmp_path / "GX010001.MP4"
    path.write_bytes(content)
    with pytest.raises(SourceError):
        read_clip(path, path.name)
    with pytest.raises(SourceError):
        list_frames(path, path.name)


def test_finding_clips(tmp_path: Path) -> None:
    for name in ("b/GX010002.MP4", "a.mov", "a.LRV", "a.THM", "._GX010002.MP4"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    assert find_clips(tmp_path) == [tmp_path / "a.mov", tmp_path / "b/GX010002.MP4"]
    assert find_clips(tmp_path / "a.mov") == [tmp_path / "a.mov"]
    with pytest.raises(UsageError, match="no such"):
        find_clips(tmp_path / "nothing")
    (tmp_path / "empty").mkdir()
    with pytest.raises(UsageError, match="no clips"):
        find_clips(tmp_path / "empty")
