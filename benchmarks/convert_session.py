"""Converting a raw exUMI session: times real time, frames a second with --decode, and memory.

Sessions are simulated in the hub's own layout, with fingers of 640 by 480 pixels. Where videos are
kept, bytes are what takes time, and the latency clip, which is decoded (2400 by 1800 pixels): the
GoPro's other files are filled up to the bit rate of its 2.7K mode. Where they are decoded, they are
HEVC of 2704 by 2028 pixels.

::

    python benchmarks/convert_session.py --work FOLDER --minutes 10.5 60 --json results/session.json
"""

import argparse
import os
import resource
import shutil
import subprocess
import sys
import time
from fractions import Fraction
from pathlib import Path
from typing import Any

from measuring import describe_machine, report

_BYTES_PER_S = 60_000_000 // 8
_CONVERT = """
import sys
from exumi_converters import ConvertOptions, convert
settings = dict(text.split("=") for text in sys.argv[4:])
done = convert(sys.argv[1], sys.argv[2], from_format="exumi-session",
               options=ConvertOptions(workers=int(sys.argv[3]), settings=settings))
assert not done.failed, done.failed
print(done.frames)
"""


def simulate(folder: Path, count: int, settings: dict[str, Any], fill: bool) -> tuple[Path, float]:
    """Write a session, unless it is there; return it and its length in seconds."""
    from exumi_data.simulation.hub_session import HubSettings, simulate_hub_session

    said = folder / "seconds.txt"
    if not said.is_file():
        shutil.rmtree(folder, ignore_errors=True)
        session = simulate_hub_session(folder, HubSettings(**settings), demonstrations=count)
        for name in session.clips if fill else ():
            _fill(folder / name, 11.0)
        said.write_text(str(session.truth.duration_s))
    return folder, float(said.read_text())


def _fill(path: Path, seconds: float) -> None:
    """Append a box that players pass over, until the file has a camera's bit rate."""
    missing = round(seconds * _BYTES_PER_S) - path.stat().st_size
    if missing < 8:
        return
    with path.open("ab") as file:
        file.write(missing.to_bytes(4, "big") + b"free")
        left = missing - 8
        while left > 0:
            file.write(os.urandom(min(left, 1 << 20)))
            left -= 1 << 20


def convert(source: Path, work: Path, workers: int, *settings: str) -> dict[str, Any]:
    """Convert in processes of their own; return seconds, frames and peak memory in MB."""
    out = work / "out"
    shutil.rmtree(out, ignore_errors=True)
    command = [sys.executable, "-c", _CONVERT, str(source), str(out), str(workers), *settings]
    measured = [sys.executable, "-c", _MEASURED, *command]
    began = time.perf_counter()
    done = subprocess.run(measured, check=True, capture_output=True, text=True)
    seconds = time.perf_counter() - began
    frames, peak, used = done.stdout.split()
    return {
        "seconds": round(seconds, 2),
        "cpu_s_of_main_process": round(float(used), 2),
        "frames": int(frames),
        "peak_mb_of_largest_process": round(int(peak) / 1024),
    }


_MEASURED = """
import resource, subprocess, sys
done = subprocess.run(sys.argv[1:], check=True, capture_output=True, text=True)
usage = resource.getrusage(resource.RUSAGE_CHILDREN)
print(done.stdout.strip(), usage.ru_maxrss, usage.ru_utime + usage.ru_stime)
"""


def decode_only(videos: list[Path]) -> tuple[int, float]:
    """Decode videos to RGB in one loop, and do nothing else; return frames and seconds."""
    from exumi_data.store.video import FramePixels, VideoDecoder

    pixels, count = FramePixels(), 0
    began = time.perf_counter()
    for path in videos:
        with VideoDecoder(str(path), path) as decoder:
            for frame in decoder.frames():
                pixels.rgb(frame)
                count += 1
    return count, time.perf_counter() - began


def main() -> None:
    """Run the benchmark."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--minutes", type=float, nargs="*", default=[5.0])
    parser.add_argument("--decoded", type=int, default=2, help="demonstrations that are decoded")
    parser.add_argument("--json", type=Path)
    arguments = parser.parse_args()
    machine = describe_machine(("exumi-data", "av", "numpy", "opencv-contrib-python-headless"))
    workers = len(os.sched_getaffinity(0))
    work: Path = arguments.work
    demonstrations: int = arguments.decoded
    results: dict[str, Any] = {"machine": machine, "workers": workers, "kept": []}
    fingers = {"seconds": 10.0, "tactile_size": (480, 640)}
    for minutes in arguments.minutes:
        source, length = simulate(
            work / f"kept-{minutes:g}",
            max(2, round(60 * minutes / 12.2)),
            {**fingers, "codec": "libx264", "calibration_scale": 5},
            fill=True,
        )
        size = sum(path.stat().st_size for path in source.rglob("*") if path.is_file())
        found: dict[str, Any] = {"session_s": round(length), "mb": round(size / 1e6)}
        # One worker takes long, and says the same of a long session as of a short one.
        for count in sorted({1, workers}) if minutes == arguments.minutes[0] else [workers]:
            kept = convert(source, work, count)
            kept["times_real_time"] = round(length / kept["seconds"], 1)
            found[f"{count}_workers"] = kept
        results["kept"].append(found)
    scene = {"rgb_size": (2028, 2704), "rgb_rate": Fraction(30_000, 1001), "textured": True}
    film = {"codec": "libx265", "bit_rate": 60_000_000, "sweep_s": 0.0, "seconds": 4.0}
    source, _ = simulate(
        work / f"decoded-{demonstrations}", demonstrations, {**fingers, **scene, **film}, fill=False
    )
    shots, shots_s = decode_only(sorted(source.glob("raw_videos/*.MP4")))
    touches, touches_s = decode_only(sorted(source.glob("tactile_*/*.mp4")))
    results["decode_only"] = {
        "camera_frames_per_s": round(shots / shots_s, 1),
        "finger_frames_per_s": round(touches / touches_s, 1),
    }
    for count in sorted({1, workers}):
        decoded = convert(source, work, count, "decode=yes", "margin_s=5")
        # Episodes overlap by their margins: what the loop would take for the frames that are made.
        fingers_made = decoded["frames"] - shots
        alone_s = shots_s + touches_s / touches * fingers_made
        decoded["camera_frames"] = shots
        decoded["decode_only_s"] = round(alone_s, 2)
        decoded["of_decode_only"] = round(alone_s / decoded["seconds"], 2)
        results[f"decoded_{count}_workers"] = decoded
    shutil.rmtree(work / "out", ignore_errors=True)
    results["simulator_peak_mb"] = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024
    report("convert_session", results, arguments.json)


if __name__ == "__main__":
    main()
