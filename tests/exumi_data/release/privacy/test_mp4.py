import struct
from collections.abc import Sequence

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from exumi_data.errors import LimitError
from exumi_data.release.privacy.exif import jpeg_patches
from exumi_data.release.privacy.gpmf import gpmf_patches
from exumi_data.release.privacy.mp4 import mp4_patches
from exumi_data.release.privacy.patches import Patch
from exumi_data.release.privacy.scanning import _taken
from exumi_data.simulation.gopro import gpmf_payload
from tests.exumi_data.builders import jpegs
from tests.exumi_data.release.privacy.clips import HOME, with_exif

GYRO = np.zeros((4, 3))


def box(kind: bytes, *content: bytes) -> bytes:
    inner = b"".join(content)
    return struct.pack(">I4s", 8 + len(inner), kind) + inner


def full(kind: bytes, *words: int) -> bytes:
    return box(kind, bytes(4), *(word.to_bytes(4, "big") for word in words))


def track(form: bytes, samples: Sequence[bytes], *, start: int, handler: bytes = b"meta") -> bytes:
    """A track whose samples lie one after the other from `start`, in chunks of two."""
    chunks = range(0, len(samples), 2)
    places = [start + sum(map(len, samples[:chunk])) for chunk in chunks]
    tables = box(
        b"stbl",
        box(b"stsd", bytes(4), (1).to_bytes(4, "big"), box(form, bytes(8))),
        full(b"stsc", 1, 1, 2, 1),
        full(b"stsz", 0, len(samples), *map(len, samples)),
        full(b"stco", len(places), *places),
    )
    media = box(b"mdia", box(b"hdlr", bytes(8), handler, bytes(12)), box(b"minf", tables))
    return box(b"trak", media)


def movie(form: bytes, samples: Sequence[bytes], *more: bytes) -> bytes:
    data = box(b"ftyp", b"isom") + box(b"mdat", *samples)
    return data + box(b"moov", track(form, samples, start=20), *more)


def patches(raw: bytes) -> list[Patch]:
    return list(mp4_patches(lambda at, length: raw[at : at + length], len(raw)))


def patched(raw: bytes, found: list[Patch]) -> bytes:
    made = bytearray(raw)
    for patch in found:
        made[patch.start : patch.start + len(patch.new)] = patch.new
    assert len(made) == len(raw)
    return bytes(made)


def told(found: list[Patch]) -> list[tuple[str, str]]:
    return [(patch.kind, patch.value) for patch in found]


def test_positions_in_telemetry_go_and_all_else_stays() -> None:
    samples = [gpmf_payload(GYRO, total=4, position_deg=(-33.5, 151.25)) for _ in range(3)]
    raw = movie(b"gpmd", samples)
    found = patches(raw)
    assert {patch.kind for patch in found} == {"gps"}
    assert ("gps", "-33.5, 151.2") in told(found)
    clean = patched(raw, found)
    assert patches(clean) == []
    assert clean.count(b"GYRO") == 3
    assert clean.count(b"FREE") == 3 * 4
    assert b"GPS5" not in clean


def test_telemetry_without_a_fix_tells_nothing() -> None:
    payload = gpmf_payload(GYRO, total=4, position_deg=(0.0, 0.0))
    at = payload.index(b"GPS5") + 8
    nothing = payload[:at] + bytes(len(payload) - at)
    assert list(gpmf_patches(nothing, 0)) == []
    assert list(gpmf_patches(payload, 0))


def test_positions_of_a_device_that_is_known_by_its_streams_name() -> None:
    def record(key: bytes, kind: bytes, size: int, content: bytes) -> bytes:
        count = len(content) // size
        return struct.pack(">4scBH", key, kind, size, count) + content + bytes(-len(content) % 4)

    stream = record(b"STNM", b"c", 1, b"GPS RAW") + record(b"XYZW", b"l", 4, bytes(range(8)))
    device = record(b"DEVC", b"\0", 1, record(b"STRM", b"\0", 1, stream))
    (patch,) = gpmf_patches(device, 100)
    assert device[patch.start - 100 :][:4] == b"XYZW"
    assert patch.new[:4] == b"FREE"
    assert not any(patch.new[8:])


