"""Episodes of the task: demonstrations by one who knows the truth, and play without a goal."""

import uuid
from collections.abc import Iterator
from pathlib import Path
from typing import Any, Literal

import numpy as np

import exumi_data
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import create_dataset
from exumi_data.model import (
    Annotations,
    Clock,
    DatasetMetadata,
    Device,
    Embodiment,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    LossyStep,
    Sensor,
    Source,
    Task,
)
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.tactile import (
    ACTIVE_THRESHOLD,
    ACTIVITY_METHOD,
    SALIENCE_METHOD,
    ActivityMeter,
    difference_energy,
    salient_frames,
    to_grey,
)
from touch_policy.world import (
    ABOVE_M,
    BIN_M,
    PERIOD_MS,
    SIDE,
    STEP_MS,
    TARGET_M,
    Senses,
    World,
    make_ball,
    make_senses,
)

__all__ = ["demonstrate", "start", "write_demonstrations", "write_play"]

_NAMESPACE = uuid.UUID("0f3b0f0e-6a55-5b8e-9a53-1c1f9a2f7c11")
_SALIENT = 10
_SQUEEZES = 8

Regime = Literal["demonstration", "play"]
Target = tuple[np.ndarray, float]


def start(rng: np.random.Generator, *, play: bool = False) -> World:
    """Draw a ball and a gripper that is open around it."""
    ball = make_ball(rng, play=play)
    return World(ball, 0.032 + float(rng.uniform(-0.001, 0.003)))


def write_demonstrations(root: Path, count: int, seed: int) -> exumi_data.Dataset:
    """Write demonstrations of the task: each succeeds.

    Parameters
    ----------
    root : Path
        A new dataset.
    count, seed : int
    """
    return _write(root, "demonstration", count, seed)


def write_play(root: Path, count: int, seed: int) -> exumi_data.Dataset:
    """Write episodes in which balls are squeezed and let go: for encoders, without a goal."""
    return _write(root, "play", count, seed)


def demonstrate(world: World, rng: np.random.Generator) -> Iterator[Target]:
    """Yield targets until the ball is in its bin: go down, close, wait, lift, carry."""
    seconds = STEP_MS / 1e3
    top, width = world.place.copy(), world.width_m
    ball = top - np.array([0, 0, ABOVE_M])
    side = top.copy()
    side[0] = BIN_M if world.ball.is_hard else -BIN_M
    yield from _move(top, ball, 0.8, width)
    closing = 0.005 * float(rng.uniform(0.8, 1.2)) * seconds
    wanted = TARGET_M * float(rng.uniform(0.95, 1.05))
    while world.depth_m < wanted:
        width -= closing
        yield ball, width
    yield from _move(ball, ball, 0.2, width)
    yield from _move(ball, top, 0.5, width)
    yield from _move(top, side, 0.8, width)


def _move(begin: np.ndarray, end: np.ndarray, lasts_s: float, width: float) -> Iterator[Target]:
    for share in _shares(lasts_s):
        yield begin + (end - begin) * share, width


def _shares(lasts_s: float) -> np.ndarray:
    return np.linspace(0, 1, max(1, round(lasts_s * 1e3 / STEP_MS)) + 1)[1:]


def _play(world: World, rng: np.random.Generator) -> Iterator[Target]:
    """Yield targets that go down, and squeeze the ball by one depth after the other."""
    place, width = world.place - np.array([0, 0, ABOVE_M]), world.width_m
    yield from _move(world.place.copy(), place, 0.4, width)
    for _ in range(_SQUEEZES):
        wanted = world.ball.width_m(float(rng.uniform(0.1, 1.5)) * TARGET_M)
        speed = float(rng.uniform(0.004, 0.008))
        for share in _shares(abs(wanted - width) / speed):
            smooth = float(share * share * (3 - 2 * share))  # as a hand that begins and ends slowly
            yield place, width + (wanted - width) * smooth
        width = wanted
        yield from _move(place, place, 0.1, width)


