"""Which file of a session is what: by names alone."""

import os
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from exumi_converters.source_folder import source_files

__all__ = ["SIDES", "Chunk", "SessionFiles", "find_sessions", "holds_session", "looks_like_session"]

SIDES = ("left", "right")

_HUB = re.compile(r"tactile_\d{8}_\d{6}")
_CHUNK = re.compile(r"(left|right|angle)_(\d{1,9})\.(mp4|json)")
_ASKED = 1000  # folders among which one of sessions is recognised
_VIDEO = (".mp4", ".mov")
_RAW, _DEMOS, _LATENCY = "raw_videos", "demos", "latency_calibration"
_DEMO = re.compile(r"demo_(?P<serial>.+)_\d{4}\.\d\d\.\d\d_.*")
# What exUMI's pipeline makes of a session: interpolated, while what was recorded lies beside it.
_MADE = (
    "aligned_arcap_poses.json",
    "tactile_left.mp4",
    "tactile_right.mp4",
    "latency_of_arcap.json",
)


@dataclass(frozen=True, slots=True)
class Chunk:
    """What the hub saved in one go of one kind.

    Attributes
    ----------
    order : tuple of (str, int)
        The hub's folder and the number: chunks were saved in this order.
    table : pathlib.Path
        The JSON file.
    video : pathlib.Path or None
        Of a finger.
    """

    order: tuple[str, int]
    table: Path
    video: Path | None = None


@dataclass(slots=True)
class SessionFiles:
    """The files of a session.

    Attributes
    ----------
    root : pathlib.Path
    chunks : dict of str to list of Chunk
        By ``left``, ``right`` and ``angle``, in order.
    clips, latency_clips : list of pathlib.Path
    gripper, intrinsics : list of pathlib.Path
        Calibration files that lie in the session.
    pickles, made, foreign : list of pathlib.Path
        What is not read: pickles, products of exUMI's pipeline, and everything else.
    alone : list of pathlib.Path
        Videos and stamps of a finger without the other.
    """

    root: Path
    chunks: dict[str, list[Chunk]] = field(
        default_factory=lambda: {"angle": [], **{side: [] for side in SIDES}}
    )
    clips: list[Path] = field(default_factory=list)
    latency_clips: list[Path] = field(default_factory=list)
    gripper: list[Path] = field(default_factory=list)
    intrinsics: list[Path] = field(default_factory=list)
    pickles: list[Path] = field(default_factory=list)
    made: list[Path] = field(default_factory=list)
    foreign: list[Path] = field(default_factory=list)
    alone: list[Path] = field(default_factory=list)

    def camera_of(self, clip: Path) -> str | None:
        """Return the camera's serial number, where exUMI's pipeline named the folder by it."""
        match = _DEMO.fullmatch(Path(os.path.realpath(clip)).parent.name)
        return None if match is None else match["serial"]


def looks_like_session(folder: Path) -> str | None:
    """Say by what a folder is recognised as a session; None if it is none."""
    try:
        with os.scandir(folder) as entries:
            names = sorted(entry.name for entry in entries if entry.is_dir())
    except OSError:
        return None
    hubs = [name for name in names if _HUB.fullmatch(name)]
    if not hubs:
        return None
    videos = [name for name in (_RAW, _DEMOS, _LATENCY) if name in names]
    return f"{hubs[0]}/" + (f" beside {videos[0]}/" if videos else "")


def holds_session(source: Path) -> str | None:
    """Say by what a folder is recognised as a session, or as one of sessions; None if it is none.

    Parameters
    ----------
    source : pathlib.Path
    """
    reason = looks_like_session(source)
    if reason is not None:
        return f"a session: {reason}"
    try:
        with os.scandir(source) as entries:
            names = sorted(entry.name for entry in entries if entry.is_dir())
    except OSError:
        return None
    found = next((name for name in names[:_ASKED] if looks_like_session(source / name)), None)
    return None if found is None else f"a folder of sessions, such as {found}"


def find_sessions(source: Path) -> list[SessionFiles]:
    """Return the sessions at or below a folder, each with its files.

    Parameters
    ----------
    source : pathlib.Path
    """
    if looks_like_session(source):
        return [_sorted_files(source, list(source_files(source)))]
    roots: dict[Path, list[Path]] = {}
    known: dict[Path, bool] = {}
    for path in source_files(source):
        for folder in path.relative_to(source).parents:
            root = source / folder
            if root not in known:
                known[root] = looks_like_session(root) is not None
            if known[root]:
                roots.setdefault(root, []).append(path)
                break
    return [_sorted_files(root, files) for root, files in sorted(roots.items())]


def _sorted_files(root: Path, paths: Sequence[Path]) -> SessionFiles:
    found = SessionFiles(root)
    tables: dict[tuple[str, str, int], dict[str, Path]] = {}
    for path in paths:
        parts = path.relative_to(root).parts
        name, lower = parts[-1], parts[-1].lower()
        chunk = _CHUNK.fullmatch(name)
        if len(parts) == 2 and _HUB.fullmatch(parts[0]) and chunk is not None:
            key = (chunk[1], parts[0], int(chunk[2]))
            known = tables.setdefault(key, {})
            # left_3.json and left_03.json are two files with one number.
            if chunk[3] in known:
                found.foreign.append(path)
            else:
                known[chunk[3]] = path
        elif lower.endswith((".pkl", ".pickle", ".npy", ".npz", ".pt")):
            found.pickles.append(path)
        elif name in _MADE:
            found.made.append(path)
        elif lower.endswith(".json") and lower.startswith("gripper_calibration"):
            found.gripper.append(path)
        elif lower.endswith(".json") and lower.startswith("gopro_intrinsics"):
            found.intrinsics.append(path)
        elif lower.endswith(_VIDEO) and parts[0] == _LATENCY:
            found.latency_clips.append(path)
        elif lower.endswith(_VIDEO) and parts[0] in (_RAW, _DEMOS) and _is_demonstration(parts):
            found.clips.append(path)
        else:
            found.foreign.append(path)
    for kind, hub, number in sorted(tables):
        _take_chunk(found, kind, (hub, number), tables[kind, hub, number])
    found.clips = list(_each_once(found.clips, root))
    return found


def _take_chunk(
    found: SessionFiles, kind: str, order: tuple[str, int], files: dict[str, Path]
) -> None:
    table, video = files.get("json"), files.get("mp4")
    if table is not None and (kind == "angle" or video is not None):
        found.chunks[kind].append(Chunk(order, table, None if kind == "angle" else video))
        if kind == "angle" and video is not None:
            found.foreign.append(video)
    else:
        found.alone += [path for path in (table, video) if path is not None]


def _is_demonstration(parts: tuple[str, ...]) -> bool:
    """Whether exUMI's pipeline takes a video for a demonstration: not one for mapping."""
    if parts[0] == _DEMOS:
        return _DEMO.fullmatch(parts[1]) is not None and parts[-1] == "raw_video.mp4"
    return not any(part.startswith(("mapping", "gripper_cal")) for part in parts[1:])


def _each_once(clips: Sequence[Path], root: Path) -> Iterator[Path]:
    """Yield clips, and not again what the pipeline's links in ``raw_videos`` lead to."""
    raw = [clip for clip in clips if clip.relative_to(root).parts[0] == _RAW]
    seen = {os.path.realpath(clip) for clip in raw}
    yield from raw
    for clip in clips:
        if clip not in raw and os.path.realpath(clip) not in seen:
            yield clip
