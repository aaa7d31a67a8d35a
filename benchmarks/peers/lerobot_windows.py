"""Windows per second of LeRobotDataset 0.4.4, on frames that our own benchmark prepared.

Run this with the Python of an environment made by ``install_lerobot.sh``, not with the project's:
it imports nothing of the project. The input folder::

    meta.json                                  {"fps": 25, "episodes": [{"id": "a", "n": 126}]}
    frames/<episode>/tactile/<NNNNNN>.jpg      from 000000, grey or RGB, one size throughout
    frames/<episode>/rgb/<NNNNNN>.jpg          the same number of RGB frames
    lowdim/<episode>.npz                       pose (n, 7) and width (n,), one row a frame

It is written once as a LeRobotDataset v3 (with LeRobot's own defaults, so as AV1 video), opened
again, checked against the source frames, and read in random order in one process on one core.

It is read twice, because the C library's allocator decides half of the result: a window is 5 MB of
float32, which glibc by default gives back to the system and faults in again (some 2,500 page faults
a window), unless something big was freed earlier in the process. ``windows_per_s`` is the better of
the two, so that no ratio against it profits from that; both are in the result.
"""

from __future__ import annotations

import argparse
import ctypes
import hashlib
import importlib
import json
import multiprocessing
import os
import shutil
import statistics
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Any

__all__ = [
    "PeerError",
    "Source",
    "Speed",
    "build",
    "check_windows",
    "dataset_folder",
    "main",
    "measure",
    "open_windows",
    "read_source",
    "window_indices",
]

TACTILE = "observation.images.tactile"
RGB = "observation.images.rgb"
STATE = "observation.state"

TACTILE_STEPS = (-12, -8, -4, 0, 4, 8, 12, 16)
STATE_STEPS = tuple(range(-15, 17))

# AV1 at LeRobot's crf 30 is about 1 to 3 grey levels off on gel images. Beyond this it is not the
# picture that was asked for, and a speed measured on it would mean nothing.
MAX_MEAN_ERROR_LEVELS = 8.0

# <malloc.h>: parameters of mallopt. 32 MiB is the highest mmap threshold that it accepts for sure.
M_TRIM_THRESHOLD = -1
M_MMAP_THRESHOLD = -3
MMAP_THRESHOLD_BYTES = 32 * 2**20
TRIM_THRESHOLD_BYTES = 2**30

PACKAGES = ("lerobot", "torch", "torchvision", "torchcodec", "av", "datasets", "pyarrow", "numpy")

NOTE = (
    "LeRobotDataset v3 with its own defaults (AV1 yuv420p, a key frame every 2 frames, crf 30), "
    "frames out as float32 CHW in [0, 1], decoders kept open between windows. LeRobot video has "
    "3 channels: grey tactile frames are stored and returned as RGB. It has one rate a dataset: "
    "pose and width are one row a frame, not at their own rates."
)


class PeerError(Exception):
    """The input, the options or the environment do not allow the measurement."""


@dataclass(frozen=True)
class Source:
    """A prepared input folder.

    Attributes
    ----------
    root : Path
        The folder.
    fps : int
        Frame rate in Hz; LeRobot knows whole numbers only.
    episodes : tuple of (str, int)
        Name and number of frames of each episode.
    """

    root: Path
    fps: int
    episodes: tuple[tuple[str, int], ...]

    def frame(self, episode: str, stream: str, index: int) -> Path:
        """Path of frame ``index`` of a stream."""
        return self.root / "frames" / episode / stream / f"{index:06d}.jpg"


@dataclass(frozen=True)
class Speed:
    """One repeat of the measurement.

    Attributes
    ----------
    wall_s, cpu_s : float
        Time of the wall clock and processor time of the process, in seconds.
    windows : int
        Windows read in that time.
    """

    wall_s: float
    cpu_s: float
    windows: int

    @property
    def per_s(self) -> float:
        """Windows a second of the wall clock."""
        return self.windows / self.wall_s

    @property
    def per_cpu_s(self) -> float:
        """Windows a second of processor time: hardly moved by other jobs on the same core."""
        return self.windows / self.cpu_s


