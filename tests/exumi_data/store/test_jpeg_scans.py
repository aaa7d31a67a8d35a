"""How often a decoder goes over a picture: shown by the header, or else counted."""

import cv2
import numpy as np
import pytest
import simplejpeg

from exumi_data.errors import DamagedDataError
from exumi_data.store import jpeg

SIDE = 16
RNG = np.random.default_rng(5)


def grey_file() -> bytes:
    return jpeg.encode(RNG.integers(0, 256, (SIDE, SIDE, 1), np.uint8), 90)


def colour_file() -> bytes:
    return jpeg.encode(RNG.integers(0, 256, (SIDE, SIDE, 3), np.uint8), 90)


def progressive_file() -> bytes:
    picture = RNG.integers(0, 256, (SIDE, SIDE, 3), np.uint8)
    ok, data = cv2.imencode(".jpg", picture, [cv2.IMWRITE_JPEG_PROGRESSIVE, 1])
    assert ok
    return data.tobytes()


def scan_of_each(files: list[bytes], order: list[int]) -> bytes:
    """Make one baseline colour JPEG of grey ones: each of its components in a scan of its own."""
    header = files[0][: files[0].index(b"\xff\xc0")]
    frame = bytearray(files[0][len(header) :][:13])
    frame[2:4], frame[9] = (17).to_bytes(2, "big"), 3
    components = b"".join(bytes((number, 0x11, 0)) for number in (1, 2, 3))
    tables = files[0][len(header) + 13 : files[0].index(b"\xff\xda")]
    scans = []
    for number in order:
        data = files[number][files[number].index(b"\xff\xda") + 10 : -2]
        scans.append(b"\xff\xda\x00\x08\x01" + bytes((number + 1,)) + b"\x00\x00\x3f\x00" + data)
    return header + bytes(frame[:10]) + components + tables + b"".join(scans) + b"\xff\xd9"


def decoded(data: bytes, channels: int = 1) -> np.ndarray:
    out = np.empty((SIDE, SIDE, channels), np.uint8)
    jpeg.decode_into(data, out)
    return out


@pytest.mark.parametrize("make", [grey_file, colour_file])
def test_files_as_they_are_written_show_it(make: object) -> None:
    data = make()  # type: ignore[operator]  # one of the two
    assert jpeg._has_one_scan(data)
    # libjpeg refuses what the header rules out, however often it is there.
    scan = data[data.index(b"\xff\xda") : -2]
    for more in (1, 2, 64, 1000):
        with pytest.raises(ValueError, match="more than one scan"):
            simplejpeg.decode_jpeg(data[:-2] + scan * more + data[-2:])
        with pytest.raises(DamagedDataError, match="scan"):
            decoded(data[:-2] + scan * more + data[-2:])


def test_a_component_each_is_counted() -> None:
    files = [grey_file() for _ in range(3)]
    sound = scan_of_each(files, [0, 1, 2])
    assert not jpeg._has_one_scan(sound)
    np.testing.assert_array_equal(decoded(sound), decoded(files[0]))
    most = scan_of_each(files, [0] * 62 + [1, 2])
    np.testing.assert_array_equal(decoded(most), decoded(files[0]))
    # The decoder would go over the picture as often as it is told to.
    hostile = scan_of_each(files, [0] * 63 + [1, 2])
    simplejpeg.decode_jpeg(hostile)
    with pytest.raises(DamagedDataError, match="more than 64 scans"):
        decoded(hostile)


def test_a_progressive_one_is_counted() -> None:
    data = progressive_file()
    assert 1 < data.count(b"\xff\xda") <= 64
    assert not jpeg._has_one_scan(data)
    assert decoded(data, 3).any()
    scan = data[data.rindex(b"\xff\xda") : -2]
    with pytest.raises(DamagedDataError, match="more than 64 scans"):
        decoded(data[:-2] + scan * 64 + data[-2:], 3)


def test_headers_that_show_nothing() -> None:
    data = grey_file()
    start = data.index(b"\xff\xda")

    def changed(at: int, value: int) -> bytes:
        return data[:at] + bytes((value,)) + data[at + 1 :]

    marked = data[:2] + b"\xff\xfe\x00\x06\xff\xda\x01\x01" + data[2:]
    np.testing.assert_array_equal(decoded(marked), decoded(data))
    long = data[:2] + (b"\xff\xfe\x13\x88" + bytes(4998)) + data[2:]
    np.testing.assert_array_equal(decoded(long), decoded(data))
    frame = data.index(b"\xff\xc0")
    unproven = {
        "a comment that looks like a scan": marked,
        "a long header": long,
        "cut short": data[: start + 4],
        "no header": data[start:],
        "no scan": data[:start],
        "nothing": b"",
        "no start": b"\xff\xd9" + data[2:],
        "fewer components in the scan": changed(frame + 9, 3),
        "more components in the scan": changed(start + 4, 3),
        "progressive": changed(frame + 1, 0xC2),
        "a segment that ends elsewhere": changed(5, data[5] + 1),
        "a segment without length": changed(5, 1),
        "two frames": data[:start] + data[frame : frame + 13] + data[start:],
        "no frame": data[:frame] + data[frame + 13 :],
        "a frame cut short": data[:frame] + b"\xff\xc0\x00\x02" + data[start:],
    }
    for name, file in unproven.items():
        assert not jpeg._has_one_scan(file), name
