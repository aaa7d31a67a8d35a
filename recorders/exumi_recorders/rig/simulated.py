"""``--rig simulated``: an exUMI gripper whose devices are programs that speak the real protocols.

The drivers are those of real devices: the headset sends datagrams over UDP, the cameras deliver
JPEG files over UNIX sockets, the encoder is a chip on a bus. One simulated session moves them all:
everything that is recorded can be compared with the truth.
"""

import contextlib
import json
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

from exumi_data.errors import ExumiError
from exumi_data.model.calibration import INTRINSICS, RIG_REFERENCE
from exumi_data.model.description import CalibrationItem
from exumi_data.simulation import PlaySession, simulate_play
from exumi_recorders.finalise.clocks import utc_text
from exumi_recorders.rig.loading import parse_rig
from exumi_recorders.rig.model import Rig
from exumi_recorders.session.plan import Calibrated
from exumi_recorders.simulated.camera_setup import CameraSetup, PlaySetup
from exumi_recorders.simulated.headset_options import HeadsetFaults

__all__ = ["NAME", "SimulatedRig", "SimulatedSettings", "simulated_rig"]

NAME = "simulated"
"""What takes the place of a rig file's path."""

_CAMERAS = ("tactile_left", "tactile_right", "rgb")
_HEADSET_RATE = 90
_HEADSET_LAG_S = 0.010
_LEASH = "exumi_recorders.simulated.leash"
_SETTLE_S = 2.0
_EARLY_S = 1.0
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
    size = (3 * settings.frame_width // 4, settings.frame_width)
    session = simulate_play(
        seed=settings.seed,
        duration_s=settings.seconds,
        tactile_size=size,
        rgb_size=size,
        taps=settings.taps,
    )
    folder = Path(tempfile.mkdtemp(prefix="exumi-rig-"))
    # Every device works out the session by itself before it can show it.
    epoch_ns = time.monotonic_ns() + round((_SETTLE_S + 0.08 * settings.seconds) * 1e9)
    with _free_port() as port:
        number = port
    cameras = {name: _camera(name, settings, folder, epoch_ns) for name in _CAMERAS}
    programs = [
        ("exumi_recorders.simulated.camera", setup.model_dump(mode="json"))
        for setup in cameras.values()
    ]
    programs.append(("exumi_recorders.simulated.headset", _headset(settings, number, epoch_ns)))
    running: list[subprocess.Popen[bytes]] = []
    try:
        running += [_start(module, options) for module, options in programs]
        _wait_for([Path(setup.socket) for setup in cameras.values()], running)
        # A camera that sends nothing for long seems broken.
        time.sleep(max(0.0, (epoch_ns - time.monotonic_ns()) / 1e9 - _EARLY_S))
        yield SimulatedRig(
            rig=parse_rig(_document(settings, cameras, number, epoch_ns)),
            calibrated=_calibrated(session, cameras),
            session=session,
            epoch_ns=epoch_ns,
        )
    finally:
        for process in running:
            process.terminate()
        for process in running:
            process.communicate()
        shutil.rmtree(folder, ignore_errors=True)


@contextlib.contextmanager
def _free_port() -> Iterator[int]:
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as found:
        found.bind(("127.0.0.1", 0))
        yield int(found.getsockname()[1])


def _camera(name: str, settings: SimulatedSettings, folder: Path, epoch_ns: int) -> CameraSetup:
    return CameraSetup.model_validate(
        {
            "socket": str(folder / f"{name}.sock"),
            "shows": name,
            "play": PlaySetup(seed=settings.seed, duration_s=settings.seconds, taps=settings.taps),
            "epoch_ns": epoch_ns,
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


def _headset(settings: SimulatedSettings, port: int, epoch_ns: int) -> dict[str, Any]:
    return {
        "port": port,
        "dialect": "d",
        "rate_hz": _HEADSET_RATE,
        "duration_s": settings.seconds + _REST_S,
        "epoch_ns": epoch_ns,
        "session": {
            "seed": settings.seed,
            "duration_s": settings.seconds,
            "taps": settings.taps,
        },
        "seed": settings.seed,
        "lag_s": _HEADSET_LAG_S,
        "toggles_s": list(settings.toggles_s),
        "faults": settings.headset_faults.model_dump(mode="json"),
    }


def _start(module: str, options: dict[str, Any]) -> "subprocess.Popen[bytes]":
    return subprocess.Popen(  # noqa: S603  # our own program
        [sys.executable, "-m", _LEASH, module, json.dumps(options)],
        stdin=subprocess.PIPE,  # never written to: it ends when this program does
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        start_new_session=True,  # Ctrl-C is for the recorder
    )


def _wait_for(sockets: Sequence[Path], running: Sequence["subprocess.Popen[bytes]"]) -> None:
    end = time.monotonic() + _START_S
    while not all(path.exists() for path in sockets):
        if any(process.poll() is not None for process in running) or time.monotonic() > end:
            raise ExumiError("a simulated device did not start", where=NAME)
        time.sleep(0.02)


def _document(
    settings: SimulatedSettings, cameras: dict[str, CameraSetup], port: int, epoch_ns: int
) -> dict[str, Any]:
    size = {"width": settings.frame_width, "height": 3 * settings.frame_width // 4, "rate": "30"}
    play = {"seed": settings.seed, "duration_s": settings.seconds, "taps": settings.taps}
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
            "simulated": {**play, "epoch_ns": epoch_ns},
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
    now = utc_text(time.time_ns())
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
            value=latency_ns, unit="ns", uncertainty=1e6, method=_KNOWN, time=now
        )
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
