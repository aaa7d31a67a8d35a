"""Poses as a path in space, with what moves along: axes, fixed transforms, cameras, the opening."""

from collections.abc import Iterator

import numpy as np
import rerun as rr

from exumi_data.calibration import intrinsics_of
from exumi_data.camera import matrix
from exumi_data.episode import Episode, StreamView
from exumi_data.errors import MetadataError
from exumi_data.model.streams import PoseStream
from exumi_data.standard.registry import flags as registered_flags
from exumi_data.view.curves import QUIET, colour_of
from exumi_data.view.log import Log
from exumi_data.view.panels import Panel

__all__ = ["camera_path", "log_opening", "log_pose", "pose_path"]

_WORLD = "world"
"""The reference frame whose axes the standard fixes: right-handed, z up."""
_AXES_M = 0.05
_PATH_POINTS = 20_000
_BLOCK_ROWS = 1 << 15
_IMAGE_PLANE_M = 0.04


def pose_path(stream: StreamView) -> str:
    """Return the entity that moves with a pose stream: below its parent's reference frame."""
    assert isinstance(stream.metadata, PoseStream)  # noqa: S101  # by its kind
    parent = rr.escape_entity_path_part(stream.metadata.frames.parent)
    return f"/space/{parent}/{stream.name}"


def log_pose(log: Log, episode: Episode, stream: StreamView) -> None:
    """Log a pose stream: the way it goes, and axes that move along it.

    Samples that are flagged as invalid are left out: what moves stays where it was last seen.

    Parameters
    ----------
    log : Log
    episode : Episode
    stream : StreamView
        Of kind ``pose``.
    """
    assert isinstance(stream.metadata, PoseStream)  # noqa: S101  # by its kind
    path, frames = pose_path(stream), stream.metadata.frames
    root = path.rpartition("/")[0]
    if frames.parent == _WORLD:
        log.fixed(root, rr.ViewCoordinates.RIGHT_HAND_Z_UP)
    log.fixed(path, rr.TransformAxes3D(_AXES_M))
    strips: list[list[np.ndarray]] = [[]]
    step = max(1, -(-len(stream) // _PATH_POINTS))
    for rows, poses, good, breaks in _blocks(stream):
        time = stream.time[rows]
        columns = rr.Transform3D.columns(translation=poses[good, :3], quaternion=poses[good, 3:])
        log.rows(path, time[good], columns)
        for offset in np.flatnonzero(good | breaks).tolist():
            if breaks[offset] and strips[-1]:
                strips.append([])
            if good[offset] and ((rows.start + offset) % step == 0 or not strips[-1]):
                strips[-1].append(poses[offset, :3])
        log.on_samples(len(poses))
    lines = [strip for strip in strips if len(strip) > 1]
    if lines:
        colour = colour_of(stream.name) or QUIET
        way = rr.LineStrips3D(lines, colors=[colour] * len(lines), radii=rr.Radius.ui_points(1.0))
        log.fixed(f"{root}/paths/{stream.name}", way)
    _log_fixed_transforms(log, episode, path, frames.child)
    log.place(Panel("space", root, f"Poses in {frames.parent}, m"))


def _blocks(
    stream: StreamView,
) -> Iterator[tuple[slice, np.ndarray, np.ndarray, np.ndarray]]:
    """Yield rows, poses, which of them are valid, and before which of them the way is broken."""
    flags = stream.flags
    mask = {flag.name: np.uint32(flag.mask) for flag in registered_flags().values()}
    after_gap = np.array([gap.after + 1 for gap in stream.metadata.gaps or []], np.int64)
    for start in range(0, len(stream), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(stream))
        poses = stream.rows("data", start, stop).astype(np.float64)
        good = np.isfinite(poses).all(axis=1) & (np.abs(poses[:, 3:]).sum(axis=1) > 0)
        breaks = np.zeros(len(poses), np.bool_)
        inside = after_gap[(after_gap >= start) & (after_gap < stop)]
        breaks[inside - start] = True
        if flags is not None:
            good &= (flags[start:stop] & mask["invalid"]) == 0
            breaks |= (flags[start:stop] & mask["gap_before"]) != 0
        yield slice(start, stop), poses, good, breaks | ~good


def _log_fixed_transforms(log: Log, episode: Episode, path: str, child: str) -> None:
    """Log the calibrated transforms that hang on a pose's child, such as ``T_controller_tcp``."""
    for name, transform in _fixed_transforms(episode, child).items():
        entity = f"{path}/{rr.escape_entity_path_part(name)}"
        log.fixed(entity, rr.Transform3D(translation=transform[:3, 3], mat3x3=transform[:3, :3]))
        if name not in episode.streams:  # a camera is drawn as one
            log.fixed(entity, rr.TransformAxes3D(_AXES_M / 2))


def _fixed_transforms(episode: Episode, child: str) -> dict[str, np.ndarray]:
    found = {}
    prefix = f"T_{child}_"
    for name, item in episode.metadata.calibration.items():
        if name.startswith(prefix):
            try:
                transform = np.array(item.value, np.float64)
            except (TypeError, ValueError):
                continue
            if transform.shape == (4, 4) and np.isfinite(transform).all():
                found[name.removeprefix(prefix)] = transform
    return found


def camera_path(log: Log, episode: Episode, stream: StreamView) -> str | None:
    """Return the entity of a camera that moves with a pose; logs how it sees.

    Parameters
    ----------
    log : Log
    episode : Episode
    stream : StreamView
        With frames.

    Returns
    -------
    str or None
        None where it is not known how the camera sits on what moves, or how it sees.
    """
    try:
        camera = intrinsics_of(episode, stream.name)
    except MetadataError:
        return None  # a rule of its own finds this
    if camera is None or camera.model != "pinhole":
        return None
    for pose in episode.of_kind("pose"):
        assert isinstance(pose.metadata, PoseStream)  # noqa: S101  # by its kind
        if stream.name in _fixed_transforms(episode, pose.metadata.frames.child):
            path = f"{pose_path(pose)}/{rr.escape_entity_path_part(stream.name)}"
            sees = matrix(camera)
            sees[:2, 2] += 0.5  # Rerun counts from the edge of the first pixel, not its centre
            log.fixed(
                path,
                rr.Pinhole(
                    image_from_camera=sees,
                    resolution=[camera.width, camera.height],
                    image_plane_distance=_IMAGE_PLANE_M,
                ),
            )
            return path
    return None


def log_opening(log: Log, episode: Episode, pose: StreamView, width: StreamView) -> None:
    """Log how far a gripper is open: a sphere as wide as its opening, which needs no axis.

    Parameters
    ----------
    log : Log
    episode : Episode
    pose, width : StreamView
        Of one gripper.
    """
    assert isinstance(pose.metadata, PoseStream)  # noqa: S101  # by its kind
    path = pose_path(pose)
    if "tcp" in _fixed_transforms(episode, pose.metadata.frames.child):
        path = f"{path}/tcp"
    entity = f"{path}/opening"
    colour = colour_of(width.name) or QUIET
    log.fixed(entity, rr.Ellipsoids3D.from_fields(colors=[colour], line_radii=[0.0003]))
    for start in range(0, len(width), _BLOCK_ROWS):
        stop = min(start + _BLOCK_ROWS, len(width))
        radius = width.rows("data", start, stop).astype(np.float64).clip(0.0, None) / 2
        sizes = np.repeat(radius[:, None], 3, axis=1)
        log.rows(entity, width.time[start:stop], rr.Ellipsoids3D.columns(half_sizes=sizes))
