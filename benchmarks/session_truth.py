"""What a raw exUMI session becomes, against the truth: poses, widths, times, tactile frames.

Sessions are simulated in the hub's own layout, with and without the tracker's own noise, and
converted. Errors are told where the hub sampled, and at the camera's frames, between two samples.

::

    python benchmarks/session_truth.py --work FOLDER --seeds 4 --json results/session_truth.json
"""

import argparse
import shutil
from collections import defaultdict
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, report
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from exumi_converters import ConvertOptions, convert
from exumi_data.dataset import open_dataset
from exumi_data.episode import Episode
from exumi_data.geometry import interpolate_poses
from exumi_data.simulation.hub_session import HubSession, HubSettings, simulate_hub_session
from exumi_data.simulation.hub_session.pictures import read_number

_SIDES = ("left", "right")
_MOST_GAP_NS = 100_000_000
_ASKED = {"mm": 1.0, "deg": 0.2, "ms": 5.0}
Errors = dict[str, list[NDArray[np.float64]]]


def session_s(episode: Episode, session: HubSession, time_ns: NDArray[np.int64]) -> Any:
    """Return times of an episode in seconds of its session."""
    start = np.datetime64(str(episode.metadata.start).removesuffix("Z"), "ns").astype(np.int64)
    return (time_ns + (int(start) - round(session.epoch_s * 1e9))) * 1e-9


def turned_deg(found: NDArray[np.float64], true: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much orientations differ."""
    turn = Rotation.from_quat(found[:, 3:]).inv() * Rotation.from_quat(true[:, 3:])
    return np.asarray(np.degrees(turn.magnitude()))


def compare(episode: Episode, session: HubSession, errors: Errors) -> int:
    """Add the errors of one episode; return how many tactile frames are not the hub's own."""
    truth, pose, width, rgb = session.truth, episode["pose"], episode["width"], episode["rgb"]
    poses, widths = np.asarray(pose.data), np.asarray(width.data)
    true = truth.pose(session_s(episode, session, np.asarray(pose.time)))
    errors["pose_mm"].append(1e3 * np.linalg.norm(poses[:, :3] - true[:, :3], axis=1))
    errors["pose_deg"].append(turned_deg(poses, true))
    own = truth.width_m(session_s(episode, session, np.asarray(width.time)))
    errors["width_mm"].append(1e3 * np.abs(widths - own))
    clip = str(episode.metadata.source.key)
    frames = np.arange(len(rgb)) / float(session.settings.rgb_rate)
    frames_s = np.asarray(session.true_s(clip, frames))
    found, valid = interpolate_poses(pose.time, poses, rgb.time, _MOST_GAP_NS)
    true = truth.pose(frames_s)
    errors["pose_at_frames_mm"].append(
        1e3 * np.linalg.norm(found[:, :3] - true[:, :3], axis=1)[valid]
    )
    errors["pose_at_frames_deg"].append(turned_deg(found[valid], true[valid]))
    between = np.interp(rgb.time, width.time, widths)
    errors["width_at_frames_mm"].append(1e3 * np.abs(between - truth.width_m(frames_s)))
    taken = session_s(episode, session, np.asarray(rgb.time))
    errors["rgb_time_ms"].append(1e3 * np.abs(taken - frames_s))
    wrong = 0
    for side in _SIDES:
        stream = episode[f"tactile_{side}"]
        numbers = np.array([read_number(frame) for frame in stream.frames], np.int64)
        shown = session.shown[side]
        first = int(np.flatnonzero(shown == numbers[0])[0])
        wrong += int(np.count_nonzero(numbers != shown[first : first + len(numbers)]))
        at = session_s(episode, session, np.asarray(stream.time))
        errors["tactile_time_ms"].append(1e3 * np.abs(at - session.captured_s[side][numbers]))
    return wrong


def measure(work: Path, seeds: int, settings: dict[str, Any]) -> dict[str, Any]:
    """Simulate, convert, compare; return each error's size, and the share within what is asked."""
    errors: Errors = defaultdict(list)
    episodes = wrong = 0
    for seed in range(seeds):
        root, out = work / "session", work / "out"
        for folder in (root, out):
            shutil.rmtree(folder, ignore_errors=True)
        made = HubSettings(seed=seed, seconds=8.0, calibration_scale=2, **settings)
        session = simulate_hub_session(root, made, demonstrations=4)
        options = ConvertOptions(workers=1, durable=False)
        done = convert(root, out, from_format="exumi-session", options=options)
        if done.failed:
            raise SystemExit(f"seed {seed}: {done.failed}")
        for episode in open_dataset(out):
            episodes += 1
            wrong += compare(episode, session, errors)
    result: dict[str, Any] = {"episodes": episodes, "tactile_frames_not_the_hubs": wrong}
    for name, parts in errors.items():
        values = np.concatenate(parts)
        asked = 0.5 if name.startswith("width") else _ASKED[name.rpartition("_")[2]]
        result[name] = {
            "rms": round(float(np.sqrt(np.mean(values**2))), 3),
            "p95": round(float(np.percentile(values, 95)), 3),
            "most": round(float(values.max()), 3),
            "share_within": [asked, round(float(np.mean(values <= asked)), 4)],
        }
    return result


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--seeds", type=int, default=4)
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    # None at all would look like a headset that has lost its place: such poses are left out.
    quiet = {"pose_noise_m": 1e-6, "pose_noise_rad": 1e-5}
    results = {
        "machine": describe_machine(("exumi-data", "numpy", "opencv-contrib-python-headless")),
        "with_the_trackers_noise": measure(arguments.work, arguments.seeds, {}),
        "with_hardly_any_noise": measure(arguments.work, arguments.seeds, quiet),
    }
    report("session_truth", results, arguments.json)


if __name__ == "__main__":
    main()