def read_source(root: Path) -> Source:
    """Read ``meta.json`` of an input folder.

    Raises
    ------
    PeerError
        If it is missing, malformed, or its rate is not a whole number.
    """
    path = root / "meta.json"
    try:
        meta = json.loads(path.read_text(encoding="utf-8"))
        fps = float(meta["fps"])
        episodes = tuple((str(item["id"]), int(item["n"])) for item in meta["episodes"])
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise PeerError(
            f'{path}: cannot be read as {{"fps", "episodes": [{{"id", "n"}}]}}: {error!r}'
        ) from error
    if not fps.is_integer() or fps <= 0:
        raise PeerError(f"{path}: fps is {fps}; LeRobot stores whole numbers above 0 only.")
    if not episodes:
        raise PeerError(f"{path}: no episodes. Prepare at least one.")
    return Source(root, int(fps), episodes)


def source_digest(source: Source) -> str:
    """Sixteen hex digits that change when the input's list, names or sizes of files change."""
    digest = hashlib.sha256((source.root / "meta.json").read_bytes())
    for folder in ("frames", "lowdim"):
        for path in sorted((source.root / folder).rglob("*.*")):
            digest.update(f"{path.relative_to(source.root)} {path.stat().st_size}\n".encode())
    return digest.hexdigest()[:16]


def dataset_folder(work: Path, source: Source, tactile: str) -> Path:
    """Folder below ``work`` that belongs to this input, kind of tactile frame and LeRobot."""
    return work / f"lerobot-{metadata.version('lerobot')}-{tactile}-{source_digest(source)}"


def read_image(path: Path, mode: str) -> Any:
    """Read one JPEG as (H, W, 3) uint8, grey repeated three times.

    Parameters
    ----------
    path : Path
        The file.
    mode : str
        What the file has to be: ``L`` (grey) or ``RGB``.

    Raises
    ------
    PeerError
        If it is missing or not of that mode.
    """
    image_module: Any = importlib.import_module("PIL.Image")
    numpy: Any = importlib.import_module("numpy")
    try:
        with image_module.open(path) as image:
            if image.mode != mode:
                raise PeerError(f"{path}: image mode is {image.mode}, not {mode}. See --tactile.")
            return numpy.asarray(image.convert("RGB"))
    except OSError as error:
        raise PeerError(f"{path}: cannot be read as an image: {error}") from error


def read_state(source: Source, episode: str, n: int) -> Any:
    """Read pose and width of an episode as (n, 8) float32.

    Raises
    ------
    PeerError
        If the file is missing, or the shapes are not (n, 7) and (n,).
    """
    numpy: Any = importlib.import_module("numpy")
    path = source.root / "lowdim" / f"{episode}.npz"
    try:
        with numpy.load(path, allow_pickle=False) as arrays:
            pose, width = arrays["pose"], arrays["width"]
    except (OSError, ValueError, KeyError) as error:
        raise PeerError(f"{path}: cannot be read as pose and width: {error}") from error
    if pose.shape != (n, 7) or width.shape != (n,):
        raise PeerError(
            f"{path}: pose {pose.shape} and width {width.shape}, expected ({n}, 7) and ({n},)."
        )
    return numpy.concatenate([pose, width[:, None]], axis=1).astype(numpy.float32)


def tactile_mode(tactile: str) -> str:
    """Image mode of the tactile files: ``L`` for ``grey``, ``RGB`` for ``rgb``."""
    return {"grey": "L", "rgb": "RGB"}[tactile]


def features(source: Source, tactile: str) -> dict[str, Any]:
    """LeRobot's description of the streams, with the sizes of the first frames."""
    episode = source.episodes[0][0]
    streams = ((TACTILE, "tactile", tactile_mode(tactile)), (RGB, "rgb", "RGB"))
    described: dict[str, Any] = {
        key: {
            "dtype": "video",
            "shape": read_image(source.frame(episode, stream, 0), mode).shape,
            "names": ["height", "width", "channels"],
        }
        for key, stream, mode in streams
    }
    names = ["x", "y", "z", "qx", "qy", "qz", "qw", "width"]
    described[STATE] = {"dtype": "float32", "shape": (8,), "names": names}
    return described