def test_the_recovery_track_of_a_gopro() -> None:
    header = b"GPRO\x6c\x02\0\0H19.03" + b"C33632245042171" + bytes(39) + b"\xc7"
    header += b"+33.1268-117.3273/\0" + bytes(200)
    raw = movie(b"fdsc", [header, b"GPRO" + bytes(12)])
    found = patches(raw)
    assert told(found) == [("gps", "+33.1268-117.3273/"), ("serial", "C33632245042171")]
    only = patched(raw, found[:1])
    assert b"33.1268" not in only
    assert b"C33632245042171" in only
    assert told(patches(patched(raw, found[1:]))) == []


def test_a_metadata_track_that_is_not_understood() -> None:
    raw = movie(b"camm", [b"somewhere", b"on earth"])
    found = patches(raw)
    assert {patch.kind for patch in found} == {"gps"}
    assert "not understood" in found[0].why
    assert b"earth" not in patched(raw, found)
    assert patches(patched(raw, found)) == []
    assert patches(movie(b"tmcd", [b"\0\0\0\x01"])) == []


def test_a_track_in_fragments_cannot_be_cleaned() -> None:
    raw = movie(b"camm", []) + box(b"moof")
    (patch,) = patches(raw)
    assert (patch.kind, patch.new) == ("gps", b"")


def test_what_the_file_says_of_itself() -> None:
    place = b"\x00\x12\x15\xc7+33.1268-117.3273/"
    named = [b"com.apple.quicktime.location.ISO6709", b"com.apple.quicktime.author", b"other.key"]
    keys = box(b"keys", bytes(4), (3).to_bytes(4, "big"), *(box(b"mdta", name) for name in named))
    values = [b"+48.1374+011.5755/", b"Ada", f"cut in {HOME}/clips".encode()]
    items = box(b"ilst", *(
        box(number.to_bytes(4, "big"), box(b"data", (1).to_bytes(4, "big"), bytes(4), value))
        for number, value in enumerate(values, 1)
    ))  # fmt: skip
    meta = box(b"meta", box(b"hdlr", bytes(8), b"mdta", bytes(12)), keys, items)
    udta = box(b"udta", box(b"\xa9xyz", place), box(b"\xa9too", b"\0\x0dU\xc4Lavf58.29.100"), meta)
    raw = movie(b"tmcd", [b"\0\0\0\x01"], udta)
    found = patches(raw)
    assert told(found) == [
        ("gps", "+33.1268-117.3273/"),
        ("gps", "+48.1374+011.5755/"),
        ("operator", "Ada"),
        ("path", f"{HOME}/clips"),
    ]
    clean = patched(raw, found)
    assert patches(clean) == []
    assert b"Lavf58" in clean


def test_xmp_and_exif() -> None:
    packet = b"<x:xmpmeta><exif:GPSLatitude>48</exif:GPSLatitude></x:xmpmeta>"
    uuid = bytes.fromhex("be7acfcb97a942e89c71999491e3afac")
    raw = movie(b"tmcd", [b"\0\0\0\x01"]) + box(b"uuid", uuid, packet)
    assert told(patches(raw)) == [("gps", "GPSLatitude")]
    assert uuid in patched(raw, patches(raw))
    picture = with_exif(jpegs()[0])
    found = list(jpeg_patches(lambda at, length: picture[at : at + length], len(picture)))
    assert {(patch.kind, patch.value) for patch in found} == {
        ("gps", "Exif GPS"),
        ("gps", "GPSLatitude"),
        ("serial", "CAM-0042-7"),
    }
    clean = patched(picture, found)
    assert clean.endswith(jpegs()[0][2:])
    assert list(jpeg_patches(lambda at, length: clean[at : at + length], len(clean))) == []


def test_tables_that_ask_for_more_than_there_is() -> None:
    raw = movie(b"camm", [b"somewhere"])
    at = raw.index(b"stsz") + 8
    with pytest.raises(LimitError, match="overlap"):
        patches(raw[:at] + struct.pack(">II", 4, 1_000_000) + raw[at + 8 :])
    with pytest.raises(LimitError, match="claims"):
        patches(raw[:at] + struct.pack(">II", 4, 1 << 30) + raw[at + 8 :])


