"""The cameras that rig files can name: what is known of each, as data."""

from collections.abc import Mapping
from types import MappingProxyType

from exumi_recorders.contract import DriverType
from exumi_recorders.drivers.camera import CameraDriver, CameraOptions, CameraProfile
from exumi_recorders.drivers.pyav_camera import PyavSource
from exumi_recorders.drivers.socket_camera import SocketSource
from exumi_recorders.drivers.uvc import V4L2Source

__all__ = ["DIGIT", "GELSIGHT_MINI", "HDMI", "NINE_DTACT", "PROFILES", "UVC", "make_camera"]

_SOCKET = "unix:"

# Exposure and white balance of a tactile camera are measurements: nothing may adjust them. In
# auto_exposure 1 is manual; a dynamic frame rate halves the rate in the dark.
_STILL: Mapping[str, int] = MappingProxyType(
    {
        "auto_exposure": 1,
        "exposure_dynamic_framerate": 0,
        "gain_automatic": 0,
        "white_balance_automatic": 0,
        "focus_automatic_continuous": 0,
    }
)
# A camera that looks at a room may follow its light, but not with its rate.
_STEADY: Mapping[str, int] = MappingProxyType({"exposure_dynamic_framerate": 0})

_PROFILES = (
    CameraProfile(
        name="uvc",
        text="A USB camera that sends MJPEG.",
        kind="rgb",
        width=640,
        height=480,
        rate="30",
        lock=_STEADY,
    ),
    CameraProfile(
        name="9dtact",
        text="9DTact: 640x480 at 30 images/s, exposure and white balance locked.",
        kind="tactile",
        width=640,
        height=480,
        rate="30",
        sensor="9dtact",
        lock=_STILL,
    ),
    CameraProfile(
        name="gelsight-mini",
        text="GelSight Mini: 25 images/s nominal, fewer on many machines; its time is measured.",
        kind="tactile",
        width=3280,
        height=2464,
        rate="25",
        sensor="gelsight-mini",
        lock=_STILL,
    ),
    CameraProfile(
        name="digit",
        text="DIGIT: 320x240 at 60 or 30 images/s, 640x480 at 30 or 15.",
        kind="tactile",
        width=320,
        height=240,
        rate="60",
        sensor="digit",
        lock=_STILL,
        modes=((320, 240, "60"), (320, 240, "30"), (640, 480, "30"), (640, 480, "15")),
    ),
    CameraProfile(
        name="hdmi",
        text="An HDMI capture stick, which is a USB camera: such as a GoPro's live picture.",
        kind="rgb",
        width=1920,
        height=1080,
        rate="60",
    ),
)
PROFILES: Mapping[str, CameraProfile] = MappingProxyType({item.name: item for item in _PROFILES})
"""Profiles by name."""


def make_camera(profile: CameraProfile, options: CameraOptions) -> CameraDriver:
    """Return the driver of a camera.

    Parameters
    ----------
    profile : CameraProfile
    options : CameraOptions

    Returns
    -------
    CameraDriver
        Not open yet.
    """
    if options.device.startswith(_SOCKET):
        path = options.device.removeprefix(_SOCKET)
        return CameraDriver(profile, options, (lambda: SocketSource(path),))

    def v4l2() -> V4L2Source:
        return V4L2Source(
            options.device, buffers=options.buffers, lock=profile.lock, controls=options.controls
        )

    def pyav() -> PyavSource:
        return PyavSource(options.device, controls=options.controls)

    ways = {"auto": (v4l2, pyav), "v4l2": (v4l2,), "pyav": (pyav,)}
    return CameraDriver(profile, options, ways[options.backend])


def _driver(name: str) -> DriverType:
    profile = PROFILES[name]
    return DriverType(
        name=name,
        text=profile.text,
        options=CameraOptions,
        make=lambda options: make_camera(profile, options),
    )


UVC = _driver("uvc")
NINE_DTACT = _driver("9dtact")
GELSIGHT_MINI = _driver("gelsight-mini")
DIGIT = _driver("digit")
HDMI = _driver("hdmi")
