"""A simulated play session written as a dataset: one episode a grasp.

Nothing is measured here, and the episodes say so: their source is ``simulated``, their clocks are
stamped ``simulated``. Everything else is as a recorder would write it: stamps on the hub's clock
with the latency known and taken out, the encoder's counts beside the width, reference images
captured without contact, activity and salient frames derived.
"""

import uuid
from collections.abc import Callable
from dataclasses import asdict, dataclass
from functools import lru_cache, partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from exumi_data._version import __version__
from exumi_data.catalog import build_catalog, episode_path, write_catalog
from exumi_data.dataset import DATASET_DOCUMENT, Dataset, create_dataset, open_dataset
from exumi_data.demo.tactile_measure import TactileMeasure
from exumi_data.engine import map_items
from exumi_data.errors import UsageError
from exumi_data.model import (
    Annotations,
    CalibrationItem,
    Clock,
    DatasetMetadata,
    Device,
    Embodiment,
    EncodedImages,
    EpisodeMetadata,
    Frames,
    Gap,
    LossyStep,
    MadeBy,
    RawData,
    Segment,
    Sensor,
    Source,
    Task,
)
from exumi_data.model.calibration import INTRINSICS
from exumi_data.model.documents import parse_dataset
from exumi_data.store import jpeg
from exumi_data.store.episode_writer import EpisodeWriter

if TYPE_CHECKING:
    from exumi_data.simulation import Grasp, PlaySession, SimulatedStream, WidthEncoder

__all__ = [
    "DATASET_NAME",
    "DemoSettings",
    "clear_earlier",
    "dataset_metadata",
    "make_session",
    "write_play_dataset",
]

DATASET_NAME = "exumi-demo"
LICENCE = "CC0-1.0"

_TOOL = "exumi demo"
_DESCRIPTION = (
    "A simulated play session with known truth: a hand-held gripper with two tactile fingertips "
    "picks up, turns, lets slide and puts down objects."
)
# Wider than the simulated gripper opens, and below what an uncertain zero makes of closed.
_MAPPED_M = (-0.002, 0.1)
# Ids of simulated episodes: UUIDv5 in this namespace.
_NAMESPACE = uuid.UUID("5d0f7c9e-3b0e-5a57-9c8f-2f1f8e0f6f0a")


@dataclass(frozen=True, slots=True)
class DemoSettings:
    """What the demonstration's dataset is made from: the same settings give the same dataset.

    Attributes
    ----------
    seed : int
        Chooses everything that is left to chance.
    seconds : float
        Length of the play session, about one grasp in 5 s.
    quality : int
        JPEG quality of tactile and camera frames.
    taps : int
        How often the fingers close on an object and open again before they pick it up.
    frame_width : int
        Of tactile and camera frames, pixels; they are three quarters as high.
    """

    seed: int = 7
    seconds: float = 20.0
    quality: int = 95
    taps: int = 0
    frame_width: int = 320


