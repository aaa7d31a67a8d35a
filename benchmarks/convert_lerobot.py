"""Frames per second to a LeRobotDataset and back on one core, beside bare loops.

::

    python benchmarks/convert_lerobot.py --dataset DATASET --work FOLDER --json results/lerobot.json
"""

import argparse
import shutil
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

import av
import numpy as np
from measuring import describe_machine, one_core, report

from exumi_converters import ConvertOptions, ExportOptions, convert, export
from exumi_data.dataset import Dataset, open_dataset

_OPTIONS = {
    "av1": ("libsvtav1", {"g": "2", "crf": "30", "preset": "12", "svtav1-params": "lp=1"}),
    "h264": ("libx264", {"g": "2", "crf": "30"}),
}


def encode_only(dataset: Dataset, work: Path, codec: str) -> int:
    """Decode every frame of the dataset and encode it again; return how many there are."""
    count = 0
    name, options = _OPTIONS[codec]
    for episode in dataset:
        with episode:
            for stream in episode.streams.values():
                if stream.is_image:
                    count += _encode(stream, work / "only.mp4", name, options)
    return count


def _encode(stream: Any, path: Path, name: str, options: dict[str, str]) -> int:
    rate = Fraction(stream.metadata.nominal_rate or "25/1")
    with av.open(str(path), "w") as container:
        video: Any = container.add_stream(name, rate=rate, options=options)
        video.height, video.width = stream.frames.shape[1:3]
        video.pix_fmt = "yuv420p"
        video.codec_context.thread_count = 1
        for frame in stream.frames:
            colour = np.ascontiguousarray(np.broadcast_to(frame, (*frame.shape[:2], 3)))
            container.mux(video.encode(av.VideoFrame.from_ndarray(colour, format="rgb24")))
        container.mux(video.encode())
    return len(stream)


def decode_only(root: Path) -> int:
    """Decode every video of a LeRobotDataset; return the number of frames."""
    count = 0
    for path in sorted(root.rglob("*.mp4")):
        with av.open(str(path)) as container:
            container.streams.video[0].codec_context.thread_count = 1
            count += sum(1 for _ in container.decode(video=0))
    return count


def quality(before: Dataset, after: Dataset) -> float:
    """Return the median PSNR of frames that stand at the same times, in dB."""
    found = []
    parts = {str(e.metadata.source.key): e for e in after}
    for number, name in enumerate(before.ids[:3]):
        episode, written = before[name], parts[f"episode_{number:06d}"]
        for stream in (s for s in written.streams.values() if s.is_image):
            own = episode[stream.name]
            at = own.time[0] + stream.time[:: max(1, len(stream) // 10)]
            for index, tick in enumerate(at):
                row = int(np.abs(own.time - tick).argmin())
                other = stream.frames[index * max(1, len(stream) // 10)].astype(np.float64)
                error = float(np.mean((own.frames[row] - other) ** 2))
                found.append(10 * np.log10(255**2 / max(error, 1e-9)))
    return float(np.median(found))


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--dataset", type=Path, required=True)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--fps", default="25")
    parser.add_argument("--codec", choices=tuple(_OPTIONS), default="av1")
    told = parser.parse_args()
    told.work.mkdir(parents=True, exist_ok=True)
    machine = describe_machine(("exumi-data", "av", "numpy", "pyarrow"))
    one_core()
    dataset = open_dataset(told.dataset)
    out, back = told.work / "lerobot", told.work / "back"
    for folder in (out, back):
        shutil.rmtree(folder, ignore_errors=True)
    settings = {"fps": told.fps, "codec": told.codec, "gaps": "cut"}
    options = ExportOptions(workers=1, keep_going=True, durable=False, settings=settings)
    results: dict[str, Any] = {"machine": machine, "episodes": len(dataset), "codec": told.codec}
    start = time.perf_counter()
    export(told.dataset, out, to_format="lerobot", options=options)
    results["written_s"] = time.perf_counter() - start
    start = time.perf_counter()
    frames = decode_only(out)
    results["decoded_s"] = time.perf_counter() - start
    start = time.perf_counter()
    encoded = encode_only(dataset, told.work, told.codec)
    results["encoded_s"] = time.perf_counter() - start
    start = time.perf_counter()
    convert(out, back, from_format="lerobot", options=ConvertOptions(workers=1, durable=False))
    results["read_s"] = time.perf_counter() - start
    videos = sum(path.stat().st_size for path in out.rglob("*.mp4"))
    pixels = sum(
        int(np.prod(s.frames.shape[1:3]))
        for s in dataset[dataset.ids[0]].streams.values()
        if s.is_image
    )
    results |= {
        "frames": frames,
        "to_lerobot_frames_per_s": round(frames / results["written_s"]),
        "encode_only_frames_per_s": round(encoded / results["encoded_s"]),
        "from_lerobot_frames_per_s": round(frames / results["read_s"]),
        "decode_only_frames_per_s": round(frames / results["decoded_s"]),
        "bytes_per_frame": round(videos / frames),
        "bytes_per_pixel": round(videos / frames / pixels, 4),
        "psnr_db": round(quality(dataset, open_dataset(back)), 1),
    }
    print(f"| to lerobot | {results['to_lerobot_frames_per_s']} frames/s |")
    print(f"| a loop that decodes and encodes | {results['encode_only_frames_per_s']} frames/s |")
    print(f"| from lerobot | {results['from_lerobot_frames_per_s']} frames/s |")
    print(f"| a loop that decodes | {results['decode_only_frames_per_s']} frames/s |")
    report("convert_lerobot", results, told.json)


if __name__ == "__main__":
    main()