def write_dataset(source: Source, tactile: str, root: Path) -> None:
    """Write the input as a LeRobotDataset, with LeRobot's defaults for video."""
    lerobot: Any = importlib.import_module("lerobot.datasets.lerobot_dataset")
    av: Any = importlib.import_module("av")
    av.logging.set_libav_level(av.logging.ERROR)
    dataset = lerobot.LeRobotDataset.create(
        repo_id="local/windows",
        fps=source.fps,
        features=features(source, tactile),
        root=root,
        # The same video as by way of PNG files, in a third of the time; but a full queue drops
        # frames, so it has to have room for a whole episode.
        streaming_encoding=True,
        encoder_queue_maxsize=max(n for _, n in source.episodes) + 1,
    )
    mode = tactile_mode(tactile)
    for episode, n in source.episodes:
        state = read_state(source, episode, n)
        for index in range(n):
            frame = {
                TACTILE: read_image(source.frame(episode, "tactile", index), mode),
                RGB: read_image(source.frame(episode, "rgb", index), "RGB"),
                STATE: state[index],
                "task": "touch",
            }
            dataset.add_frame(frame)
        dataset.save_episode()
    dataset.finalize()


def build(source: Source, tactile: str, folder: Path) -> tuple[Path, float]:
    """Write the dataset below ``folder``, in a process of its own, unless a finished one is there.

    In a process of its own, so that the one that measures is the same whether it was built or not.

    Returns
    -------
    root : Path
        The LeRobotDataset.
    build_s : float
        How long writing it took, in seconds, whenever that was.
    """
    root, marker = folder / "dataset", folder / "built.json"
    if not marker.exists():
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir(parents=True)
        start = time.monotonic()
        spawn = multiprocessing.get_context("spawn")
        with ProcessPoolExecutor(max_workers=1, mp_context=spawn) as pool:
            pool.submit(write_dataset, source, tactile, root).result()
        marker.write_text(json.dumps({"build_s": time.monotonic() - start}), encoding="utf-8")
    return root, float(json.loads(marker.read_text(encoding="utf-8"))["build_s"])


def open_windows(source: Source, root: Path, backend: str) -> Any:
    """Open the dataset so that an item is a window: 8 tactile frames, 1 RGB frame, 32 states."""
    lerobot: Any = importlib.import_module("lerobot.datasets.lerobot_dataset")
    return lerobot.LeRobotDataset(
        "local/windows",
        root=root,
        delta_timestamps={
            TACTILE: [step / source.fps for step in TACTILE_STEPS],
            RGB: [0.0],
            STATE: [step / source.fps for step in STATE_STEPS],
        },
        video_backend=backend,
    )


def window_indices(source: Source) -> list[int]:
    """Dataset indices whose whole window lies inside its episode, so that nothing is padded."""
    before = -min(TACTILE_STEPS + STATE_STEPS)
    after = max(TACTILE_STEPS + STATE_STEPS)
    found: list[int] = []
    first = 0
    for _, n in source.episodes:
        found.extend(range(first + before, first + n - after))
        first += n
    if not found:
        raise PeerError(
            f"{source.root}: every episode is shorter than a window ({before + after + 1} frames)."
        )
    return found


def draw(candidates: Sequence[int], count: int, seed: int) -> list[int]:
    """Draw ``count`` indices at random, without repetition where there are enough."""
    numpy: Any = importlib.import_module("numpy")
    drawn = numpy.random.default_rng(seed).choice(
        candidates, size=count, replace=count > len(candidates)
    )
    return [int(index) for index in drawn]


