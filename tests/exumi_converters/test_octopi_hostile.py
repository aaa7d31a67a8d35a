"""Octopi's samples and clips that mislead: each fails by its name, in bounded time and memory."""

import json
import os
import struct
import zlib
from pathlib import Path

import cv2
import numpy as np
import pytest

from exumi_converters import ConvertOptions, convert
from exumi_converters.octopi_samples import frame_paths
from exumi_data.errors import SourceError
from tests.exumi_converters.conftest import MakeClip

QUICK = ConvertOptions(workers=1, durable=False)


def jpeg(number: int = 0) -> bytes:
    image = np.full((48, 64, 3), 50 + 5 * number, np.uint8)
    return bytes(cv2.imencode(".jpg", image)[1].tobytes())


def huge_jpeg() -> bytes:
    """A file of a kilobyte that claims 12 GB of pixels."""
    raw = bytearray(jpeg())
    size = raw.index(b"\xff\xc0") + 5
    raw[size : size + 4] = struct.pack(">HH", 65_500, 65_500)
    return bytes(raw)


def png(width: int, height: int, bits: int = 8) -> bytes:
    def chunk(kind: bytes, data: bytes) -> bytes:
        body = kind + data
        return struct.pack(">I", len(data)) + body + struct.pack(">I", zlib.crc32(body))

    header = struct.pack(">IIBBBBB", width, height, bits, 2, 0, 0, 0)
    packed = zlib.compress(bytes(1000))
    return b"\x89PNG\r\n\x1a\n" + chunk(b"IHDR", header) + chunk(b"IDAT", packed)


def write(root: Path, name: str, frames: dict[str, bytes], document: bytes | None = None) -> Path:
    (root / name / "tactile").mkdir(parents=True)
    for file, raw in frames.items():
        (root / name / "tactile" / file).write_bytes(raw)
    said = json.dumps({"object_id": "physiclear_egg", "split": "train"}).encode()
    (root / name / "data.json").write_bytes(said if document is None else document)
    return root / name


def test_samples_that_mislead(tmp_path: Path) -> None:
    root = tmp_path / "in"
    good = {f"{i:010d}.jpg": jpeg(i) for i in range(4)}
    write(root, "physiclear_0", good)
    write(root, "physiclear_1", {"0.jpg": huge_jpeg(), "1.jpg": huge_jpeg()})
    write(root, "physiclear_2", {"0.png": png(60_000, 60_000)})
    write(root, "physiclear_3", {"0.png": png(8, 8, bits=16)})
    write(root, "physiclear_4", good, b"[" * 100_000)
    write(root, "physiclear_5", good, b'{"object_id": "' + b"y" * (2 << 20) + b'"}')
    write(root, "physiclear_6", good, json.dumps({"object_id": "x" * 400}).encode())
    write(root, "physiclear_7", good, rb'{"object_id": "physiclear_\ud800"}')
    (write(root, "physiclear_8", good) / "data.json").unlink()
    os.mkfifo(root / "physiclear_8" / "data.json")
    write(root, "physiclear_9", {**good, f"{'9' * 100}.jpg": jpeg()})
    report = convert(root, tmp_path / "out", from_format="octopi", options=QUICK)
    assert report.converted == 1
    reasons = {failure.name: failure.reason for failure in report.failed}
    assert "65500x65500" in reasons["physiclear_1"]
    assert "60000x60000" in reasons["physiclear_2"]
    assert "16 bits" in reasons["physiclear_3"]
    assert "cannot be read" in reasons["physiclear_4"]
    assert "larger than 1 MiB" in reasons["physiclear_5"]
    assert "its labels cannot be kept" in reasons["physiclear_6"]
    assert "its labels cannot be kept" in reasons["physiclear_7"]
    assert "no ordinary file" in reasons["physiclear_8"]
    assert "is not the number of a frame" in reasons["physiclear_9"]
    assert not any("defect" in reason for reason in reasons.values())


def test_pipes_among_frames_and_clips_are_passed_over(tmp_path: Path, make_clip: MakeClip) -> None:
    folder = write(tmp_path / "in", "physiclear_0", {"0.jpg": jpeg()}) / "tactile"
    os.mkfifo(folder / "1.jpg")
    assert [path.name for path in frame_paths(folder)] == ["0.jpg"]
    with pytest.raises(SourceError, match="no frames"):
        frame_paths(tmp_path)
    for name in ("octopi", "clips"):
        source = tmp_path / name
        make_clip(source / "egg_0.mov")
        os.mkfifo(source / "egg_1.mov")
        (source / "egg_2.mov").symlink_to("/dev/zero")
        report = convert(source, tmp_path / f"out-{name}", from_format=name, options=QUICK)
        assert (report.converted, report.failed) == (1, ())


@pytest.mark.parametrize("format_name", ["octopi", "clips"])
def test_names_that_no_text_can_hold(tmp_path: Path, make_clip: MakeClip, format_name: str) -> None:
    source = tmp_path / "in"
    clip = make_clip(source / "egg_0.mov")
    raw = clip.read_bytes()
    for name in (b"\xff_1.mov", b"two\nlines_1.mov"):
        Path(os.fsdecode(os.fsencode(source) + b"/" + name)).write_bytes(raw)
    (source / " bolt_3.mov").write_bytes(raw)
    report = convert(source, tmp_path / "out", from_format=format_name, options=QUICK)
    assert report.converted == 1
    assert len(report.failed) == 3
    for failure in report.failed:
        assert "cannot be recorded" in failure.reason or "cannot be kept" in failure.reason


def test_a_table_that_would_fill_the_memory(tmp_path: Path, make_clip: MakeClip) -> None:
    clip = make_clip(tmp_path / "in" / "a.mov")
    with clip.with_suffix(".csv").open("wb") as file:
        file.truncate(65 << 20)
    report = convert(tmp_path / "in", tmp_path / "out", from_format="clips", options=QUICK)
    assert "larger than 64 MiB" in report.failed[0].reason
