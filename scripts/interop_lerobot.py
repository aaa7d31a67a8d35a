"""Read and write datasets with the package ``lerobot`` itself, to hold our converter against it.

Runs with the interpreter of an environment that has lerobot 0.4 or later, not with ours::

    python3 -m venv lerobot-venv && lerobot-venv/bin/pip install lerobot
    EXUMI_LEROBOT_PYTHON=lerobot-venv/bin/python make test PYTEST_ARGS="-k lerobot"

``read ROOT OUT`` opens a dataset and writes what it gives to ``OUT.json`` and ``OUT.npz``.
``write ROOT`` makes one with `LeRobotDataset.create`, and puts the truth into ``ROOT.npz``.
"""

import argparse
import json
from pathlib import Path
from typing import Any

import numpy as np

FPS = 30
HEIGHT, WIDTH = 64, 80
LENGTHS = (20, 25, 31)
NAMES = ["pose.x", "pose.y", "pose.z", "pose.qx", "pose.qy", "pose.qz", "pose.qw", "grip.width_m"]


def read(root: Path, out: Path) -> None:
    """Open a dataset as a trainer does, and note everything that it gives."""
    from lerobot.datasets.compute_stats import aggregate_stats, get_feature_stats
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    dataset = LeRobotDataset("local/exumi", root=root)
    found: dict[str, Any] = {
        "episodes": dataset.num_episodes,
        "frames": dataset.num_frames,
        "fps": dataset.fps,
        "features": sorted(dataset.features),
        "cameras": dataset.meta.camera_keys,
        "lengths": [int(length) for length in dataset.meta.episodes["length"]],
    }
    items = [dataset[index] for index in range(len(dataset))]
    for key in ("timestamp", "frame_index", "episode_index", "index", "task_index"):
        found[key] = [item[key].item() for item in items]
    found["task"] = [item["task"] for item in items]
    arrays: dict[str, Any] = {}
    vectors = [
        key
        for key, feature in dataset.features.items()
        if feature["dtype"] == "float32" and key != "timestamp"
    ]
    for key in vectors:
        arrays[key] = np.stack([np.atleast_1d(item[key].numpy()) for item in items])
    for key in dataset.meta.camera_keys:
        arrays[key] = np.stack(
            [
                (item[key].numpy() * 255).round().astype(np.uint8).transpose(1, 2, 0)
                for item in items
            ]
        )
    # Its own statistics of the same numbers, put together by its own code.
    numbers = np.array(found["episode_index"])
    for key in vectors:
        parts = [
            {key: get_feature_stats(arrays[key][numbers == number], axis=0, keepdims=False)}
            for number in range(dataset.num_episodes)
        ]
        ours = dataset.meta.stats[key]
        for name, value in aggregate_stats(parts)[key].items():
            arrays[f"theirs/{key}/{name}"] = value
            arrays[f"ours/{key}/{name}"] = np.asarray(ours[name])
    step = 1 / dataset.fps
    windows = LeRobotDataset(
        "local/exumi",
        root=root,
        delta_timestamps={key: [-step, 0.0, step] for key in (*dataset.meta.camera_keys, *vectors)},
    )
    found["window"] = {
        key: list(value.shape) for key, value in windows[1].items() if hasattr(value, "shape")
    }
    Path(f"{out}.json").write_text(json.dumps(found))
    np.savez(f"{out}.npz", **arrays)


def picture(episode: int, index: int) -> np.ndarray:
    """Return a smooth picture that moves, (H, W, 3) uint8."""
    y, x = np.mgrid[:HEIGHT, :WIDTH]
    return np.stack([90 + x, 100 + y + index, 140 - x // 2 + 10 * episode], axis=-1).astype(
        np.uint8
    )


def write(root: Path) -> None:
    """Make a dataset as a recorder does: all episodes in one file, images as video and as PNG."""
    from lerobot.datasets.lerobot_dataset import LeRobotDataset

    shape = (HEIGHT, WIDTH, 3)
    image = {"shape": shape, "names": ["height", "width", "channels"]}
    features = {
        "observation.state": {"dtype": "float32", "shape": (len(NAMES),), "names": NAMES},
        "action": {"dtype": "float32", "shape": (2,), "names": ["left", "right"]},
        "observation.images.front": {"dtype": "video", **image},
        "observation.images.gel": {"dtype": "video", **image},
        "observation.images.side": {"dtype": "image", **image},
    }
    dataset = LeRobotDataset.create(
        "local/theirs", fps=FPS, features=features, root=root, robot_type="umi"
    )
    truth: dict[str, Any] = {}
    for episode, length in enumerate(LENGTHS):
        states = np.zeros((length, len(NAMES)), np.float32)
        turn = np.linspace(0, 0.5, length) + episode
        states[:, 0] = 0.01 * np.arange(length)
        states[:, 5], states[:, 6] = np.sin(turn / 2), np.cos(turn / 2)
        states[:, 7] = 0.05
        for index in range(length):
            frame = picture(episode, index)
            dataset.add_frame(
                {
                    "observation.state": states[index],
                    "action": np.zeros(2, np.float32),
                    "observation.images.front": frame,
                    "observation.images.gel": np.ascontiguousarray(frame[::-1]),
                    "observation.images.side": np.ascontiguousarray(frame[:, ::-1]),
                    "task": f"task {episode % 2}",
                }
            )
        dataset.save_episode()
        truth[f"state{episode}"] = states
        truth[f"frames{episode}"] = np.stack([picture(episode, i) for i in range(length)])
    dataset.finalize()
    np.savez(f"{root}.npz", **truth)


def main() -> None:
    """Run one of the two."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("what", choices=("read", "write"))
    parser.add_argument("root", type=Path)
    parser.add_argument("out", type=Path, nargs="?")
    told = parser.parse_args()
    if told.what == "read":
        read(told.root, told.out or told.root)
    else:
        write(told.root)


if __name__ == "__main__":
    main()
