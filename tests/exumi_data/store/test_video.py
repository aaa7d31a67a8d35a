"""Video files: only containers are opened, and what they hold is decoded as it is."""

from pathlib import Path

import pytest

from exumi_data.errors import SourceError
from exumi_data.store.video import VideoDecoder

CONCAT = "ffconcat version 1.0\nfile '{}'\n"
PLAYLIST = "#EXTM3U\n#EXT-X-TARGETDURATION:10\n#EXTINF:10,\n{}\n#EXT-X-ENDLIST\n"


@pytest.mark.parametrize("text", [CONCAT, PLAYLIST])
@pytest.mark.parametrize("in_memory", [True, False])
def test_a_list_of_files_is_no_video(tmp_path: Path, text: str, *, in_memory: bool) -> None:
    import av

    secret = tmp_path / "secret.mov"
    with av.open(str(secret), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height = 32, 32
        container.mux(stream.encode(av.VideoFrame(32, 32, "yuv420p")))
        container.mux(stream.encode())
    with VideoDecoder(str(secret), secret) as decoder:
        assert sum(1 for _ in decoder.frames()) == 1
    disguised = tmp_path / "clip.mov"
    disguised.write_text(text.format("secret.mov"))
    source = disguised.read_bytes() if in_memory else str(disguised)
    with pytest.raises(SourceError, match="not a readable video"):
        VideoDecoder(source, disguised)


def test_keyframes_alone(tmp_path: Path) -> None:
    import av
    import numpy as np

    path = tmp_path / "clip.mp4"
    with av.open(str(path), "w") as container:
        stream = container.add_stream("mpeg4", rate=25)
        assert isinstance(stream, av.VideoStream)
        stream.width, stream.height, stream.codec_context.gop_size = 32, 32, 5
        for number in range(22):
            pixels = np.full((32, 32, 3), 60 + number, np.uint8)
            container.mux(stream.encode(av.VideoFrame.from_ndarray(pixels, format="rgb24")))
        container.mux(stream.encode())
    with VideoDecoder(str(path), path) as decoder:
        every = [(frame.pts, frame.key_frame) for frame in decoder.frames()]
    with VideoDecoder(str(path), path, threads=2) as decoder:
        assert [(frame.pts, frame.key_frame) for frame in decoder.frames()] == every
    with VideoDecoder(str(path), path) as decoder:
        found = [frame.pts for frame in decoder.keyframes()]
    assert found == [pts for pts, is_key in every if is_key]
    assert 1 < len(found) < len(every)
