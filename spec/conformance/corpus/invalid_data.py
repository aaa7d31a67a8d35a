"""Invalid cases: the frames themselves."""

from collections.abc import Iterator

import numpy as np

from corpus import bases
from corpus.case import Case, Finding, case
from corpus.draft import Draft, crc32c

__all__ = ["data_cases"]

DATA = "streams/rgb/data"


def _frames(files: list[bytes], *, step_ns: int = bases.FRAME_NS) -> Draft:
    draft = bases.encoded()
    bases.put_encoded(draft, "rgb", files, step_ns=step_ns)
    return draft


def _file_cases() -> Iterator[Case]:
    files = bases.jpegs()
    draft = bases.encoded()
    checksums = np.array([crc32c(file) for file in files], dtype=np.uint32)
    checksums[1] ^= 1
    draft.put("streams/rgb/crc32c", checksums)
    at = Finding("IMG-005", DATA, index=1)
    yield case("IMG-005__checksum", "A frame with another checksum.", draft, at)
    draft = _frames([files[0], files[1], files[2][:400], files[3]])
    at = Finding("IMG-006", DATA, index=2)
    yield case("IMG-006__half_a_jpeg", "A JPEG cut short before it was stored.", draft, at)
    scans = files[2][:-2] + b"\xff\xda\x00\x08\x01\x01\x00\x00\x3f\x00" * 100 + b"\xff\xd9"
    draft = _frames([files[0], files[1], scans, files[3]])
    about = "A JPEG that goes over the picture a hundred times."
    yield case("IMG-006__hundred_scans", about, draft, at)
    large = (bases.SOURCES / "frame_large.jpg").read_bytes()
    draft = _frames([*files[:3], large])
    at = Finding("IMG-007", DATA, index=3)
    yield case("IMG-007__larger", "A frame of another size.", draft, at)
    draft = bases.encoded()
    draft.metadata["streams"]["rgb"]["images"]["jpeg_comment"] = "Lavc62.0.100"
    found = [Finding("IMG-008", DATA, index=index) for index in range(4)]
    yield case("IMG-008__no_comment", "A comment that no frame carries.", draft, *found)
    draft = _frames([files[0], *[files[1]] * 4, files[2]], step_ns=500_000_000)
    at = Finding("IMG-009", DATA, index=1)
    yield case("IMG-009__one_and_a_half_seconds", "The same frame for 1.5 s.", draft, at)


def _video_cases() -> Iterator[Case]:
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["files"][0]["sha256"] = "0" * 64
    at = Finding("VID-006", DATA, index=0)
    yield case("VID-006__digest", "A file with another digest.", draft, at)
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["files"][0]["codec"] = "h264"
    at = Finding("VID-007", DATA, index=0)
    yield case("VID-007__codec", "Another codec than stated.", draft, at)
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["files"][0]["media_type"] = "video/x-msvideo"
    yield case("VID-007__container", "Another container than stated.", draft, at)
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["channels"] = 1
    yield case("VID-007__grey", "A colour file that is stated as grey.", draft, at)
    draft = bases.video()
    draft.metadata["streams"]["rgb"]["images"]["files"][0]["pixel_format"] = "gray"
    yield case("VID-007__pixel_format", "Another pixel format than stated.", draft, at)
    clip = (bases.SOURCES / "clip.mp4").read_bytes()
    place = clip.index(b"stsz") + 8
    claim = (1).to_bytes(4, "big") + (10_000_000).to_bytes(4, "big")
    draft = bases.video(clip[:place] + claim + clip[place + 8 :])
    about = "A table of ten million samples of one byte, in eight bytes."
    yield case("VID-007__ten_million_samples", about, draft, at)
    draft = bases.video()
    draft.put("streams/rgb/time", bases.times(9))
    draft.put("streams/rgb/file", np.zeros(9, dtype=np.uint32))
    draft.put("streams/rgb/pts", np.arange(9, dtype=np.int64) * 1024)
    keyframe = np.array([0, 0, 0, 0, 4, 4, 4, 4, 4], dtype=np.uint64)
    draft.put("streams/rgb/keyframe", keyframe)
    at = Finding("VID-008", DATA, index=8)
    yield case("VID-008__ninth_of_eight", "A frame that the file does not hold.", draft, at)
    draft = bases.video()
    draft.put("streams/rgb/time", bases.times(7))
    draft.put("streams/rgb/file", np.zeros(7, dtype=np.uint32))
    draft.put("streams/rgb/pts", np.arange(7, dtype=np.int64) * 1024)
    draft.put("streams/rgb/keyframe", np.array([0, 0, 0, 0, 4, 4, 4], dtype=np.uint64))
    at = Finding("VID-009", DATA, index=0)
    yield case("VID-009__last_frame", "A frame that is not listed.", draft, at)
    draft = bases.video()
    keyframe = np.array([0, 0, 2, 2, 4, 4, 4, 4], dtype=np.uint64)
    draft.put("streams/rgb/keyframe", keyframe)
    at = Finding("VID-010", DATA, index=2)
    yield case("VID-010__no_keyframe", "A frame that cannot be started from.", draft, at)


def data_cases() -> Iterator[Case]:
    """Yield the cases of the level of data."""
    yield from _file_cases()
    yield from _video_cases()
