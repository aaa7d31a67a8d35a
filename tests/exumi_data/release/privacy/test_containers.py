"""AVI, Matroska and WebM: what their tags say is found, and taken out where it lies."""

import hashlib
import io
from pathlib import Path

import av
import numpy as np
import pytest

from exumi_data.episode import open_episode
from exumi_data.errors import LimitError, UnsupportedError
from exumi_data.model import VideoImages
from exumi_data.release.privacy import KINDS, Removal, find_private, without_private
from exumi_data.release.privacy.avi import avi_patches
from exumi_data.release.privacy.matroska import matroska_patches
from exumi_data.store.access import open_store
from exumi_data.store.pack import pack_store
from tests.exumi_data.release.privacy.clips import HOME, write_private

TAGS = {
    "title": "of Grace Hopper",
    "artist": "Hopper",
    "comment": f"cut in {HOME}/clips at 48.13743, 11.57549",
    "copyright": "CC0",
}
CODECS = {".avi": "mpeg4", ".mkv": "mpeg4", ".webm": "libvpx", ".mp4": "mpeg4"}
EVERYTHING = Removal(frozenset(KINDS), names={"Grace Hopper": "operator"})


def tagged(path: Path, options: dict[str, str] | None = None) -> Path:
    with av.open(str(path), "w", options=options or {}) as container:
        container.metadata.update(TAGS)
        if path.suffix != ".avi":
            container.metadata["location"] = "+48.1374+011.5755/"
        video = container.add_stream(CODECS[path.suffix], rate=10)
        assert isinstance(video, av.VideoStream)
        video.height = video.width = 32
        video.pix_fmt = "yuv420p"
        video.metadata["title"] = f"of {HOME}/camera"
        for level in (0, 90, 200):
            frame = av.VideoFrame.from_ndarray(
                np.full((32, 32, 3), level, np.uint8), format="rgb24"
            )
            container.mux(video.encode(frame))
        container.mux(video.encode(None))
    return path


def told(raw: bytes) -> dict[str, str]:
    with av.open(io.BytesIO(raw)) as container:
        return {**container.metadata, **container.streams.video[0].metadata}


@pytest.mark.parametrize(
    ("name", "options"), [("a.avi", {}), ("a.mkv", {}), ("a.webm", {}), ("b.mkv", {"live": "1"})]
)
def test_tags_are_found_and_taken_out(tmp_path: Path, name: str, options: dict[str, str]) -> None:
    source = tagged(tmp_path / name, options)
    episode = write_private(tmp_path / "a.zarr", source)
    found = {item.kind: item for item in find_private(episode) if item.where.endswith(name)}
    assert all(item.removable for item in found.values())
    assert found.keys() == {"operator", "path", "gps"}
    store = open_store(episode)
    clean = tmp_path / "clean.zarr.zip"
    pack_store(without_private(store, EVERYTHING).store, clean)
    assert find_private(clean) == []
    with open_episode(episode) as was, open_episode(clean) as now:
        raw = now["rgb"].container()
        assert np.array_equal(was["rgb"].frames[:], now["rgb"].frames[:])
        images = now["rgb"].metadata.images  # type: ignore[attr-defined]  # it is an image stream
        assert isinstance(images, VideoImages)
        assert images.files[0].sha256 == hashlib.sha256(raw).hexdigest()
    assert len(raw) == source.stat().st_size
    said = " ".join(told(raw).values())
    assert "CC0" in said
    for secret in (b"Hopper", b"Grace", HOME.encode(), b"48.13"):
        assert secret not in raw
    if name == "a.mkv":  # a player that minds the checksums minds nothing
        with av.open(io.BytesIO(raw), "r", options={"err_detect": "crccheck+explode"}) as container:
            assert len(list(container.decode(video=0))) == 3


def test_a_container_that_is_not_understood(tmp_path: Path) -> None:
    path = tagged(tmp_path / "a.mp4", {"movflags": "frag_keyframe+empty_moov+default_base_moof"})
    path.write_bytes(b"\0\0\0\x10styp" + b"isom\0\0\0\0" + path.read_bytes())
    episode = write_private(tmp_path / "a.zarr", path)
    found = [item for item in find_private(episode) if item.where.endswith("mp4")]
    assert {item.removable for item in found} == {False}
    assert {"gps", "path"} <= {item.kind for item in found}
    with pytest.raises(UnsupportedError, match=r"ffmpeg .* -map_metadata -1"):
        without_private(open_store(episode), Removal(frozenset(["gps"])))


@pytest.mark.parametrize("suffix", [".avi", ".mkv"])
def test_damaged_files_end_somewhere(tmp_path: Path, suffix: str) -> None:
    raw = tagged(tmp_path / f"a{suffix}").read_bytes()
    find = avi_patches if suffix == ".avi" else matroska_patches
    draws = np.random.default_rng(3)
    for _ in range(200):
        spoilt = bytearray(raw[: draws.integers(12, len(raw))])
        for at in draws.integers(4, len(spoilt), 8):
            spoilt[at] = draws.integers(256)

        def read(at: int, length: int, content: bytes = bytes(spoilt)) -> bytes:
            assert 0 <= at <= len(content)
            return content[at : at + length]

        for patch in find(read, len(spoilt), {}):
            assert patch.start + len(patch.new) <= len(spoilt)


def test_a_file_of_nothing_but_heads() -> None:
    raw = b"RIFF\xff\xff\xff\xffAVI " + b"LIST\x04\0\0\0INFO" * 250_000
    with pytest.raises(LimitError):
        list(avi_patches(lambda at, length: raw[at : at + length], len(raw), {}))


def test_subtitles_in_other_containers_may_say_where_it_was() -> None:
    entry = b"\xae\x86" + b"\xd7\x81\x02" + b"\x83\x81\x11"  # track 2, subtitles
    tracks = b"\x16\x54\xae\x6b" + bytes([0x80 | len(entry)]) + entry
    raw = b"\x1a\x45\xdf\xa3\x80" + b"\x18\x53\x80\x67" + bytes([0x80 | len(tracks)]) + tracks
    (found,) = matroska_patches(lambda at, length: raw[at : at + length], len(raw), {})
    assert (found.kind, found.value, found.new) == ("gps", "subtitles", b"")
    header = b"LIST" + (16).to_bytes(4, "little") + b"strl" + b"strh\x04\0\0\0txts"
    avi = b"RIFF" + (len(header) + 4).to_bytes(4, "little") + b"AVI " + header
    (found,) = avi_patches(lambda at, length: avi[at : at + length], len(avi), {})
    assert (found.kind, found.value, found.new) == ("gps", "subtitles", b"")
