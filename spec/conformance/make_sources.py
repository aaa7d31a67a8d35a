#!/usr/bin/env python3
"""Make the few files of ``sources`` that an encoder has to make: images, a video, catalogs.

They are committed, because other versions of the encoders give other bytes. Run this only to
change what they show; afterwards run ``generate.py``.
"""

import io
import sys
import tempfile
from fractions import Fraction
from pathlib import Path

import av
import numpy as np
import simplejpeg

SOURCES = Path(__file__).parent / "sources"
SIDE = 16
# Cases of datasets whose episodes are not the two that the others have.
OWN_CATALOG = (
    "SET-002__other_id",
    "SET-003__folder_and_zip",
    "SET-007__egg_of_rice",
    "SET-008__seven_and_three",
    "SHARD-002__in_a_dataset",
    "SPLIT-006__eggs",
    "SPLIT-007__no_part",
    "SPLIT-009__egg",
    "TACT-012__other_gel",
)
FRAMES = 6


def picture(index: int, side: int) -> np.ndarray:
    """Return a gel with a round contact that wanders, (side, side, 3) uint8."""
    noise = np.random.default_rng(index).integers(-4, 5, (side, side, 3))
    y, x = np.mgrid[:side, :side] / side - 0.5
    centre = 0.25 * np.array([np.cos(index), np.sin(index)])
    bump = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / 0.02)
    image = np.stack((90 + 110 * bump, 120 - 60 * bump, 140 + 40 * x), axis=-1) + noise
    return np.ascontiguousarray(np.clip(image, 0, 255).astype(np.uint8))


def jpeg(image: np.ndarray) -> bytes:
    """Return a colour JPEG."""
    return bytes(simplejpeg.encode_jpeg(image, 60, "RGB", "420"))


def grey_jpeg(image: np.ndarray) -> bytes:
    """Return a grey JPEG of an image's green channel."""
    return bytes(simplejpeg.encode_jpeg(image[..., 1:2].copy(), 60, "GRAY", "Gray"))


def video() -> bytes:
    """Return an MPEG-4 file of 8 frames at 10 frames/s, with a keyframe every 4 frames."""
    buffer = io.BytesIO()
    options = {"fflags": "+bitexact"}
    with av.open(buffer, "w", format="mp4", options=options) as container:
        stream = container.add_stream("mpeg4", rate=10)
        stream.width = stream.height = 32
        stream.pix_fmt = "yuv420p"
        stream.gop_size = 4
        stream.codec_context.flags |= 1 << 23  # bitexact: no version in the stream
        for index in range(8):
            frame = av.VideoFrame.from_ndarray(picture(index, 32), format="rgb24")
            container.mux(stream.encode(frame))
        container.mux(stream.encode())
    return buffer.getvalue()


def grey_video() -> bytes:
    """Return an AVI file of 8 grey JPEG frames at 10 frames/s, as a camera without colour gives."""
    buffer = io.BytesIO()
    with av.open(buffer, "w", format="avi", options={"fflags": "+bitexact"}) as container:
        stream = container.add_stream("mjpeg", rate=10)
        stream.width = stream.height = 32
        stream.pix_fmt = "yuvj420p"  # its encoder has no grey; frames come from another one
        stream.codec_context.flags |= 1 << 23  # bitexact: no version in the stream
        for index in range(8):
            packet = av.Packet(grey_jpeg(picture(index, 32)))
            packet.stream = stream
            packet.pts = packet.dts = index
            packet.time_base = Fraction(1, 10)
            packet.is_keyframe = True
            container.mux(packet)
    return buffer.getvalue()


def catalog(files: dict[str, bytes], *, backwards: bool = False, **columns: list[str]) -> bytes:
    """Return the catalog of a dataset of these episodes, as the library writes it.

    Columns that are given stand in place of those of the episodes; rows may be turned round.
    """
    from exumi_data.catalog import build_catalog, write_catalog

    with tempfile.TemporaryDirectory() as folder:
        root = Path(folder)
        for path, data in files.items():
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_bytes(data)
        table, failed = build_catalog(root, workers=1)
        if failed:
            raise SystemExit(f"the episodes cannot be read: {failed[0].error}")
        for name, values in columns.items():
            place = table.schema.get_field_index(name)
            table = table.set_column(place, table.schema.field(name), [values])
        if backwards:
            table = table.take(list(reversed(range(len(table)))))
        return write_catalog(root, table).read_bytes()


def main() -> int:
    """Write the sources."""
    from corpus.datasets import episodes, packed_episodes

    SOURCES.mkdir(exist_ok=True)
    for index in range(FRAMES):
        (SOURCES / f"frame_{index}.jpg").write_bytes(jpeg(picture(index, SIDE)))
    (SOURCES / "frame_large.jpg").write_bytes(jpeg(picture(9, 2 * SIDE)))
    (SOURCES / "clip.mp4").write_bytes(video())
    (SOURCES / "clip_grey.avi").write_bytes(grey_video())
    (SOURCES / "frame_grey.jpg").write_bytes(grey_jpeg(picture(0, SIDE)))
    (SOURCES / "catalog.parquet").write_bytes(catalog(episodes()))
    (SOURCES / "catalog_packed.parquet").write_bytes(catalog(packed_episodes()))
    (SOURCES / "catalog_empty.parquet").write_bytes(catalog({}))
    wrong = catalog(episodes(), regime=["play", "demonstration"])
    (SOURCES / "catalog_CAT-003__regime.parquet").write_bytes(wrong)
    turned = catalog(episodes(), backwards=True)
    (SOURCES / "catalog_CAT-005__backwards.parquet").write_bytes(turned)
    from corpus.all_cases import invalid

    for case in invalid():
        if case.name in OWN_CATALOG:
            episodes_of_case = {p: b for p, b in case.files.items() if p.startswith("episodes/")}
            own = SOURCES / f"catalog_{case.name}.parquet"
            own.write_bytes(catalog(episodes_of_case))
    return 0


if __name__ == "__main__":
    sys.exit(main())
