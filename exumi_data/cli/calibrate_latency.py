"""``exumi calibrate latency``."""

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from exumi_data.cli.calibrate_options import (
    EpisodeArgument,
    MarkerCameraOption,
    MarkerDictionary,
    MarkerId,
    MarkerSize,
    OutOption,
    PoseOption,
    check_out,
    check_stream,
    finish,
    marker_settings,
    range_of,
    refusing,
)
from exumi_data.cli.options import Format, FormatOption, epilog, given_path

if TYPE_CHECKING:
    from exumi_data.clips.markers import MarkerSettings
    from exumi_data.episode import Episode
    from exumi_data.synchronisation.sweep import MarkerTrack, PoseTrack, SweepLimits, SweepResult
    from exumi_data.synchronisation.timing import CameraTiming

__all__ = ["EPILOG", "run"]

EPILOG = epilog(
    "exumi calibrate latency sweep.zarr --out rig.json --plot sweep.png",
    "exumi calibrate latency sweep.zarr --exposure-ms 4 --readout-ms 8,16 --out rig.json",
    "exumi calibrate latency first.zarr --end last.zarr --out rig.json",
    "exumi calibrate latency sweep.zarr --video GX010042.MP4 --video-start 12.3 --out rig.json",
)

_WARNING_S = 5e-3


def run(  # noqa: PLR0913, PLR0917  # options of the command line
    episode: EpisodeArgument,
    out: OutOption,
    end: Annotated[
        Path | None,
        typer.Option(parser=given_path, metavar="EPISODE", help="A sweep at the session's end."),
    ] = None,
    video: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="CLIP",
            help="A video file that shows the sweep, in place of a camera of the episode.",
        ),
    ] = None,
    video_start: Annotated[
        float | None,
        typer.Option(help="Where the clip begins in the episode, seconds. Default: 0."),
    ] = None,
    camera: MarkerCameraOption = None,
    pose: PoseOption = None,
    marker: MarkerId = 4,
    marker_mm: MarkerSize = 60.0,
    dictionary: MarkerDictionary = "DICT_4X4_50",
    exposure_ms: Annotated[
        str | None, typer.Option(help="Of a frame, or lowest,highest. Default: not known, 1,16.")
    ] = None,
    readout_ms: Annotated[
        str | None,
        typer.Option(help="From the first row to the last, likewise. Default: 8,16."),
    ] = None,
    headset_lag_ms: Annotated[
        str | None,
        typer.Option(help="Lag of the poses in use, likewise. Default: 0,20."),
    ] = None,
    max_lag: Annotated[
        float, typer.Option(min=0.05, max=5.0, help="Latencies to try, both ways, seconds.")
    ] = 0.5,
    plot: Annotated[
        Path | None,
        typer.Option(
            parser=given_path,
            metavar="PNG",
            help="Draw both curves as recorded and with the latency that is used.",
        ),
    ] = None,
    output: FormatOption = Format.TEXT,
) -> None:
    """Find the latency of poses from a sweep before an ArUco marker.

    Rest a second, sweep the hand with its camera 12 cm to each side for 12 s at an uneven pace, and
    rest again. Intrinsics are taken from the calibration file, else from the episode. A sweep that
    does not tell is refused, with the reason.
    """
    from exumi_data.calibration_items import LATENCY
    from exumi_data.synchronisation.sweep import SweepLimits, latency_item
    from exumi_recorders.calibration.files import Calibration

    settings = marker_settings(dictionary, marker, marker_mm)
    _check_options(end, video, video_start, camera, plot)
    check_out(out)
    ranges = [
        range_of(exposure_ms, "--exposure-ms"),
        range_of(readout_ms, "--readout-ms"),
        range_of(headset_lag_ms, "--headset-lag-ms"),
    ]
    limits = SweepLimits(max_lag_s=max_lag)
    with refusing(output):
        name, results, apart_s = _estimated(
            [episode, *([end] if end else [])],
            lambda opened: _tracks(opened, out, settings, camera, pose, video, video_start or 0.0),
            ranges,
            limits,
        )
    refused = [result for result in results if result.refusals]
    used_ns = round(1e9 * (refused or results)[0].latency_s)
    item = None
    if not refused:
        item = latency_item(results, apart_s=apart_s)
        used_ns = int(item.value)
    if plot is not None:
        from exumi_data.store.files import write_atomic
        from exumi_recorders.calibration.plot import draw_sweeps, png

        write_atomic(plot, png(draw_sweeps(refused or results, used_ns)))
    sweeps = {"sweeps": [_numbers(result) for result in results]}
    if item is None:
        _refuse(refused, sweeps, output)
    else:
        _warn_of_change(results)
        found = Calibration({LATENCY + name: item})
        finish(found, out, output, [episode, end, video], sweeps)


def _check_options(
    end: Path | None,
    video: Path | None,
    video_start: float | None,
    camera: str | None,
    plot: Path | None,
) -> None:
    from exumi_data.errors import UsageError

    if end is not None and video is not None:
        raise UsageError("--end and --video exclude each other", fix="Calibrate each by itself.")
    if video_start is not None and video is None:
        raise UsageError("--video-start goes with --video", fix="Add it, or leave it out.")
    if video is not None and not video.is_file():
        raise UsageError("no such file", where=video)
    if video is not None and camera is not None:
        check_stream(camera)
    if plot is not None and plot.suffix.lower() != ".png":
        raise UsageError("--plot writes a PNG file", where=plot, fix="Give a name in .png.")