def check_windows(
    dataset: Any, source: Source, tactile: str, indices: Sequence[int]
) -> dict[str, float]:
    """Compare windows with the frames and rows that they were made from.

    Returns
    -------
    dict of str to float
        Mean absolute error of the tactile and RGB frames, in grey levels (0 to 255), and largest
        absolute error of the states.

    Raises
    ------
    PeerError
        If a window has another shape, or holds other pictures or states than were asked for.
    """
    numpy: Any = importlib.import_module("numpy")
    tactile_error: list[float] = []
    rgb_error: list[float] = []
    state_error: list[float] = []
    for index in indices:
        item = dataset[index]
        episode, n = source.episodes[int(item["episode_index"])]
        at = int(item["frame_index"])
        frames = item[TACTILE].numpy()
        if frames.shape[:2] != (len(TACTILE_STEPS), 3):
            raise PeerError(f"Window {index}: tactile has shape {frames.shape}.")
        for got, step in zip(frames, TACTILE_STEPS, strict=True):
            path = source.frame(episode, "tactile", at + step)
            tactile_error.append(_levels(got, read_image(path, tactile_mode(tactile))))
        expected = read_image(source.frame(episode, "rgb", at), "RGB")
        rgb_error.append(_levels(item[RGB].numpy(), expected))
        rows = read_state(source, episode, n)[at + STATE_STEPS[0] : at + STATE_STEPS[-1] + 1]
        state_error.append(float(numpy.abs(item[STATE].numpy() - rows).max()))
    found = {
        "tactile_mean_error_levels": statistics.fmean(tactile_error),
        "rgb_mean_error_levels": statistics.fmean(rgb_error),
        "state_max_error": max(state_error),
    }
    worst = max(tactile_error + rgb_error)
    if worst > MAX_MEAN_ERROR_LEVELS or found["state_max_error"] > 0.0:
        raise PeerError(f"Windows differ from their source (worst frame {worst:.1f}): {found}")
    return found


def _levels(got: Any, expected: Any) -> float:
    """Mean absolute difference of (3, H, W) float in [0, 1] from (H, W, 3) uint8, in levels."""
    return float(abs(got.transpose(1, 2, 0) * 255.0 - expected).mean())


def measure(dataset: Any, indices: Sequence[int]) -> Speed:
    """Read the windows at ``indices`` in that order and time it."""
    cpu_start = time.process_time()
    start = time.monotonic()
    for index in indices:
        dataset[index]
    return Speed(time.monotonic() - start, time.process_time() - cpu_start, len(indices))


def keep_freed_memory() -> bool:
    """Tell the C library to keep freed memory for the next allocation; False if it cannot be."""
    mallopt = getattr(ctypes.CDLL(None), "mallopt", None)
    if mallopt is None:
        return False
    trim = mallopt(M_TRIM_THRESHOLD, TRIM_THRESHOLD_BYTES)
    return bool(trim and mallopt(M_MMAP_THRESHOLD, MMAP_THRESHOLD_BYTES))


def measure_all(
    dataset: Any, candidates: Sequence[int], arguments: argparse.Namespace
) -> dict[str, list[Speed]]:
    """Warm up and measure with the allocator as it is, then with one that keeps freed memory.

    Returns
    -------
    dict of str to list of Speed
        The repeats by allocator: ``default``, and ``kept`` where the C library can do that.
    """

    def repeats() -> list[Speed]:
        measure(dataset, draw(candidates, arguments.warmup, arguments.seed + 1))
        seeds = range(arguments.seed + 2, arguments.seed + 2 + arguments.repeats)
        return [measure(dataset, draw(candidates, arguments.windows, seed)) for seed in seeds]

    found = {"default": repeats()}
    if keep_freed_memory():
        found["kept"] = repeats()
    return found


def summary(speeds: dict[str, list[Speed]]) -> dict[str, Any]:
    """Medians and all repeats; the headline is that of the faster allocator."""
    medians = {
        name: statistics.median(speed.per_s for speed in repeats)
        for name, repeats in speeds.items()
    }
    best = max(medians, key=lambda name: medians[name])
    return {
        "windows_per_s": medians[best],
        "windows_per_s_all": [speed.per_s for speed in speeds[best]],
        "windows_per_cpu_s": statistics.median(speed.per_cpu_s for speed in speeds[best]),
        "allocator": best,
        "by_allocator": {
            name: {
                "windows_per_s": medians[name],
                "windows_per_s_all": [speed.per_s for speed in repeats],
                "windows_per_cpu_s_all": [speed.per_cpu_s for speed in repeats],
            }
            for name, repeats in speeds.items()
        },
    }


def video_bytes(root: Path, key: str) -> int:
    """Bytes of all video files of a stream."""
    return sum(path.stat().st_size for path in (root / "videos" / key).rglob("*.mp4"))


def pin_to_one_core() -> int:
    """Pin this process to one of its cores and torch to one thread; return the core."""
    torch: Any = importlib.import_module("torch")
    torch.set_num_threads(1)
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return core


