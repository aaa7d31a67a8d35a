"""Texts in the heads of JPEG pictures: found in whatever form, and taken out where they lie."""

import struct
from pathlib import Path

import numpy as np
import pytest
import simplejpeg

from exumi_data.episode import open_episode
from exumi_data.release.privacy import KINDS, Removal, find_private, without_private
from exumi_data.release.privacy.exif import jpeg_patches
from exumi_data.release.privacy.kinds import Kind
from exumi_data.store.access import open_store
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.pack import pack_store
from tests.exumi_data.builders import CLOCK, encoded_images, jpegs, metadata, times

NAMES: dict[str, Kind] = {"Zoë Müller": "operator"}
APP1, APP2, APP5, APP7, APP13, COM = 0xE1, 0xE2, 0xE5, 0xE7, 0xED, 0xFE
FOLDER = "/".join(["", "home", "zoe"])


def segment(marker: int, content: bytes) -> bytes:
    return b"\xff" + bytes([marker]) + struct.pack(">H", len(content) + 2) + content


def with_head(*segments: bytes) -> bytes:
    plain = jpegs()[0]
    return plain[:2] + b"".join(segments) + plain[2:]


def exif(entries: dict[int, tuple[int, bytes]], after: bytes = b"") -> bytes:
    """A table of values that all lie behind it; `after` is a second one."""
    place = 8 + 2 + 12 * len(entries) + 4
    rows, values = b"", b""
    for tag, (form, value) in sorted(entries.items()):
        rows += struct.pack("<HHII", tag, form, len(value), place + len(values))
        values += value
    following = place + len(values) if after else 0
    head = b"II*\0" + struct.pack("<I", 8) + struct.pack("<H", len(entries))
    return b"Exif\0\0" + head + rows + struct.pack("<I", following) + values + after


def iptc(**values: bytes) -> bytes:
    data = b"".join(
        b"\x1c\x02" + bytes([int(tag[1:])]) + struct.pack(">H", len(value)) + value
        for tag, value in values.items()
    )
    return b"Photoshop 3.0\x008BIM\x04\x04\0\0" + struct.pack(">I", len(data)) + data


def told(picture: bytes) -> tuple[set[tuple[str, str]], bytes]:
    """What is found, and the picture without it."""
    found = list(jpeg_patches(lambda at, n: picture[at : at + n], len(picture), NAMES))
    made = bytearray(picture)
    for patch in found:
        made[patch.start : patch.start + len(patch.new)] = patch.new
    return {(patch.kind, patch.value) for patch in found}, bytes(made)


