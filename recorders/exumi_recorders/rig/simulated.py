"""``--rig simulated``: an exUMI gripper whose devices are programs that speak the real protocols.

The drivers are those of real devices: the headset sends datagrams over UDP, the cameras deliver
JPEG files over UNIX sockets, the encoder is a chip on a bus. One simulated session moves them all:
everything that is recorded can be compared with the truth.
"""

import contextlib
import json
import select
import shutil
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.calibration_items import now
from exumi_data.errors import ExumiError
from exumi_data.model.calibration import INTRINSICS, RIG_REFERENCE
from exumi_data.model.description import CalibrationItem
from exumi_data.simulation import PlaySession, simulate_play
from exumi_recorders.rig.loading import parse_rig
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.plan import Calibrated
from exumi_recorders.simulated.camera_setup import CameraSetup, PlaySetup
from exumi_recorders.simulated.headset_options import HeadsetFaults
from exumi_recorders.simulated.play import SimulatedPlay
from exumi_recorders.simulated.started import READY

__all__ = ["NAME", "SimulatedRig", "SimulatedSettings", "simulated_rig"]

NAME = "simulated"
"""What takes the place of a rig file's path."""

_CAMERAS = ("tactile_left", "tactile_right", "rgb")
_HEADSET_RATE = 90
_HEADSET_LAG_S = 0.010
_LEAD_S = 1.0
"""From when all devices are ready to the first motion: time to open them."""
_REST_S = 30.0
_START_S = 30.0
# Wider than the simulated gripper opens, and below what an uncertain zero makes of closed.
_MAPPED_M = (-0.002, 0.1)
_KNOWN = "known: it is the simulator's own"


@dataclass(frozen=True, slots=True)
class SimulatedSettings:
    """What the simulated hand does.

    Attributes
    ----------
    seed : int
    seconds : float
        For so long it moves; after that it rests.
    frame_width : int
        Of all cameras, pixels; frames are three quarters as high.
    taps : int
        How often the fingers close on an object and open again before they pick it up.
    toggles_s : tuple of float
        When the operator presses the controller's button, seconds after the first motion.
    absent_s : mapping of str to (float, float)
        Cameras that are unplugged meanwhile: from, to, as above.
    headset_faults : HeadsetFaults, optional
        What goes wrong with the headset.
    """

    seed: int = 7
    seconds: float = 120.0
    frame_width: int = 320
    taps: int = 0
    toggles_s: tuple[float, ...] = ()
    absent_s: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    headset_faults: HeadsetFaults = field(default_factory=HeadsetFaults)


@dataclass(frozen=True)
class SimulatedRig:
    """A rig whose devices are running.

    Attributes
    ----------
    rig : Rig
    calibrated : Calibrated
        The truth.
    session : PlaySession
    epoch_ns : int
        CLOCK_MONOTONIC at the session's start.
    """

    rig: Rig
    calibrated: Calibrated
    session: PlaySession
    epoch_ns: int


@contextlib.contextmanager
def simulated_rig(settings: SimulatedSettings | None = None) -> Iterator[SimulatedRig]:
    """Start the devices, and stop them after the block.

    Parameters
    ----------
    settings : SimulatedSettings, optional

    Yields
    ------
    SimulatedRig

    Raises
    ------
    ExumiError
        A device did not start.
    """
    settings = settings or SimulatedSettings()
    folder = Path(tempfile.mkdtemp(prefix="exumi-rig-"))
    with _free_port() as port:
        number = port
    cameras = {name: _camera(name, settings, folder) for name in _CAMERAS}
    programs = [("camera", setup.model_dump(mode="json")) for setup in cameras.values()]
    programs.append(("headset", _headset(settings, number)))
    running: list[subprocess.Popen[bytes]] = []
    try:
        for name, options in programs:
            running.append(_start(name, options))  # an interrupt ends those there are
        session = _session(settings)
        SimulatedPlay(**_play(settings), epoch_ns=0).session()  # the encoder's, while they start
        _wait_for_ready(running)
        epoch_ns = time.monotonic_ns() + round(_LEAD_S * 1e9)
        _begin(running, epoch_ns)
        _wait_for([Path(setup.socket) for setup in cameras.values()], running)
        yield SimulatedRig(
            rig=parse_rig(_document(settings, cameras, number, epoch_ns)),
            calibrated=_calibrated(session, cameras),
            session=session,
            epoch_ns=epoch_ns,
        )
    finally:
        try:
            for process in running:
                process.kill()
            for process in running:
                process.communicate()
        finally:
            shutil.rmtree(folder, ignore_errors=True)


