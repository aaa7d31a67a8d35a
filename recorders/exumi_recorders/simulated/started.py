"""A simulated device that gets ready first and begins when it is told to.

    python -m exumi_recorders.simulated.started camera|headset '{...}'

It prints ``ready`` when everything that takes time is done. A line on stdin then says when the
session begins (CLOCK_MONOTONIC, nanoseconds). The device ends with its stdin: with whoever has
started it, however that ends.
"""

import json
import os
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

from exumi_recorders.simulated.camera_setup import CameraSetup
from exumi_recorders.simulated.drawing_ahead import DrawnAhead
from exumi_recorders.simulated.headset import send
from exumi_recorders.simulated.headset_options import HeadsetOptions
from exumi_recorders.simulated.headset_plan import plan
from exumi_recorders.simulated.headset_poses import session_truth
from exumi_recorders.simulated.pictures import pictures_of
from exumi_recorders.simulated.serving import serve_frames

__all__ = ["READY", "main"]

READY = b"ready\n"

_AHEAD = 90
"""Frames: three seconds of a busy machine at 30 Hz, a few MB."""

Begin = Callable[[int], object]


@contextmanager
def _camera(options: str) -> Iterator[Begin]:
    setup = CameraSetup.model_validate_json(options)
    # A picture depends on the time since the session's start: that needs not be known yet.
    with DrawnAhead(pictures_of(setup), _AHEAD) as pictures:
        yield lambda epoch_ns: serve_frames(
            setup.model_copy(update={"epoch_ns": epoch_ns}), pictures
        )


@contextmanager
def _headset(options: str) -> Iterator[Begin]:
    setup = HeadsetOptions.model_validate_json(options)
    planned = plan(setup, session_truth(setup.session))
    yield lambda epoch_ns: send(setup.model_copy(update={"epoch_ns": epoch_ns}), planned)


_DEVICES = {"camera": _camera, "headset": _headset}


def _end_with_stdin(options: str) -> None:
    sys.stdin.buffer.read()
    _tidy(options)
    os._exit(0)


def _tidy(options: str) -> None:
    """Remove the camera's socket, and with the last one its folder: nobody else is left for that.

    Parameters
    ----------
    options : str
    """
    place = json.loads(options).get("socket")
    if place is not None:
        with suppress(OSError):
            Path(place).unlink(missing_ok=True)
            Path(place).parent.rmdir()


def main() -> None:
    """Be the device that the command line names."""
    name, options = sys.argv[1:]
    try:
        with _DEVICES[name](options) as begin:
            sys.stdout.buffer.write(READY)
            sys.stdout.buffer.flush()
            said = sys.stdin.buffer.readline()
            if said:
                lifeline = threading.Thread(target=_end_with_stdin, args=(options,), daemon=True)
                lifeline.start()
                begin(int(said))
    finally:
        _tidy(options)


if __name__ == "__main__":
    main()