@pytest.mark.parametrize(
    ("head", "found"),
    [
        (segment(COM, b"by zoe_muller_2"), {("operator", "zoe_muller")}),
        (segment(COM, "by Zoë Müller".encode()), {("operator", "Zoë Müller")}),
        (segment(COM, "by Zoë Müller".encode("latin-1")), {("operator", "Zoë Müller")}),
        (b"\xff\xff" + segment(COM, b"by Zoe Muller"), {("operator", "Zoe Muller")}),
        (segment(APP5, b"note\0a@lab.example"), {("email", "a@lab.example")}),
        (segment(APP7, b"\x01\x02\xe9Zoe Muller\x03\xff"), {("operator", "Zoe Muller")}),
        (
            segment(APP1, exif({0x010E: (2, "Zoë Müller's, a@lab.example\0".encode())})),
            {("operator", "Zoë Müller"), ("email", "a@lab.example")},
        ),
        (
            segment(APP1, exif({0x0131: (2, f"{FOLDER}/cam\0".encode()), 0x010F: (2, b"Cam\0")})),
            {("path", f"{FOLDER}/cam")},
        ),
        (segment(APP1, exif({0x8298: (2, b"(c) Zoe Muller\0")})), {("operator", "Zoe Muller")}),
        (
            segment(APP1, exif({0x9C9C: (1, "of Zoë Müller\0".encode("utf-16-le"))})),
            {("operator", "Zoë Müller")},
        ),
        (
            segment(APP1, exif({0x9C9D: (1, "Eve Novak\0".encode("utf-16-le"))})),
            {("operator", "Eve Novak")},
        ),
        (
            segment(APP1, exif({0x9286: (7, b"UNICODE\0" + "Zoë Müller".encode("utf-16-be"))})),
            {("operator", "Zoë Müller")},
        ),
        (
            segment(APP1, exif({0x9286: (7, b"ASCII\0\0\0by Zoe Muller")})),
            {("operator", "Zoe Muller")},
        ),
        (
            segment(APP13, iptc(t80=b"Eve Novak", t90=b"Munich", t120=b"Zoe Muller, indoors")),
            {("operator", "Eve Novak"), ("site", "Munich"), ("operator", "Zoe Muller")},
        ),
        (
            segment(APP1, b"http://ns.adobe.com/xap/1.0/\0<dc:rights>Zoe Muller</dc:rights>"),
            {("operator", "Zoe Muller")},
        ),
    ],
)
def test_texts_are_found_and_taken_out(head: bytes, found: set[tuple[str, str]]) -> None:
    picture = with_head(head)
    listed, clean = told(picture)
    assert listed == found
    assert len(clean) == len(picture)
    assert told(clean)[0] == set()
    assert clean[2 : 4 + head.count(b"\xff\xff")] == picture[2 : 4 + head.count(b"\xff\xff")]
    assert clean.endswith(jpegs()[0][2:])
    assert np.array_equal(
        simplejpeg.decode_jpeg(clean, colorspace="RGB"),
        simplejpeg.decode_jpeg(jpegs()[0], colorspace="RGB"),
    )


def test_texts_of_the_small_pictures_table() -> None:
    second = struct.pack("<H", 0) + bytes(4)
    value = b"Zoe Muller\0"
    head = exif({0x010F: (2, b"Cam\0")}, second)
    at = len(head) - len(b"Exif\0\0") + 12
    row = struct.pack("<HHII", 0x010E, 2, len(value), at)
    head = head[: -len(second)] + struct.pack("<H", 1) + row + bytes(4) + value
    assert told(with_head(segment(APP1, head)))[0] == {("operator", "Zoe Muller")}


@pytest.mark.parametrize(
    "head",
    [
        segment(APP2, b"ICC_PROFILE\0\x01\x01Zoe Muller"),  # decoders read it
        segment(COM, b"CREATOR: gd-jpeg v1.0 (using IJG JPEG v80), quality = 95"),
        segment(APP1, exif({0x0132: (2, b"2026:03:01 12:00:00\0"), 0x010F: (2, b"GoPro\0")})),
        segment(APP13, iptc(t0=b"\0\x02", t120=b"a mug")),
        segment(APP7, bytes(range(256))),
    ],
)
def test_what_tells_of_nobody_stays(head: bytes) -> None:
    assert told(with_head(head))[0] == set()


def test_frames_of_an_episode(tmp_path: Path) -> None:
    plain = list(jpegs())
    comment = segment(COM, b"by Zoe Muller in Room 12")
    frames = [one[:2] + comment + one[2:] for one in plain]
    said = metadata(0, operator="Zoë Müller", site="Room 12")
    with EpisodeWriter(tmp_path / "a.zarr", said, durable=False) as writer:
        stream = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        stream.append(times(), frames)
    where = "streams/tactile: JPEG frames"
    found = {one.value for one in find_private(tmp_path / "a.zarr") if one.where == where}
    assert found == {"Zoe Muller", "Room 12"}
    store = open_store(tmp_path / "a.zarr")
    clean = tmp_path / "b.zarr.zip"
    pack_store(without_private(store, Removal(frozenset(KINDS))).store, clean)
    store.close()
    assert find_private(clean) == []
    with open_episode(tmp_path / "a.zarr") as was, open_episode(clean) as now:
        assert np.array_equal(was["tactile"].frames[:], now["tactile"].frames[:])
    assert b"Muller" not in clean.read_bytes()