def _estimated(
    paths: list[Path],
    tracks_of: "Callable[[Episode], tuple[str, tuple[MarkerTrack, PoseTrack], CameraTiming]]",
    ranges: list[Any],
    limits: "SweepLimits",
) -> "tuple[str, list[SweepResult], float | None]":
    """Return the pose stream's name, what each sweep says, and how far two are apart, seconds."""
    from exumi_data.episode import open_episode
    from exumi_data.errors import UsageError
    from exumi_data.synchronisation.sweep import estimate_sweep

    results: list[SweepResult] = []
    names, starts, ids = set(), [], set()
    for path in paths:
        with open_episode(path) as opened:
            if opened.id in ids:
                raise UsageError(
                    "is the same sweep as the first", where=path, fix="Sweep again at the end."
                )
            ids.add(opened.id)
            name, tracks, timing = tracks_of(opened)
            timing = _timing(timing, ranges)
            results.append(
                estimate_sweep(*tracks, camera=timing, headset_lag_s=ranges[2], limits=limits)
            )
            names.add(name)
            starts.append(opened.metadata.start)
    if len(names) > 1:
        raise UsageError(f"the sweeps are of different streams: {', '.join(sorted(names))}")
    return names.pop(), results, _apart_s(starts)


def _refuse(
    refused: "list[SweepResult]", sweeps: dict[str, list[dict[str, Any]]], output: Format
) -> None:
    """Say why sweeps are not to be believed, and end."""
    from exumi_data.calibration_items import REFUSED_FIX
    from exumi_data.cli.failures import FOUND_WRONG
    from exumi_data.cli.output import error_console, print_json

    reasons = list(dict.fromkeys(reason for result in refused for reason in result.refusals))
    if output is Format.JSON:
        said = [{"reason": reason, "fix": REFUSED_FIX} for reason in reasons]
        print_json({"file": None, "items": {}, "refused": said, **sweeps})
    console = error_console()
    console.print("[bold red]refused:[/] nothing was written")
    for reason in reasons:
        console.print(f"  {reason}", markup=False)
    raise typer.Exit(FOUND_WRONG)


def _warn_of_change(results: "list[SweepResult]") -> None:
    from exumi_data.cli.output import error_console

    change = abs(results[-1].latency_s - results[0].latency_s)
    if change > _WARNING_S:
        error_console().print(
            f"[yellow]warning:[/] the latency changed by {1e3 * change:.1f} ms in the session"
        )


def _apart_s(starts: list[str | None]) -> float | None:
    from datetime import datetime

    if len(starts) < 2 or starts[0] is None or starts[1] is None:
        return None
    first, last = (datetime.fromisoformat(start[:19] + "+00:00") for start in starts if start)
    return (last - first).total_seconds() or None


def _timing(timing: "CameraTiming", ranges: list[Any]) -> "CameraTiming":
    from dataclasses import replace

    exposure, readout = ranges[:2]
    return replace(
        timing,
        exposure_s=timing.exposure_s if exposure is None else exposure,
        readout_s=timing.readout_s if readout is None else readout,
    )


def _tracks(  # what a user says of a sweep
    episode: "Episode",
    out: Path,
    settings: "MarkerSettings",
    camera: str | None,
    pose: str | None,
    video: Path | None,
    video_start: float,
) -> "tuple[str, tuple[MarkerTrack, PoseTrack], CameraTiming]":
    """Return the pose stream's name, marker and poses, and how the camera's stamps are."""
    from exumi_data.clips.frames import clip_frames
    from exumi_data.clips.markers import track_marker
    from exumi_data.model.calibration import INTRINSICS
    from exumi_data.synchronisation.timing import CameraTiming
    from exumi_recorders.calibration.files import read_calibration
    from exumi_recorders.calibration.recordings import (
        camera_times,
        clip_intrinsics,
        frames_of,
        intrinsics_for,
        pose_track,
        stream_of,
    )

    calibration = read_calibration(out) if out.exists() else None
    poses = stream_of(episode, "pose", pose)
    if video is not None:
        seen = clip_intrinsics(video, calibration, INTRINSICS + (camera or "rgb"))
        frames = clip_frames(video, start_ns=round(1e9 * video_start))
        timing = CameraTiming()
    else:
        shown = stream_of(episode, "rgb", camera)
        seen = intrinsics_for(episode, shown, calibration)
        time_ns, timing = camera_times(shown)
        frames = frames_of(shown, time_ns)
    marker, _ = track_marker(frames, seen, settings)
    return poses.name, (marker, pose_track(poses)), timing


def _numbers(result: "SweepResult") -> dict[str, Any]:
    return {
        "latency_ms": round(1e3 * result.latency_s, 4),
        "sigma_ms": round(1e3 * result.sigma_s, 4),
        "noise_ms": round(1e3 * result.noise_s, 4),
        "exposure_and_readout_ms": round(1e3 * result.camera_s, 4),
        "headset_lag_ms": round(1e3 * result.headset_s, 4),
        "residual_mm": round(1e3 * result.residual_m, 4),
        "frames": result.frames,
        "detected": result.detected,
        "second_best_ms": None if result.runner_up_s is None else 1e3 * result.runner_up_s,
        "second_best_residual": None if result.runner_up_s is None else result.runner_up,
        "halves_ms": None if result.halves_s is None else round(1e3 * result.halves_s, 4),
    }
