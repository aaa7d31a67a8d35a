"""Small sources made on the spot: clips of a gel that is pressed, in every layout that is read."""

import json
from collections.abc import Callable, Mapping
from fractions import Fraction
from pathlib import Path

import av
import cv2
import numpy as np
import pytest

from exumi_converters import ConversionReport, ConvertOptions, convert
from exumi_data.dataset import Dataset, open_dataset

HEIGHT, WIDTH = 120, 160

MakeFrames = Callable[..., list[np.ndarray]]
MakeClip = Callable[..., Path]


def gel_frames(count: int, contact: range | None = None, seed: int = 0) -> list[np.ndarray]:
    """(H, W, 3) uint8 RGB frames: a smooth gel, and something textured on it during `contact`."""
    contact = range(count // 3, 2 * count // 3) if contact is None else contact
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:HEIGHT, :WIDTH].astype(np.float32)
    base = np.stack([90 + 0.3 * x, 110 + 0.2 * y, 140 - 0.2 * x], axis=-1)
    frames = []
    for index in range(count):
        frame = base + rng.normal(0, 0.6, base.shape)
        if index in contact:
            shift = 3 * (index - contact.start)
            blob = np.exp(-((x - 40 - shift) ** 2 + (y - 60) ** 2) / 500)
            frame += (60 * blob * np.sin(x / 2) * np.cos(y / 2))[..., None]
        frames.append(frame.clip(0, 255).astype(np.uint8))
    return frames


@pytest.fixture(scope="session")
def make_frames() -> MakeFrames:
    return gel_frames


@pytest.fixture(scope="session")
def make_clip() -> MakeClip:
    """Write a video: by default MPEG-4 with a keyframe every 12 frames, as Octopi's are."""

    def make(
        path: Path,
        frames: int | list[np.ndarray] = 30,
        *,
        rate: str = "25",
        codec: str = "mpeg4",
        seed: int = 0,
        faststart: bool = False,
    ) -> Path:
        pictures = gel_frames(frames, seed=seed) if isinstance(frames, int) else frames
        path.parent.mkdir(parents=True, exist_ok=True)
        options = {"movflags": "faststart"} if faststart else {}
        with av.open(str(path), "w", options=options) as container:
            stream = container.add_stream(codec, rate=Fraction(rate))
            assert isinstance(stream, av.VideoStream)
            stream.height, stream.width = pictures[0].shape[:2]
            stream.pix_fmt = "yuvj420p" if codec == "mjpeg" else "yuv420p"
            stream.codec_context.gop_size = 12
            stream.codec_context.bit_rate = 2_000_000
            for picture in pictures:
                container.mux(stream.encode(av.VideoFrame.from_ndarray(picture, format="rgb24")))
            container.mux(stream.encode())
        return path

    return make


@pytest.fixture
def octopi(tmp_path: Path, make_clip: MakeClip) -> Path:
    """Octopi-1: five clips of three parts in one folder."""
    root = tmp_path / "octopi"
    for index, name in enumerate(("egg_0", "egg_1", "rice_0", "rice_spatula_base_0", "apple_0")):
        make_clip(root / f"{name}.mov", seed=index)
    return root


LABELS = """\
part_id,object,part,name,hardness_0_10,roughness_0_10,hardness_class,adjectives,split_octopi1
physiclear_egg,an egg,,an egg,7.67,1.33,hard,smooth|hard,train
rice,a scoop of rice,,a scoop of rice,2.33,6.67,,grainy|fine,train
rice_spatula_base,a rice spatula,scoop,the head of a rice spatula,9.33,,,,test
"""


@pytest.fixture
def labels(tmp_path: Path) -> Path:
    path = tmp_path / "labels.csv"
    path.write_text(LABELS)
    return path


def write_sample(folder: Path, numbers: list[int], document: Mapping[str, object]) -> None:
    (folder / "tactile").mkdir(parents=True)
    frames = gel_frames(max(numbers) + 1)
    for number in numbers:
        name = folder / "tactile" / f"{number:010d}.jpg"
        cv2.imwrite(str(name), cv2.cvtColor(frames[number], cv2.COLOR_RGB2BGR))
    (folder / "data.json").write_text(json.dumps(document))


@pytest.fixture
def samples(tmp_path: Path) -> Path:
    """Octopi-1.5, processed: two samples of an object, one of a set without labels."""
    root = tmp_path / "samples"
    about = {
        "object_id": "physiclear_egg",
        "object": "an egg",
        "properties": {"hardness": 7.67, "roughness": 1.33},
        "tactile_format": "video",
        "exploratory_procedure": "Pressing",
        "tactile_path": "data/physiclear/Pressing/egg_3.mov",
        "split": "train",
    }
    write_sample(root / "physiclear_0", [4, 5, 6, 11, 12], about)
    dotted = {**about, "exploratory_procedure": "Sliding", "split": "val"}
    write_sample(root / "physicleardotted_0", [1, 2, 3], dotted)
    write_sample(
        root / "hardness_7",
        [0, 1, 2, 3],
        {
            "object_id": "hardness_ball_soft",
            "tactile_path": "x/a/ball_soft_2.mp4",
            "split": "train",
        },
    )
    return root


@pytest.fixture
def raw_tree(tmp_path: Path, make_clip: MakeClip) -> Path:
    """Octopi-1.5, raw: all four data sets."""
    root = tmp_path / "raw"
    make_clip(root / "physiclear" / "Pressing" / "egg_0.mov")
    make_clip(root / "physiclear" / "Sliding" / "egg_0.mov", seed=1)
    make_clip(root / "physicleardotted" / "Rolling" / "egg_0.mov", seed=2)
    make_clip(root / "hardness" / "basic" / "ball_soft_x_4.mp4", seed=3)
    trial = root / "objectfolder" / "12" / "tactile_data" / "3" / "0" / "gelsight"
    backup = root / "objectfolder" / "12" / "tactile_data" / "backup" / "0" / "gelsight"
    for folder in (trial, backup):
        folder.mkdir(parents=True)
        for index, frame in enumerate(gel_frames(12)):
            cv2.imwrite(str(folder / f"{index}.png"), cv2.cvtColor(frame, cv2.COLOR_RGB2BGR))
    return root


Converted = tuple[ConversionReport, Dataset]


@pytest.fixture
def run(tmp_path: Path) -> Callable[..., Converted]:
    """Convert in this process, and open what came of it."""

    def run(source: Path, from_format: str, *, to: str = "out", **options: object) -> Converted:
        chosen = ConvertOptions(**{"workers": 1, "durable": False, **options})  # type: ignore[arg-type]  # whatever the test says
        report = convert(source, tmp_path / to, from_format=from_format, options=chosen)
        return report, open_dataset(tmp_path / to)

    return run