def test_what_is_too_long_to_be_held_cannot_be_taken_out(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("exumi_data.release.privacy.patches._MOST_BYTES", 8)
    found = patches(movie(b"camm", [b"here", b"somewhere else"]))
    assert [len(patch.new) for patch in found] == [4, 0]
    told_of = []

    def take(kind: str, where: str, value: str, why: str, *, removable: bool = True) -> bool:
        told_of.append(removable)
        return True

    assert _taken(iter(found), "clip", take) == found[:1]
    assert told_of == [True, False]


def test_boxes_in_boxes_without_end_are_passed_over() -> None:
    raw = box(b"free")
    for _ in range(3000):
        raw = box(b"trak", raw)
    assert patches(box(b"moov", raw)) == []


@given(st.binary(max_size=60), st.integers(0, 700), st.integers(0, 255))
def test_damage_never_harms(noise: bytes, place: int, value: int) -> None:
    payload = gpmf_payload(GYRO, total=4, position_deg=(48.0, 11.0))
    whole = movie(b"gpmd", [payload], box(b"udta", box(b"LENS", b"LAE6101112400243")))
    picture = with_exif(jpegs()[0])
    for raw, find in ((whole, mp4_patches), (picture, jpeg_patches)):
        spoilt = bytearray(raw)
        spoilt[place % len(raw)] = value
        for data in (bytes(spoilt) + noise, raw[: place % len(raw)] + noise, noise):

            def read(at: int, length: int, data: bytes = data) -> bytes:
                return data[at : at + length]

            try:
                found = list(find(read, len(data)))
            except LimitError:
                continue
            assert all(p.start >= 0 and p.start + len(p.new) <= len(data) for p in found)


@pytest.mark.parametrize("handler", [b"text", b"sbtl", b"subt"])
def test_subtitles_may_say_where_it_was(handler: bytes) -> None:
    text = b"[latitude: 48.137430] [longitude: 11.575490]"
    samples = [struct.pack(">H", len(text)) + text, bytes(2)]
    data = box(b"ftyp", b"isom") + box(b"mdat", *samples)
    raw = data + box(b"moov", track(b"tx3g", samples, start=20, handler=handler))
    found = patches(raw)
    assert told(found) == [("gps", "tx3g")]
    clean = patched(raw, found)
    assert b"latitude" not in clean
    assert patches(clean) == []


def test_a_track_whose_tables_are_not_understood_may_hold_anything() -> None:
    raw = movie(b"priv", [b"48.13743, 11.57549"])
    assert told(patches(raw)) == [("gps", "priv")]
    (found,) = patches(raw.replace(b"stsz", b"stz2"))
    assert (found.kind, found.new) == ("gps", b"")
    assert "tables" in found.why


def test_a_position_in_a_box_with_a_long_length_goes_whole() -> None:
    content = struct.pack(">HH", 20, 0x15C7) + b"+48.13743+011.57549/"
    long = struct.pack(">I4sQ", 1, b"\xa9xyz", 16 + len(content)) + content
    raw = box(b"ftyp", b"isom") + box(b"moov", box(b"udta", long, box(b"kept", b"yes")))
    found = patches(raw)
    assert [patch.kind for patch in found] == ["gps"]
    clean = patched(raw, found)
    assert b"57549" not in clean
    assert clean == raw.replace(b"\xa9xyz", b"free").replace(content, bytes(len(content)))


def test_what_fragments_and_long_boxes_say(monkeypatch: pytest.MonkeyPatch) -> None:
    said = box(b"udta", box(b"\xa9xyz", struct.pack(">HH", 18, 0), b"+48.1374+011.5755/"))
    raw = box(b"ftyp", b"isom") + box(b"moof", box(b"traf", said))
    (found,) = patches(raw)
    assert found.kind == "gps"
    assert b"48.1" not in patched(raw, [found])
    monkeypatch.setattr("exumi_data.release.privacy.mp4._MAX_SMALL", 64)
    raw = box(b"ftyp", b"isom") + box(b"moov", box(b"udta", box(b"text", b"nothing" * 40)))
    (found,) = patches(raw)
    assert "too long to read" in found.why
    assert patches(patched(raw, [found])) == []
