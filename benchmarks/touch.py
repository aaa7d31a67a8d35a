"""Contrastive batches of touch clips: the rules of a batch, and clips/s beside a bare decode loop.

::

    python benchmarks/touch.py --dataset PREPARED [--native CONVERTED] --json results/touch.json

Every batch of many epochs is checked, without decoding. Then whole epochs are read, in turn with a
loop that does nothing but decode the same JPEGs into one buffer; both on one core.
With `--native`, a dataset of videos: how many of the salient frames are key frames of the video
codec, where frames jump though nothing moves, and how many are active.
"""

import argparse
from pathlib import Path
from typing import Any

import numpy as np
from measuring import describe_machine, one_core, report, timed


def salient_frames_of_video(path: Path) -> dict[str, Any]:
    """Compare salient frames with all frames: share of key frames, share of active ones."""
    from exumi_data.dataset import open_dataset

    key_salient, key_all, active_salient, active_all = [], [], [], []
    for episode in open_dataset(path):
        view = episode["tactile"]
        is_key = view.array("keyframe") == np.arange(len(view))
        key_salient.append(is_key[view.salient].mean())
        key_all.append(is_key.mean())
        assert view.activity is not None  # noqa: S101  # converting computes it
        active = view.activity > 1e-3
        active_salient.append(active[view.salient].mean())
        active_all.append(active.mean())
    return {
        "clips": len(key_all),
        "salient_that_are_key_frames": float(np.mean(key_salient)),
        "all_that_are_key_frames": float(np.mean(key_all)),
        "clips_with_key_frames_only": int(np.sum(np.array(key_salient) == 1)),
        "salient_that_are_active": float(np.mean(active_salient)),
        "all_that_are_active": float(np.mean(active_all)),
    }


def main() -> None:
    """Run the benchmark."""
    from exumi_data.dataset import open_dataset
    from exumi_data.store import jpeg
    from exumi_loaders import ContrastiveBatches, InstructionSamples

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--native", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--epochs", type=int, default=1000)
    parser.add_argument("--repeats", type=int, default=5)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "numpy", "torch"))
    one_core()
    dataset = open_dataset(arguments.dataset)
    batches = ContrastiveBatches(dataset)
    table = batches.clips.table

    twice = mixed = same_episode = used_twice = checked = 0
    for epoch in range(arguments.epochs):
        used: list[int] = []
        for _, pairs in batches.plan(epoch):
            parts = [table[clip].part_id for clip in pairs[:, 0]]
            twice += len(parts) - len(set(parts))
            mixed += len({table[clip].kind for clip in pairs.ravel()}) - 1
            same_episode += sum(table[a].episode == table[b].episode for a, b in pairs)
            used += pairs.ravel().tolist()
            checked += 1
        used_twice += len(used) - len(set(used))

    def epoch_of_batches() -> int:
        return sum(batch["clip"].numel() for batch in batches.loader())

    chosen = [clip for _, pairs in batches.plan(0) for clip in pairs.ravel().tolist()]
    files = []
    for clip in chosen:
        view = dataset[table[clip].episode][table[clip].stream]
        files.append([view.encoded(int(k)) for k in batches.clips.salient(clip).numbers])
    out = np.empty((batches.clips.frames, *table[chosen[0]].shape), np.uint8)

    def bare_decoding() -> int:
        for clip in files:
            for position, data in enumerate(clip):
                jpeg.decode_into(data, out[position])
        return len(files)

    epoch_of_batches()  # readers are opened once
    loaded, bare = [], []
    for _ in range(arguments.repeats):  # in turn: both see the same load of the machine
        loaded += timed(epoch_of_batches, 1)["all"]
        bare += timed(bare_decoding, 1)["all"]
    samples = InstructionSamples(dataset, count=2000)
    made = timed(lambda: sum(1 for _ in samples), arguments.repeats)
    results = {
        "machine": machine,
        "clips": len(table),
        "groups": batches.describe(),
        "batch_sizes": sorted(len(pairs) for _, pairs in batches.plan(0)),
        "batches_checked": checked,
        "parts_twice_in_a_batch": twice,
        "other_sensors_or_pads_in_a_batch": mixed,
        "pairs_of_one_episode": same_episode,
        "clips_twice_in_an_epoch": used_twice,
        "clips_per_s": {
            "loader": float(np.median(loaded)),
            "bare_decoding": float(np.median(bare)),
        },
        "loader_to_bare": float(np.median(np.array(loaded) / np.array(bare))),
        "instruction_samples_per_s": made["median"],
    }
    if arguments.native is not None:
        results["salient_frames_of_video"] = salient_frames_of_video(arguments.native)
    report("touch", results, arguments.json)


if __name__ == "__main__":
    main()
