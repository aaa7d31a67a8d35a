"""A program that records until it is killed: ``python recording_process.py DATASET [TRACE]``."""

import os
import sys
import time
from pathlib import Path

from exumi_recorders.journal.space import SpaceLimits
from exumi_recorders.recording.recorder import Recorder
from tests.exumi_recorders.numbered import Toy, device, episode

RATES = {"pose": 90.0, "camera": 30.0, "counter": 500.0}
TINY = SpaceLimits(soft_bytes=0, hard_bytes=0, reserve_bytes=1 << 16)


def main() -> None:
    dataset = Path(sys.argv[1])
    trace = os.open(sys.argv[2], os.O_WRONLY | os.O_CREAT | os.O_APPEND) if sys.argv[2:] else None

    def on_flushed(path: Path, length: int) -> None:
        if trace is not None:
            os.write(trace, f"{time.monotonic_ns()} {length} {path}\n".encode())

    recorder = Recorder(
        [device(Toy(rates=RATES))], space=TINY, segment_bytes=1 << 20, on_flushed=on_flushed
    )
    recorder.open()
    recorder.start(dataset, episode())
    print("recording", flush=True)
    while recorder.status().truncated is None:
        time.sleep(0.01)
    print(recorder.stop().truncated, flush=True)


if __name__ == "__main__":
    main()