@lru_cache(maxsize=1)  # one process writes several grasps of one session
def make_session(seed: int, seconds: float, taps: int = 0, frame_width: int = 320) -> "PlaySession":
    """Return the simulated play session.

    Parameters
    ----------
    seed : int
    seconds : float
    taps, frame_width : int
        As of `DemoSettings`.

    Raises
    ------
    UsageError
        An argument is out of its range.
    """
    from exumi_data.simulation import simulate_play

    size = (3 * frame_width // 4, frame_width)
    try:
        return simulate_play(
            seed=seed, duration_s=seconds, tactile_size=size, rgb_size=size, taps=taps
        )
    except ValueError as error:
        raise UsageError(str(error).rstrip(".")) from None


def _session(settings: DemoSettings) -> "PlaySession":
    return make_session(settings.seed, settings.seconds, settings.taps, settings.frame_width)


def write_play_dataset(
    root: Path,
    settings: DemoSettings,
    *,
    workers: int | None = None,
    on_done: Callable[[int, int], None] | None = None,
) -> Dataset:
    """Simulate a play session and write it as a dataset, one episode a grasp.

    Parameters
    ----------
    root : pathlib.Path
        Folder of the dataset; an earlier demonstration there is replaced.
    settings : DemoSettings
    workers : int, optional
        Processes; default all cores.
    on_done : callable, optional
        Called after each episode with the number of episodes done and of all, for progress.

    Returns
    -------
    Dataset

    Raises
    ------
    UsageError
        `root` holds something else, or a setting is out of its range.
    """
    grasps = range(len(_session(settings).grasps))
    clear_earlier(root)
    create_dataset(root, dataset_metadata(settings, direct=True))
    function = partial(_write_grasp, root=root, settings=settings)
    for done, outcome in enumerate(map_items(function, grasps, workers=workers), start=1):
        if outcome.error is not None:
            raise outcome.error
        if on_done is not None:
            on_done(done, len(grasps))
    table, failed = build_catalog(root)
    if failed and failed[0].error is not None:
        raise failed[0].error
    write_catalog(root, table)
    return open_dataset(root)


def dataset_metadata(settings: DemoSettings, *, direct: bool) -> DatasetMetadata:
    """Return what the demonstration's dataset says about itself.

    Parameters
    ----------
    settings : DemoSettings
    direct : bool
        The episodes are written straight from the simulation, without recording.
    """
    return DatasetMetadata(
        name=DATASET_NAME,
        description=_DESCRIPTION,
        licence=LICENCE,
        made_by=MadeBy(
            tool=_TOOL,
            tool_version=__version__,
            command=_command(settings, direct=direct),
            settings={**asdict(settings), "direct": direct},
        ),
    )


def _command(settings: DemoSettings, *, direct: bool) -> str | None:
    """Return the command that makes this dataset; None where only Python can."""
    if settings != DemoSettings(seed=settings.seed, seconds=settings.seconds):
        return None
    option = " --direct" if direct else ""
    return f"exumi demo{option} --seed {settings.seed} --seconds {settings.seconds:g}"


def clear_earlier(root: Path) -> bool:
    """Remove an earlier demonstration, or a training set made of one; touch nothing else.

    Parameters
    ----------
    root : pathlib.Path
        Of a dataset.

    Returns
    -------
    bool
        Whether there was one.

    Raises
    ------
    UsageError
        The folder holds something else.
    """
    import shutil

    document = root / DATASET_DOCUMENT
    if not document.is_file():
        return False
    metadata = parse_dataset(document.read_bytes(), document)
    made_by = metadata.made_by
    is_ours = made_by is not None and made_by.tool == _TOOL
    if not is_ours and metadata.description != _DESCRIPTION:
        raise UsageError(
            "holds a dataset that the demonstration did not make",
            where=root,
            fix="Name another folder with --out.",
        )
    shutil.rmtree(root)
    return True


def episode_id(settings: DemoSettings, grasp: int) -> str:
    """Return the id of a grasp's episode: the same for the same settings."""
    key = f"exumi-demo/1 {settings.seed} {settings.seconds!r} {settings.quality} {grasp}"
    plain = DemoSettings()
    if (settings.taps, settings.frame_width) != (plain.taps, plain.frame_width):
        key += f" {settings.taps} {settings.frame_width}"
    return str(uuid.uuid5(_NAMESPACE, key))


def _write_grasp(number: int, *, root: Path, settings: DemoSettings) -> str:
    session = _session(settings)
    metadata = _episode_metadata(session, number, settings)
    path = root / episode_path(metadata.id)
    with EpisodeWriter(path, metadata, durable=False) as writer:
        for stream in session.streams.values():
            _write_stream(writer, session, stream, session.grasps[number], settings)
    return metadata.id


def _episode_metadata(
    session: "PlaySession", number: int, settings: DemoSettings
) -> EpisodeMetadata:
    lossy = [
        LossyStep(
            step="jpeg-encode",
            stream=stream.name,
            detail=f"drawn frames encoded as JPEG, quality {settings.quality}, chroma 4:2:0",
            parameters={"quality": settings.quality, "subsampling": "4:2:0"},
        )
        for stream in session.streams.values()
        if stream.is_image
    ]
    return EpisodeMetadata(
        id=episode_id(settings, number),
        task=Task(
            name="tabletop-play",
            instruction="Pick up what lies on the table, feel it, and put it down again.",
        ),
        regime="play",
        device=Device(name="simulated hand-held gripper"),
        embodiment=Embodiment(name="simulated parallel gripper", gripper="parallel"),
        calibration=_calibration(session),
        annotations=_annotations(session, number),
        licence=LICENCE,
        source=Source(
            type="simulated",
            tool="exumi-data",
            tool_version=__version__,
            key=f"grasp {number}",
            settings=asdict(settings),
            lossy=lossy,
        ),
    )


def _calibration(session: "PlaySession") -> dict[str, CalibrationItem]:
    known = "known: it is the simulator's own"
    encoder = session.encoder
    return {
        "width_encoder": CalibrationItem(
            value={
                "zero_count": encoder.zero_count,
                "counts_per_m": encoder.counts_per_m,
                "bits": encoder.bits,
                "raw_to_data": _encoder_map(encoder),
            },
            method=known,
        ),
        f"{INTRINSICS}rgb": CalibrationItem(value=_intrinsics(session), unit="px", method=known),
        "T_gripper_rgb": CalibrationItem(
            value=session.gripper_camera.tolist(), unit="m", method=known
        ),
    }


def _encoder_map(encoder: "WidthEncoder") -> dict[str, list[float]]:
    """Return two points of the line from counts to widths; counts go on over the wrap."""
    counts = [round(width_m * encoder.counts_per_m) for width_m in _MAPPED_M]
    return {
        "raw": [encoder.zero_count + count for count in counts],
        "data": [count / encoder.counts_per_m for count in counts],
    }


def _intrinsics(session: "PlaySession") -> dict[str, Any]:
    height, width = session.streams["rgb"].render(0).shape[:2]
    (fx, skew, cx), (_, fy, cy), _ = session.camera_matrix.tolist()
    size = {"width": width, "height": height}
    return {"model": "pinhole", **size, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew}


def _annotations(session: "PlaySession", number: int) -> Annotations:
    grasp = session.grasps[number]
    earlier = session.grasps[:number]
    edges = (
        ("reach", grasp.t_start_s, grasp.t_contact_s),
        ("contact", grasp.t_contact_s, grasp.t_release_s),
        ("retreat", grasp.t_release_s, grasp.t_end_s),
    )
    origin = _origin_ns(grasp)
    return Annotations(
        object_id=grasp.object_name,
        object=grasp.object_name,
        trial=sum(other.object_index == grasp.object_index for other in earlier),
        procedure="grasp",
        pad_type="dotted" if session.dotted else "plain",
        segments=[
            Segment(
                name=name,
                start_ns=round(start * 1e9) - origin,
                end_ns=round(end * 1e9) - origin,
            )
            for name, start, end in edges
        ],
    )


def _origin_ns(grasp: "Grasp") -> int:
    """Return the session's time that is the episode's time 0."""
    return round(grasp.t_start_s * 1e9)


def _write_stream(
    writer: EpisodeWriter,
    session: "PlaySession",
    stream: "SimulatedStream",
    grasp: "Grasp",
    settings: DemoSettings,
) -> None:
    capture_ns = stream.capture_time_ns
    inside = (capture_ns >= round(grasp.t_start_s * 1e9)) & (
        capture_ns < round(grasp.t_end_s * 1e9)
    )
    chosen = np.flatnonzero(inside)
    sequence = stream.sequence[chosen]
    out = writer.add_stream(
        stream.name,
        kind=stream.kind,
        clock=_clock(stream, grasp),
        nominal_rate=str(round(stream.rate_hz)),
        gaps=_gaps(sequence),
        **_fields(session, stream),
    )
    beside: dict[str, Any] = {
        "time_host": stream.time_ns[chosen],
        "sequence": sequence.astype(np.uint64),
    }
    time = capture_ns[chosen] - _origin_ns(grasp)
    if stream.data is not None:
        raw = {} if stream.raw is None else {"raw": stream.raw[chosen]}
        out.append(time, stream.data[chosen], **raw, **beside)
        return
    measure = TactileMeasure(stream.reference) if stream.reference is not None else None
    for position, index in enumerate(chosen):
        file = jpeg.encode(stream.render(int(index)), settings.quality)
        out.append(
            int(time[position]),
            file,
            **{key: int(values[position]) for key, values in beside.items()},
        )
        if measure is not None:
            measure.add(file)
    if measure is not None:
        out.set_reference(stream.reference, method="captured", contact_free=True)
        measure.write(writer, stream.name)


def _clock(stream: "SimulatedStream", grasp: "Grasp") -> Clock:
    """Return the clock: stamps count from the session's start, the latency is known."""
    return Clock(
        source="session",
        stamp_point="simulated",
        offset_ns=-_origin_ns(grasp),
        latency_ns=stream.latency_ns,
        latency_sigma_ns=0.0,
        raw_time="time_host",
        method="known: the simulator delays every sample by this much",
    )


def _gaps(sequence: npt.NDArray[np.int64]) -> list[Gap] | None:
    lost = np.diff(sequence) - 1
    gaps = [Gap(after=int(i), lost=int(lost[i])) for i in np.flatnonzero(lost)]
    return gaps or None


def _fields(session: "PlaySession", stream: "SimulatedStream") -> dict[str, Any]:
    """Return what the stream's kind asks for."""
    if stream.kind == "pose":
        return {
            "frames": Frames(parent="world", child="gripper"),
            "sensor": Sensor(model="simulated-tracker"),
        }
    if stream.kind == "width":
        encoder = session.encoder
        return {
            "raw": RawData(unit="count", transform="width_encoder", modulus=1 << encoder.bits),
            "sensor": Sensor(model="simulated-encoder"),
        }
    height, width, channels = stream.render(0).shape
    images = EncodedImages(
        encoding="encoded",
        media_type="image/jpeg",
        height=height,
        width=width,
        channels=3 if channels == 3 else 1,
    )
    if stream.kind == "rgb":
        return {"images": images, "sensor": Sensor(model="simulated-wrist-camera")}
    scale = session.tactile_m_per_px * 1e3
    return {
        "images": images,
        "mm_per_px": [scale, scale],
        "sensor": Sensor(
            model="simulated-gel", side="left" if stream.name == "tactile_left" else "right"
        ),
    }