def set_quiet_and_offline(work: Path) -> None:
    """Keep the libraries off the network and out of the home folder, and the encoder silent.

    To be called before any of them is imported: they read their environment once.
    """
    os.environ["HF_HUB_OFFLINE"] = "1"
    os.environ["HF_HOME"] = str(work / "huggingface")
    os.environ["HF_LEROBOT_HOME"] = str(work / "huggingface" / "lerobot")
    os.environ["SVT_LOG"] = "1"


def parse(argv: Sequence[str] | None) -> argparse.Namespace:
    """Read the command line."""
    parser = argparse.ArgumentParser(description="Windows per second of LeRobotDataset 0.4.4.")
    parser.add_argument("--input", type=Path, required=True, help="the prepared folder")
    parser.add_argument("--work", type=Path, required=True, help="where the dataset is kept")
    parser.add_argument("--windows", type=int, default=400, help="windows read in one repeat")
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--warmup", type=int, default=50, help="windows read before the first")
    parser.add_argument("--seed", type=int, default=0, help="of the random order")
    parser.add_argument("--tactile", choices=("grey", "rgb"), default="grey")
    parser.add_argument("--backend", choices=("torchcodec", "pyav"), default="torchcodec")
    parser.add_argument("--json", type=Path, help="also write the result to this file")
    arguments = parser.parse_args(argv)
    for name, least in (("windows", 1), ("repeats", 1), ("warmup", 1)):
        if getattr(arguments, name) < least:
            parser.error(f"--{name} must be at least {least}")
    return arguments


def run(arguments: argparse.Namespace) -> dict[str, Any]:
    """Build, check and measure; return the result as it is printed."""
    set_quiet_and_offline(arguments.work.resolve())
    used = versions()
    source = read_source(arguments.input)
    folder = dataset_folder(arguments.work, source, arguments.tactile)
    root, build_s = build(source, arguments.tactile, folder)

    load_before = os.getloadavg()[0]
    core = pin_to_one_core()
    dataset = open_windows(source, root, arguments.backend)
    candidates = window_indices(source)
    checked = check_windows(dataset, source, arguments.tactile, draw(candidates, 8, arguments.seed))
    speeds = measure_all(dataset, candidates, arguments)
    frames = sum(n for _, n in source.episodes)
    return {
        "peer": "LeRobotDataset",
        "version": metadata.version("lerobot"),
        "versions": used,
        "backend": arguments.backend,
        "tactile": arguments.tactile,
        **summary(speeds),
        "windows": arguments.windows,
        "bytes_per_frame": video_bytes(root, TACTILE) / frames,
        "bytes_per_frame_rgb": video_bytes(root, RGB) / frames,
        "episodes": len(source.episodes),
        "frames": frames,
        "build_s": build_s,
        "check": checked,
        "core": core,
        "load_average": [load_before, os.getloadavg()[0]],
        "note": NOTE,
    }


def versions() -> dict[str, str]:
    """Versions of Python, FFmpeg as torchcodec found it, and the packages that matter.

    Raises
    ------
    PeerError
        If torchcodec finds no FFmpeg that it can load.
    """
    try:
        torchcodec: Any = importlib.import_module("torchcodec")
    except RuntimeError as error:
        raise PeerError(
            "torchcodec cannot be loaded. Install FFmpeg 4 to 8 with shared libraries, and the "
            f"versions in install_lerobot.sh. It says: {str(error).splitlines()[0]}"
        ) from error
    found = {"python": sys.version.split()[0], "ffmpeg": str(torchcodec.ffmpeg_major_version)}
    return found | {name: metadata.version(name) for name in PACKAGES}


def main(argv: Sequence[str] | None = None) -> int:
    """Print the result as JSON; 0 on success, 2 with one line on standard error otherwise."""
    arguments = parse(argv)
    try:
        result = run(arguments)
    except PeerError as error:
        print(f"lerobot_windows: {error}", file=sys.stderr)
        return 2
    except (metadata.PackageNotFoundError, ModuleNotFoundError) as error:
        print(
            f"lerobot_windows: {error}. Run this with the Python of the environment that "
            "install_lerobot.sh makes.",
            file=sys.stderr,
        )
        return 2
    text = json.dumps(result, indent=2)
    print(text)
    if arguments.json is not None:
        arguments.json.parent.mkdir(parents=True, exist_ok=True)
        arguments.json.write_text(text + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
