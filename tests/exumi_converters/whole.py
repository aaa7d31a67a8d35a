"""Episodes that have a bit of everything: what exporters are tried on."""

import uuid
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

import numpy as np

from exumi_data import EpisodeWriter
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    ArrayImages,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    Device,
    Embodiment,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Gap,
    Label,
    LossyStep,
    QualityNote,
    RawData,
    Segment,
    Sensor,
    Source,
    Task,
)
from exumi_data.store import jpeg

NS = 1_000_000_000
HEIGHT, WIDTH = 48, 64


@dataclass(frozen=True, kw_only=True)
class Made:
    """What an episode is made from."""

    number: int = 0
    seconds: float = 1.0
    tactile: int = 1  # how many fingers
    lossless_camera: bool = False
    low_dimensional: bool = True  # wrench and taxels too
    audio: bool = True


def metadata_of(made: Made) -> EpisodeMetadata:
    return EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_URL, f"whole-{made.number}")),
        start="2026-03-01T10:20:30.5Z",
        task=Task(name="open the jar", instruction=f"open jar {made.number}"),
        regime="demonstration",
        success=True,
        operator="op-3",
        site="lab",
        device=Device(name="exumi", serial="7"),
        embodiment=Embodiment(name="umi-gripper", max_width_m=0.09),
        annotations=Annotations(
            object_id="jar",
            object="a jar",
            part_id="jar_lid",
            trial=made.number,
            procedure="twist",
            pad_type="plain",
            labels=[Label(property="hardness", value=8.0, scale=[0, 10], provenance="human")],
            segments=[Segment(name="grasp", start_ns=0, end_ns=NS // 2)],
        ),
        calibration={
            "T_controller_tcp": CalibrationItem(
                value=[0.0, 0.08, 0.1, 0.0, 0.0, 0.0, 1.0], method="measured", uncertainty=0.001
            )
        },
        licence="CC-BY-4.0",
        quality=[QualityNote(code="short", message="a short one", severity="info")],
        source=Source(
            type="simulated",
            tool="tests",
            tool_version="1",
            lossy=[LossyStep(step="jpeg-encode", stream="rgb", detail="quality 95")],
        ),
    )


def write_episode(path: Path, made: Made | None = None) -> Path:
    """Write one episode: 30 Hz images, 90 Hz poses, 200 Hz widths with a gap, 100 Hz taxels."""
    made = made or Made()
    rng = np.random.default_rng(made.number)
    path.parent.mkdir(parents=True, exist_ok=True)
    with EpisodeWriter(path, metadata_of(made), durable=False) as writer:
        fingers: tuple[Literal["left", "right"], ...] = ("left", "right")
        for finger in fingers[: made.tactile]:
            name = "tactile" if made.tactile == 1 else f"tactile_{finger}"
            _add_tactile(writer, name, finger, made, rng)
        _add_camera(writer, made, rng)
        _add_motion(writer, made, rng)
        if made.low_dimensional:
            _add_forces(writer, made, rng)
        if made.audio:
            _add_audio(writer, made, rng)
    return path


def _times(made: Made, rate: float, offset_ns: int = 0) -> np.ndarray:
    return np.round(np.arange(int(made.seconds * rate)) * NS / rate).astype(np.int64) + offset_ns


def _clock(**fields: Any) -> Clock:
    return Clock(source="hub_monotonic", stamp_point="kernel_rx", **fields)


def _picture(rng: np.random.Generator, index: int) -> np.ndarray:
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    base = np.stack([90 + x, 100 + y, 140 - x // 2], axis=-1) + rng.integers(0, 3)
    base[10:20, (index * 2) % WIDTH : (index * 2) % WIDTH + 8] += 50
    return base.clip(0, 255).astype(np.uint8)


def _add_tactile(
    writer: EpisodeWriter,
    name: str,
    side: Literal["left", "right"],
    made: Made,
    rng: np.random.Generator,
) -> None:
    stream = writer.add_stream(
        name,
        kind="tactile",
        clock=_clock(raw_time="time_host", latency_ns=4_000_000, latency_sigma_ns=300_000),
        images=EncodedImages(
            encoding="encoded", media_type="image/jpeg", height=HEIGHT, width=WIDTH, channels=3
        ),
        sensor=Sensor(model="gelsight-mini", serial="g1", side=side),
        nominal_rate="30/1",
        mm_per_px=[0.0634, 0.0634],
    )
    time = _times(made, 30.0, 1_000_000)
    for index, stamp in enumerate(time):
        stream.append(
            int(stamp),
            jpeg.encode(_picture(rng, index), 95),
            time_host=int(stamp) + 4_000_000,
            sequence=index,
        )
    stream.set_reference(_picture(rng, 0), method="captured", contact_free=True)
    writer.add_derived(
        name,
        "activity",
        np.linspace(0, 0.01, len(time)).astype(np.float32),
        algorithm="exumi-activity/1",
        parameters={"threshold": 5.83, "size": 224, "active_above": 1e-3},
        inputs=[f"streams/{name}/data", f"streams/{name}/reference"],
    )


def _add_camera(writer: EpisodeWriter, made: Made, rng: np.random.Generator) -> None:
    time = _times(made, 30.0)
    if made.lossless_camera:
        pixels = writer.add_stream(
            "rgb",
            kind="rgb",
            clock=_clock(),
            images=ArrayImages(encoding="array", height=HEIGHT, width=WIDTH, channels=3),
        )
        pixels.append(time, np.stack([_picture(rng, index) for index in range(len(time))]))
        return
    stream = writer.add_stream(
        "rgb",
        kind="rgb",
        clock=_clock(),
        images=EncodedImages(
            encoding="encoded", media_type="image/jpeg", height=HEIGHT, width=WIDTH, channels=3
        ),
        sensor=Sensor(model="gopro-hero12"),
        nominal_rate="30/1",
    )
    stream.append(time, [jpeg.encode(_picture(rng, index), 95) for index in range(len(time))])


def _add_motion(writer: EpisodeWriter, made: Made, rng: np.random.Generator) -> None:
    time = _times(made, 90.0, 2_000_000)
    turn = np.linspace(0, 0.5, len(time))
    poses = np.zeros((len(time), 7))
    poses[:, :3] = np.cumsum(rng.normal(0, 1e-3, (len(time), 3)), axis=0)
    poses[:, 5], poses[:, 6] = np.sin(turn / 2), np.cos(turn / 2)
    pose = writer.add_stream(
        "pose",
        kind="pose",
        clock=_clock(),
        frames=Frames(parent="world", child="tcp"),
        raw=RawData(unit="m", reference_frame="quest_world", transform="T_controller_tcp"),
        nominal_rate="90/1",
    )
    raw = poses.copy()
    raw[:, 1] -= 0.08
    pose.append(time, poses, raw=raw)
    ticks = np.delete(_times(made, 200.0), range(10, 16))
    width = writer.add_stream(
        "width",
        kind="width",
        clock=_clock(),
        raw=RawData(unit="count", transform="encoder_map", modulus=4096),
        gaps=[Gap(after=9, lost=6, reason="a full queue")],
        lost={"queue": 6},
    )
    opening = (0.04 + 0.03 * np.sin(ticks / NS * 3)).astype(np.float32)
    flags = np.zeros(len(ticks), np.uint32)
    flags[3] = 1
    width.append(ticks, opening, raw=(opening * 40_000).astype(np.uint16), flags=flags)
    writer.metadata.calibration["encoder_map"] = CalibrationItem(
        value={"counts": [0, 4000], "widths_m": [0.0, 0.1]}, unit="m"
    )


def _add_forces(writer: EpisodeWriter, made: Made, rng: np.random.Generator) -> None:
    time = _times(made, 100.0, 500_000)
    force = writer.add_stream("force", kind="wrench", clock=_clock(), components=["fx", "fy", "fz"])
    force.append(time, rng.normal(0, 1, (len(time), 3)))
    taxels = writer.add_stream(
        "taxels",
        kind="taxels",
        clock=_clock(),
        grid=[11, 6],
        unit="adc",
        sign=-1,
        offset=3500.0,
        sensor=Sensor(model="tac-02", side="left"),
    )
    taxels.append(time, rng.integers(0, 3500, (len(time), 11, 6)).astype(np.int16))
    valid = np.ones((11, 6), bool)
    valid[0, 0] = valid[0, 5] = False
    taxels.set_valid(valid)


def _add_audio(writer: EpisodeWriter, made: Made, rng: np.random.Generator) -> None:
    blocks = _times(made, 10.0)
    audio = writer.add_stream("mic", kind="audio", clock=_clock(), rate="8000/1", channels=1)
    audio.append(blocks, [rng.integers(-99, 99, (800, 1)).astype(np.int16) for _ in blocks])


def write_dataset(root: Path, episodes: int = 2, **made: object) -> Path:
    """Write a dataset of such episodes, with its catalog."""
    create_dataset(root, DatasetMetadata(name=root.name, licence="CC-BY-4.0"))
    for number in range(episodes):
        told = Made(number=number, **made)  # type: ignore[arg-type]  # fields of Made
        write_episode(root / episode_path(metadata_of(told).id), told)
    write_catalog(root, build_catalog(root)[0])
    return root
