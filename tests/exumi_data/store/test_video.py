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
