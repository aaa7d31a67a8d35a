"""A simulated camera: a process that serves MJPEG frames over a UNIX socket, as they come due.

    python -m exumi_recorders.simulated.camera '{"socket": "...", "epoch_ns": ...}'

`camera_setup` says what the stamps mean against the truth; `drivers.socket_camera` has the frames'
header and reads them.
"""

import contextlib
import sys
import threading

from exumi_recorders.simulated.camera_setup import CameraSetup
from exumi_recorders.simulated.pictures import pictures_of
from exumi_recorders.simulated.serving import serve_frames

__all__ = ["serve"]


def serve(setup: CameraSetup, stop: threading.Event | None = None) -> None:
    """Be a camera until `stop`; its socket is there as soon as it is ready.

    Parameters
    ----------
    setup : CameraSetup
    stop : threading.Event, optional
    """
    serve_frames(setup, pictures_of(setup), stop)


if __name__ == "__main__":
    with contextlib.suppress(KeyboardInterrupt):
        serve(CameraSetup.model_validate_json(sys.argv[1]))