def _write(root: Path, regime: Regime, count: int, seed: int) -> exumi_data.Dataset:
    made_with = {"count": count, "seed": seed}
    create_dataset(
        root,
        DatasetMetadata(
            name=f"sorting-{regime}",
            description="Simulated: a gripper that feels balls, and sorts them by hardness.",
            licence="CC0-1.0",
        ),
    )
    senses = make_senses()
    for number in range(count):
        key = f"{regime} {seed} {number}"
        rng = np.random.default_rng([seed, number, regime == "play"])
        world = start(rng, play=regime == "play")
        targets = _play(world, rng) if regime == "play" else demonstrate(world, rng)
        metadata = _metadata(world, regime, key, made_with)
        with EpisodeWriter(root / episode_path(metadata.id), metadata, durable=False) as writer:
            _record(writer, senses, world, targets)
    table, failed = build_catalog(root, workers=1)
    if failed:
        raise RuntimeError(f"{len(failed)} episodes were not written")
    write_catalog(root, table)
    dataset = exumi_data.open(root)
    assert isinstance(dataset, exumi_data.Dataset)  # noqa: S101  # as it was just made
    return dataset


def _metadata(world: World, regime: Regime, key: str, made_with: dict[str, Any]) -> EpisodeMetadata:
    return EpisodeMetadata(
        id=str(uuid.uuid5(_NAMESPACE, key)),
        task=Task(name="sorting", instruction="Grip the ball, and sort it by its hardness."),
        regime=regime,
        device=Device(name="simulated gripper"),
        embodiment=Embodiment(name="simulated parallel gripper", gripper="parallel"),
        annotations=Annotations(
            object="ball", object_id="hard-ball" if world.ball.is_hard else "soft-ball"
        ),
        licence="CC0-1.0",
        source=Source(
            type="simulated",
            tool="train_policy",
            tool_version="1",
            key=key,
            settings=made_with,
            lossy=[
                LossyStep(step="jpeg-encode", stream=name, detail="drawn frames encoded as JPEG")
                for name in SIDE
            ],
        ),
    )


def _record(writer: EpisodeWriter, senses: Senses, world: World, targets: Iterator[Target]) -> None:
    clock = Clock(source="simulation", stamp_point="simulated")
    reference = senses.pad.reference()
    side, camera_side = SIDE["tactile_left"], SIDE["rgb"]
    fields: dict[str, dict[str, Any]] = {
        "rgb": {"images": _images(camera_side), "sensor": Sensor(model="simulated-wrist-camera")},
        "tactile_left": {
            "images": _images(side),
            "mm_per_px": [senses.pad.m_per_px * 1e3] * 2,
            "sensor": Sensor(model="simulated-gel", side="left"),
        },
        "pose": {"frames": Frames(parent="world", child="gripper")},
        "width": {},
    }
    out = {
        name: writer.add_stream(
            name,
            kind=name.partition("_")[0],
            clock=clock,
            nominal_rate=str(1000 // PERIOD_MS[name]),
            **extra,
        )
        for name, extra in fields.items()
    }
    touch = []
    for place, width_m in targets:
        for name, sample in senses.due(world).items():
            time_ns = world.time_ms * 1_000_000
            if isinstance(sample, bytes):
                out[name].append(time_ns, sample)
            else:
                kept = np.float64 if name == "pose" else np.float32
                out[name].append(np.array([time_ns]), np.array([sample], kept))
            if name == "tactile_left":
                touch.append(_grey(sample, side))
        world.step(place, width_m)
    out["tactile_left"].set_reference(reference, method="captured", contact_free=True)
    _derive(writer, touch, to_grey(reference))


def _images(side: int) -> EncodedImages:
    return EncodedImages(
        encoding="encoded", media_type="image/jpeg", height=side, width=side, channels=3
    )


def _grey(file: Any, side: int) -> np.ndarray:
    frame = np.empty((side, side, 1), np.uint8)
    jpeg.decode_into(file, frame)
    return frame[..., 0]


def _derive(writer: EpisodeWriter, frames: list[np.ndarray], reference: np.ndarray) -> None:
    """Add activity and salient frames, as a converter does."""
    meter = ActivityMeter(reference)
    energy = [difference_energy(*pair) for pair in zip(frames[:1] + frames, frames, strict=False)]
    data = "streams/tactile_left/data"
    writer.add_derived(
        "tactile_left",
        "activity",
        np.array([meter.measure(frame) for frame in frames], np.float32),
        algorithm=ACTIVITY_METHOD,
        parameters={
            "threshold": meter.threshold,
            "size": meter.size,
            "active_above": ACTIVE_THRESHOLD,
        },
        inputs=[data, "streams/tactile_left/reference"],
    )
    writer.add_derived(
        "tactile_left",
        "salient",
        salient_frames(energy, _SALIENT),
        algorithm=SALIENCE_METHOD,
        parameters={"k": _SALIENT},
        inputs=[data],
    )