def _session(settings: SimulatedSettings) -> PlaySession:
    size = (3 * settings.frame_width // 4, settings.frame_width)
    return simulate_play(**_play(settings), tactile_size=size, rgb_size=size)


def _play(settings: SimulatedSettings) -> dict[str, Any]:
    return {"seed": settings.seed, "duration_s": settings.seconds, "taps": settings.taps}


@contextlib.contextmanager
def _free_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        yield int(found.getsockname()[1])


def _camera(name: str, settings: SimulatedSettings, folder: Path) -> CameraSetup:
    return CameraSetup.model_validate(
        {
            "socket": str(folder / f"{name}.sock"),
            "shows": name,
            "play": PlaySetup(**_play(settings)),
            "epoch_ns": 0,  # said when all are ready
            "seed": settings.seed + _CAMERAS.index(name),
            "width": settings.frame_width,
            "height": 3 * settings.frame_width // 4,
            "live": True,
            "absent_s": [settings.absent_s[name]] if name in settings.absent_s else [],
            # One moment a picture: as cheap as can be, on the machine that records as well.
            "bands": 1,
            "exposures": 1,
        }
    )


def _headset(settings: SimulatedSettings, port: int) -> dict[str, Any]:
    return {
        "port": port,
        "dialect": "d",
        "rate_hz": _HEADSET_RATE,
        "duration_s": settings.seconds + _REST_S,
        "session": _play(settings),
        "seed": settings.seed,
        "lag_s": _HEADSET_LAG_S,
        "toggles_s": list(settings.toggles_s),
        "faults": settings.headset_faults.model_dump(mode="json"),
    }


def _start(name: str, options: dict[str, Any]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(  # noqa: S603  # our own program
        [
            sys.executable,
            "-P",
            "-m",
            "exumi_recorders.simulated.started",
            name,
            json.dumps(options),
        ],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the recorder
    )


def _wait_for_ready(running: Sequence["subprocess.Popen[bytes]"]) -> None:
    end = time.monotonic() + _START_S
    for process in running:
        output = process.stdout
        assert output is not None  # noqa: S101  # a pipe
        readable, _, _ = select.select([output], [], [], max(0.0, end - time.monotonic()))
        if not readable or output.readline() != READY:
            raise _not_started()


def _begin(running: Sequence["subprocess.Popen[bytes]"], epoch_ns: int) -> None:
    for process in running:
        assert process.stdin is not None  # noqa: S101  # a pipe
        try:
            process.stdin.write(b"%d\n" % epoch_ns)
            process.stdin.flush()
        except BrokenPipeError:
            raise _not_started() from None


def _wait_for(sockets: Sequence[Path], running: Sequence["subprocess.Popen[bytes]"]) -> None:
    end = time.monotonic() + _START_S
    while not all(path.exists() for path in sockets):
        if any(process.poll() is not None for process in running) or time.monotonic() > end:
            raise _not_started()
        time.sleep(0.01)


def _not_started() -> ExumiError:
    return ExumiError("a simulated device did not start", where=NAME)


def _document(
    settings: SimulatedSettings, cameras: dict[str, CameraSetup], port: int, epoch_ns: int
) -> dict[str, Any]:
    size = {"width": settings.frame_width, "height": 3 * settings.frame_width // 4, "rate": "30"}
    devices: dict[str, Any] = {
        "headset": {
            "driver": "quest",
            "host": "127.0.0.1",
            "port": port,
            "dialect": "d",
            "streams": {"pose": "pose", "headset": "headset"},
        },
        "encoder": {
            "driver": "as5600",
            "simulated": {**_play(settings), "epoch_ns": epoch_ns},
            "streams": {"width": "width"},
        },
    }
    for name, setup in cameras.items():
        finger = {
            "kind": "tactile",
            "side": name.removeprefix("tactile_"),
            "sensor": "simulated-gel",
        }
        devices[name] = {
            "driver": "uvc",
            "device": f"unix:{setup.socket}",
            "start_timeout_s": _START_S,  # the machine that records draws the pictures as well
            **size,
            **(finger if name != "rgb" else {"sensor": "simulated-wrist-camera"}),
            "streams": {"images": name},
        }
    return {
        "format": "exumi-rig",
        "version": "1.0",
        "rig": {"name": "simulated hand-held gripper", "licence": "CC0-1.0"},
        "embodiment": {"name": "simulated parallel gripper", "gripper": "parallel"},
        "controls": {"flag": "headset", "world_frame": "headset"},
        "devices": devices,
    }


def _calibrated(session: PlaySession, cameras: dict[str, CameraSetup]) -> Calibrated:
    encoder = session.encoder
    counts = [round(width_m * encoder.counts_per_m) for width_m in _MAPPED_M]
    items = {
        "width_map": CalibrationItem(
            value={
                "raw_to_data": {
                    "raw": [encoder.zero_count + count for count in counts],
                    "data": [count / encoder.counts_per_m for count in counts],
                }
            },
            method=_KNOWN,
        ),
        f"{INTRINSICS}rgb": CalibrationItem(
            value=_intrinsics(session, cameras["rgb"]), unit="px", method=_KNOWN
        ),
        "T_gripper_rgb": CalibrationItem(
            value=session.gripper_camera.tolist(), unit="m", method=_KNOWN
        ),
    }
    latencies = {name: setup.image_latency_ns for name, setup in cameras.items()}
    for name, latency_ns in {**latencies, "pose": round(_HEADSET_LAG_S * 1e9), "width": 0}.items():
        items[f"latency/{name}"] = CalibrationItem(
            value=latency_ns, unit="ns", uncertainty=1e6, method=_KNOWN
        )
    items = {name: item.model_copy(update={"time": now()}) for name, item in items.items()}
    arrays: dict[str, np.ndarray] = {}
    for name in ("tactile_left", "tactile_right"):
        reference = session.streams[name].reference
        if reference is not None:
            path = f"{RIG_REFERENCE}{name}"
            items[path] = CalibrationItem(value=None, array=f"calibration/{path}", method=_KNOWN)
            arrays[path] = reference
    return Calibrated(items, arrays)


def _intrinsics(session: PlaySession, camera: CameraSetup) -> dict[str, Any]:
    (fx, skew, cx), (_, fy, cy), _ = session.camera_matrix.tolist()
    size = {"width": camera.width, "height": camera.height}
    return {"model": "pinhole", **size, "fx": fx, "fy": fy, "cx": cx, "cy": cy, "skew": skew}
