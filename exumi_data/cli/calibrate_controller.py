"""``exumi calibrate controller``."""

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from exumi_data.cli.calibrate_options import (
    MarkerCameraOption,
    MarkerDictionary,
    MarkerId,
    MarkerSize,
    OutOption,
    PoseOption,
    RigOption,
    asked,
    check_out,
    finish,
    marker_settings,
    numbers,
    refusing,
)
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

if TYPE_CHECKING:
    from collections.abc import Sequence

    from exumi_data.clips.markers import MarkerSettings
    from exumi_data.model.description import CalibrationItem

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate controller --rig rig.toml --in-jig --out rig.json",
    "exumi calibrate controller pivot.zarr --out rig.json",
    "exumi calibrate controller pivot.zarr --jig jig.zarr --out rig.json",
    "exumi calibrate controller views.zarr --hand-eye --out rig.json",
    "exumi calibrate controller --chain chain.json --out rig.json",
)

_GAP_NS = 50_000_000
# Of the length of a quaternion that somebody types.
_UNIT = 0.01


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
    rig: RigOption = None,
    in_jig: Annotated[
        bool, typer.Option("--in-jig", help="With --rig: then the tool at rest in a jig, too.")
    ] = False,
    jig: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="EPISODE",
            help="The tool at rest in a jig, in a known orientation.",
        ),
    ] = None,
    tool: Annotated[
        str | None,
        typer.Option(help="That orientation in the world: qx,qy,qz,qw. Default: 0,0,0,1."),
    ] = None,
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
    camera: MarkerCameraOption = None,
    marker: MarkerId = 4,
    marker_mm: MarkerSize = 60.0,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    output: FormatOption = Format.TEXT,
) -> None:
    """Find where the tool, or the camera, is on the hand.

    With --rig you are led through it: the tip held in a dent while the hand turns, then perhaps a
    jig. What does not tell is said at once, and done again.
    """
    from exumi_data.errors import UsageError
    from exumi_recorders.calibration.files import Calibration

    if sum(given is not None for given in (recording, rig, chain)) != 1:
        raise UsageError("one of an episode, --rig and --chain", fix="Give the one that you have.")
    if rig is not None and (hand_eye or jig is not None):
        raise UsageError(
            "--rig goes with neither --hand-eye nor --jig",
            fix="Say --in-jig for a jig; record views of a marker for --hand-eye.",
        )
    if in_jig and rig is None:
        raise UsageError("--in-jig is for --rig", fix="Name a recording of the jig: --jig.")
    if jig is not None and (hand_eye or chain is not None):
        raise UsageError("--jig goes with a tip that is held at a point", fix="Leave it out.")
    if tool is not None and jig is None and not in_jig:
        raise UsageError("--tool goes with --jig or --in-jig", fix="Add it, or leave --tool out.")
    check_out(out)
    settings = marker_settings(dictionary, marker, marker_mm)
    orientation = _orientation(tool or "0,0,0,1")
    with refusing(output):
        if rig is not None:
            name, item = _guided(rig, pose, orientation if in_jig else None)
        elif chain is not None:
            name, item = _chained(chain)
        elif hand_eye and recording is not None:
            name, item = _seen(recording, out, pose, camera, settings)
        else:
            assert recording is not None  # noqa: S101  # one of the three was given
            name, item = _turned(recording, jig, orientation, pose)
    finish(Calibration({name: item}), out, output, [recording, jig, chain])


def _orientation(text: str) -> "Sequence[float]":
    from exumi_data.errors import UsageError

    quaternion = numbers(text, count=4, option="--tool")
    if abs(math.hypot(*quaternion) - 1.0) > _UNIT:
        raise UsageError(f"--tool is {text!r}", fix="Give a quaternion of length 1: qx,qy,qz,qw.")
    return quaternion


def _chained(path: Path) -> "tuple[str, CalibrationItem]":
    from exumi_data.errors import SourceError
    from exumi_data.model.documents import load_json
    from exumi_recorders.calibration.controller import chain_item

    try:
        return chain_item(load_json(path.read_bytes(), path))
    except (OSError, ValueError) as error:
        raise SourceError(str(error), where=path) from None


def _guided(
    rig: str, pose: str | None, orientation: "Sequence[float] | None"
) -> "tuple[str, CalibrationItem]":
    import sys

    from exumi_recorders.calibration.controller import CONTROLLER_TCP, tcp_item
    from exumi_recorders.calibration.guided import LivePoses, guided_jig, guided_tip, poses_of
    from exumi_recorders.calibration.live import live_rig

    def tell(text: str) -> None:
        print(text, file=sys.stderr, flush=True)

    with live_rig(rig) as started, poses_of(started, pose).opened() as port:
        poses = LivePoses(port)
        tip = guided_tip(poses, asked, tell)
        stands = None if orientation is None else guided_jig(poses, orientation, asked, tell)
    return CONTROLLER_TCP, tcp_item(tip, stands)


def _turned(
    recording: Path, jig: Path | None, orientation: "Sequence[float]", pose: str | None
) -> "tuple[str, CalibrationItem]":
    from exumi_data.episode import open_episode
    from exumi_recorders.calibration.controller import CONTROLLER_TCP, aligned, pivot, tcp_item
    from exumi_recorders.calibration.recordings import pose_track, stream_of

    with open_episode(recording) as episode:
        tip = pivot(pose_track(stream_of(episode, "pose", pose)).poses)
    stands = None
    if jig is not None:
        with open_episode(jig) as episode:
            stands = aligned(pose_track(stream_of(episode, "pose", pose)).poses, orientation)
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
        pose_track,
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
        good = pose_track(poses)
        late_ns = poses.metadata.clock.latency_ns
        hand, valid = interpolate_poses(good.time_ns - late_ns, good.poses, at, _GAP_NS)
        frames = getattr(poses.metadata, "frames", None)
    found = hand_eye(pose_to_matrix(hand[valid]), np.asarray(views[valid]))
    child = "hand" if frames is None else frames.child
    return f"T_{child}_{shown.name}", hand_eye_item(found)
