"""``exumi calibrate controller``."""

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import (
    MarkerDictionary,
    MarkerId,
    MarkerSize,
    OutOption,
    PoseOption,
    finish,
    marker_settings,
    numbers,
)
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_data.clips.markers import MarkerSettings
    from exumi_data.model.description import CalibrationItem

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate controller pivot.zarr --out rig.json",
    "exumi calibrate controller pivot.zarr --jig jig.zarr --out rig.json",
    "exumi calibrate controller views.zarr --hand-eye --out rig.json",
    "exumi calibrate controller --chain chain.json --out rig.json",
)

_GAP_NS = 50_000_000


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    out: OutOption,
    recording: Annotated[
        Path | None,
        typer.Argument(
            parser=given_path,
            metavar="[EPISODE]",
            help="The tip held at one point while the hand turns; or, with --hand-eye, views of a "
            "marker that stands still.",
        ),
    ] = None,
    jig: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="EPISODE",
            help="The tool at rest in a jig, in a known orientation.",
        ),
    ] = None,
    tool: Annotated[
        str, typer.Option(help="That orientation in the world: qx,qy,qz,qw.")
    ] = "0,0,0,1",
    hand_eye: Annotated[
        bool, typer.Option("--hand-eye", help="Find where the camera sits, not the tip.")
    ] = False,
    chain: Annotated[
        Path | None,
        typer.Option(
            parser=given_path, metavar="JSON", help="Published transforms, to be multiplied."
        ),
    ] = None,
    pose: PoseOption = None,
    camera: Annotated[
        str | None,
        typer.Option("--camera", help="Stream that shows the marker. Default: the only camera."),
    ] = None,
    marker: MarkerId = 4,
    marker_mm: MarkerSize = 60.0,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    output: FormatOption = Format.TEXT,
) -> None:
    """Find where the tool, or the camera, is on the hand."""
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.files import Calibration

    if (recording is None) == (chain is None):
        raise UsageError("one of an episode and --chain", fix="Give the one that you have.")
    if chain is not None:
        name, item = _chained(chain)
    elif hand_eye and recording is not None:
        settings = marker_settings(dictionary, marker, marker_mm)
        name, item = _seen(recording, out, pose, camera, settings)
    else:
        assert recording is not None  # noqa: S101  # one of the two was given
        name, item = _turned(recording, jig, tool, pose)
    finish(Calibration({name: item}), out, output)


def _chained(path: Path) -> "tuple[str, CalibrationItem]":
    from exumi_data.errors import SourceError
    from exumi_data.model.documents import load_json
    from exumi_recorders.calibration.controller import chain_item

    try:
        return chain_item(load_json(path.read_bytes(), path))
    except (OSError, ValueError) as error:
        raise SourceError(str(error), where=path) from None


def _turned(
    recording: Path, jig: Path | None, tool: str, pose: str | None
) -> "tuple[str, CalibrationItem]":
    from exumi_data.episode import open_episode
    from exumi_recorders.calibration.controller import CONTROLLER_TCP, aligned, pivot, tcp_item
    from exumi_recorders.calibration.recordings import pose_track, stream_of

    quaternion = numbers(tool, count=4, option="--tool")
    with open_episode(recording) as episode:
        tip = pivot(pose_track(stream_of(episode, "pose", pose)).poses)
    stands = None
    if jig is not None:
        with open_episode(jig) as episode:
            stands = aligned(pose_track(stream_of(episode, "pose", pose)).poses, quaternion)
    return CONTROLLER_TCP, tcp_item(tip, stands)


def _seen(
    recording: Path,
    out: Path,
    pose: str | None,
    camera: str | None,
    settings: "MarkerSettings",
) -> "tuple[str, CalibrationItem]":
    import numpy as np

    from exumi_data.calibration_items import CalibrationRefusedError
    from exumi_data.clips.markers import track_marker
    from exumi_data.episode import open_episode
    from exumi_data.geometry import interpolate_poses, pose_to_matrix
    from exumi_recorders.calibration.controller import hand_eye, hand_eye_item
    from exumi_recorders.calibration.files import read_calibration
    from exumi_recorders.calibration.recordings import (
        camera_times,
        frames_of,
        intrinsics_for,
        stream_of,
    )

    calibration = read_calibration(out) if out.exists() else None
    with open_episode(recording) as episode:
        poses, shown = stream_of(episode, "pose", pose), stream_of(episode, "rgb", camera)
        seen = intrinsics_for(episode, shown, calibration)
        time_ns, timing = camera_times(shown)
        track, views = track_marker(frames_of(shown, time_ns), seen, settings)
        if not len(track.time_ns):
            raise CalibrationRefusedError("the marker was found in no frame", where=recording)
        # Times of the poses are those that the latency has been taken out of.
        at = timing.event_ns(track.time_ns, track.row)
        hand, valid = interpolate_poses(poses.time, poses.data, at, _GAP_NS)
        frames = getattr(poses.metadata, "frames", None)
    found = hand_eye(pose_to_matrix(hand[valid]), np.asarray(views[valid]))
    child = "hand" if frames is None else frames.child
    return f"T_{child}_{shown.name}", hand_eye_item(found)
