"""Video that Rerun plays itself is kept as video; every sample refers to its own frame."""

import io
from pathlib import Path
from typing import Any

import av
import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.model import VideoImages
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.view.names import ViewOptions
from exumi_data.view.saving import save_view
from tests.exumi_data.builders import CLOCK, metadata, pictures, video_file
from tests.exumi_data.view.reading import read_view

COUNT, SIDE = 12, 64


def h264(frames: int = COUNT) -> tuple[bytes, list[int], list[int], str]:
    """A file with frames that are predicted from later ones: its pts, keyframes and time base."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="mp4") as out:
        stream = out.add_stream("libx264", rate=10, options={"bf": "2", "g": "6"})
        stream.height = stream.width = SIDE
        stream.pix_fmt = "yuv420p"
        for picture in pictures(frames, height=SIDE, width=SIDE):
            out.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
        out.mux(stream.encode())
    pts: list[int] = []
    keyframes: list[int] = []
    with av.open(io.BytesIO(buffer.getvalue()), "r") as file:
        for frame in file.decode(video=0):
            keyframes.append(len(pts) if frame.key_frame else keyframes[-1])
            pts.append(int(frame.pts or 0))
        base = file.streams.video[0].time_base
    assert base is not None
    return buffer.getvalue(), pts, keyframes, f"{base.numerator}/{base.denominator}"


def write(path: Path, kept: slice, files: int = 1) -> bytes:
    content, pts, keyframes, base = h264()
    images: Any = {"encoding": "video", "height": SIDE, "width": SIDE, "channels": 3}
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        stream = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=VideoImages(**images))
        for number in range(files):
            about = video_file(content, base, f"{number}.mp4").model_copy(
                update={"codec": "h264", "start_ns": number * 10_000_000_000}
            )
            chosen = np.array(pts)[kept]
            origin = range(COUNT)[kept].start
            stream.append_file(
                content, about, pts=chosen, keyframe=np.array(keyframes)[kept] - origin
            )
    return content


@pytest.mark.parametrize(("kept", "files"), [(slice(0, COUNT), 2), (slice(6, 11), 1)])
def test_the_file_is_kept_and_each_sample_shows_its_frame(
    tmp_path: Path, kept: slice, files: int
) -> None:
    content = write(tmp_path / "one.zarr", kept, files)
    with open_episode(tmp_path / "one.zarr") as episode:
        report = save_view(episode, tmp_path / "one.rrd")
        times = episode["rgb"].time.tolist()
    assert report.episodes[0].notes == ()
    (shown,) = read_view(tmp_path / "one.rrd").values()
    for number in range(files):
        (blob,) = shown.fixed[f"/camera/rgb/file_{number}", "AssetVideo:blob"]
        assert np.asarray(blob, np.uint8).tobytes() == content
    frames = shown.column("/camera/rgb", "VideoFrameReference:timestamp")
    assert frames.time == times
    # The file has ten frames a second.
    expected = [index * 100_000_000 for index in range(COUNT)[kept]] * files
    assert [ns for (ns,) in frames.values] == expected
    which = shown.column("/camera/rgb", "VideoFrameReference:video_reference")
    per_file = len(times) // files
    assert [path for (path,) in which.values] == [
        f"/camera/rgb/file_{number}" for number in range(files) for _ in range(per_file)
    ]


def test_video_is_decoded_where_that_is_asked_for(tmp_path: Path) -> None:
    write(tmp_path / "one.zarr", slice(0, COUNT))
    with open_episode(tmp_path / "one.zarr") as episode:
        report = save_view(episode, tmp_path / "one.rrd", options=ViewOptions(decode_video=True))
    (note,) = report.episodes[0].notes
    assert "decoded frames (asked for)" in note
    (shown,) = read_view(tmp_path / "one.rrd").values()
    assert len(shown.column("/camera/rgb", "EncodedImage:blob").blobs) == COUNT
    assert not any("file_0" in entity for entity in shown.entities)
