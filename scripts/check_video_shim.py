#!/usr/bin/env python3
"""Record from a camera that a preloaded shim pretends to be: the driver's own system calls, all.

No part of the build: it needs gcc and glibc. ``video_shim.c`` answers for one device; the driver
``uvc`` opens it, locks its exposure, reads its frames until it is unplugged, and what came is
compared with what the shim sent, byte for byte.
"""

import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

from exumi_recorders.contract import DeviceLostError, Event, Sample
from exumi_recorders.drivers.registry import find_driver
from exumi_recorders.simulated.pictures import jpeg_of_size

WIDTH, HEIGHT, RATE, FRAMES, LIFE = 640, 480, 60, 10, 300


def pictures() -> list[bytes]:
    """Return the frames that the camera repeats."""
    rng = np.random.default_rng(0)
    coarse = rng.integers(0, 255, (FRAMES, HEIGHT // 8, WIDTH // 8, 3), np.uint8)
    return [jpeg_of_size(i.repeat(8, axis=0).repeat(8, axis=1), 80_000) for i in coarse]


def parent() -> int:
    """Build the shim and run this program again with it."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shim = folder / "shim.so"
        source = Path(__file__).with_name("video_shim.c")
        build = ["gcc", "-O2", "-Wall", "-shared", "-fPIC", str(source), "-o", str(shim), "-ldl"]
        subprocess.run(build, check=True)
        (folder / "video0").touch()
        frames = b"".join(len(data).to_bytes(4, "little") + data for data in pictures())
        (folder / "frames").write_bytes(frames)
        settings = {
            "LD_PRELOAD": str(shim),
            "SHIM_DEVICE": str(folder / "video0"),
            "SHIM_FRAMES": str(folder / "frames"),
            "SHIM_WIDTH": str(WIDTH),
            "SHIM_HEIGHT": str(HEIGHT),
            "SHIM_RATE": str(RATE),
            "SHIM_FRAMES_TO_LIVE": str(LIFE),
        }
        command = [sys.executable, __file__, "record"]
        return subprocess.run(command, env={**os.environ, **settings}, check=False).returncode


def record() -> int:
    """Record until the camera is unplugged; compare."""
    kind = find_driver("9dtact")
    device = os.environ["SHIM_DEVICE"]
    controls = {"exposure_time_absolute": 80}
    options = kind.options(
        device=device, rate=str(RATE), controls=controls, backend="v4l2", buffers=4
    )
    camera = kind.make(options)
    camera.open()
    found: list[Sample | Event] = []
    used = time.process_time()
    try:
        while True:
            found += camera.read(0.1)
    except DeviceLostError as error:
        print(f"unplugged: {error}")
    used = time.process_time() - used
    health = camera.health()
    camera.close()
    samples = [item for item in found if isinstance(item, Sample)]
    logged = [item.detail for item in found if isinstance(item, Event)]
    print(f"{len(samples)} images, lost {dict(health.lost)}, controls {logged}")
    print(f"{used / len(samples) * 1e6:.0f} µs of processor an image of 80 000 bytes")
    intervals = np.diff([sample.time_host_ns for sample in samples])
    print(f"median interval {np.median(intervals) / 1e6:.3f} ms")
    known = set(pictures())
    numbers = [sample.sequence or 0 for sample in samples]
    missing = set(range(numbers[0], numbers[-1] + 1)) - set(numbers)
    right = (
        all(sample.payload in known for sample in samples)
        and {n for n in range(numbers[0], numbers[-1]) if n % 17 == 0 or n % 23 == 0} <= missing
        and dict(logged[0]) == {"auto_exposure": 1, "exposure_time_absolute": 80}
        and not health.problems
        and health.lost["error"] == sum(n % 17 == 0 and n % 23 != 0 for n in missing)
    )
    print("as sent" if right else "NOT as sent")
    return 0 if right else 1


if __name__ == "__main__":
    sys.exit(record() if sys.argv[1:] == ["record"] else parent())
