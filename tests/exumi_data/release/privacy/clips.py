"""Clips, frames and episodes in which there is something private, with known truth."""

import struct
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.clips.clip import list_frames
from exumi_data.model import Device, QualityNote, Sensor, Source, VideoImages
from exumi_data.simulation.gopro import SimulatedGoPro
from exumi_data.store.episode_writer import EpisodeWriter
from tests.exumi_data.builders import CLOCK, encoded_images, jpegs, metadata, times

HOME = "/".join(["", "home", "grace"])
POSITION = (48.1374, 11.5755)
CAMERA, LENS = b"C3441325750123", b"LAE6101112400243"


class Still:
    """A hand that does not turn."""

    def rad_per_s(self, t_s: Any) -> Any:
        return np.zeros((len(t_s), 3))


def clip(path: Path, *, position: tuple[float, float] | None = POSITION) -> Path:
    """A clip of two seconds, as a GoPro writes it."""
    start = datetime(2026, 3, 1, 12, tzinfo=UTC)
    SimulatedGoPro(position_deg=position).film(path, Still(), (0.0, 2.0), session_start=start)
    return path


def with_ids(path: Path) -> Path:
    """The same with the boxes in which a GoPro writes its serial numbers, in `udta` of `moov`."""
    raw = bytearray(path.read_bytes())
    moov = raw.index(b"moov") - 4
    assert moov + int.from_bytes(raw[moov : moov + 4], "big") == len(raw)  # it is the last box
    boxes = b"".join(
        struct.pack(">I4s", 8 + len(content), kind) + content
        for kind, content in ((b"CAME", bytes(range(1, 17))), (b"LENS", LENS.ljust(48, b"\0")))
    )
    settings = struct.pack(">4sBBH", b"CASN", ord("c"), 1, len(CAMERA)) + CAMERA + b"\0\0"
    device = struct.pack(">4sBBH", b"DEVC", 0, 1, len(settings)) + settings
    boxes += struct.pack(">I4s", 8 + len(device), b"GPMF") + device
    raw += struct.pack(">I4s", 8 + len(boxes), b"udta") + boxes
    raw[moov : moov + 4] = (len(raw) - moov).to_bytes(4, "big")
    path.write_bytes(raw)
    return path


def with_exif(jpeg: bytes) -> bytes:
    """A JPEG with Exif: where it was taken, by which camera, and an XMP packet."""
    serial = b"CAM-0042-7\0"
    latitude = struct.pack("<6I", 48, 1, 8, 1, 1464, 100)
    camera = 8 + 2 + 12 * 2 + 4
    values = camera + 2 + 12 + 4
    places = values + len(serial) + 1
    entries = [(0x8769, 4, 1, camera), (0x8825, 4, 1, places)]
    tiff = b"II*\0" + struct.pack("<I", 8) + _table(entries)
    tiff += _table([(0xA431, 2, len(serial), values)]) + serial + b"\0"
    end = places + 2 + 12 * 2 + 4
    north = int.from_bytes(b"N\0\0\0", "little")
    tiff += _table([(1, 2, 2, north), (2, 5, 3, end)]) + latitude
    packet = b"http://ns.adobe.com/xap/1.0/\0<x:xmpmeta><exif:GPSLatitude>48,8N</exif:GPSLatitude>"
    return jpeg[:2] + _app1(b"Exif\0\0" + tiff) + _app1(packet) + jpeg[2:]


def _table(entries: list[tuple[int, int, int, int]]) -> bytes:
    rows = b"".join(struct.pack("<HHII", *entry) for entry in entries)
    return struct.pack("<H", len(entries)) + rows + bytes(4)


def _app1(content: bytes) -> bytes:
    return b"\xff\xe1" + (len(content) + 2).to_bytes(2, "big") + content


def write_private(path: Path, clip_path: Path, number: int = 0, **changes: Any) -> Path:
    """An episode with something private of every kind."""
    source = Source(
        type="recorded",
        tool="hub",
        tool_version="1",
        settings={
            "out": f"{HOME}/jars of sand/take 1",
            "camera": "/dev/v4l/by-id/usb-046d_HD_Webcam_9A8B7C6D-video-index0",
            "tracker": {"address": "192.168.7.31", "board_serial": "TRK-99", "hostname": "lab-7"},
            "where": {"latitude": 48.1374, "longitude": 11.5755},
        },
    )
    values: dict[str, Any] = {
        "operator": "Grace Hopper",
        "site": "Building 7",
        "device": Device(name="exumi", serial="EX-0007", hub="hub-of-grace"),
        "source": source,
        "quality": [_note("Grace Hopper dropped it; ask grace or grace.h@lab.example")],
        **changes,
    }
    with EpisodeWriter(path, metadata(number, **values), durable=False) as writer:
        rgb = writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=_video(), sensor=_sensor())
        frames = list_frames(clip_path, clip_path.name)
        rgb.append_file(clip_path, frames.file, pts=frames.pts, keyframe=frames.keyframe)
        tactile = writer.add_stream("tactile", kind="tactile", clock=CLOCK, images=encoded_images())
        plain = list(jpegs())
        tactile.append(times(), [*plain[:2], with_exif(plain[2]), *plain[3:]])
    return path


def _note(message: str) -> QualityNote:
    return QualityNote(code="dropped", message=message)


def _sensor() -> Sensor:
    return Sensor(model="gopro-hero12", serial=CAMERA.decode())


def _video() -> VideoImages:
    return VideoImages(encoding="video", height=32, width=32, channels=3)
