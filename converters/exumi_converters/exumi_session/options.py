"""Options of the format ``exumi-session``."""

from pathlib import Path

from pydantic import Field

from exumi_converters.format_options import FormatOptions

__all__ = ["SessionOptions"]


class SessionOptions(FormatOptions):
    """What the user can say about a session; everything has a default or is looked for."""

    timezone: str = Field(
        default="",
        description="Time zone that the camera's clock was set to, such as Asia/Shanghai or "
        "+08:00. Default: the one in which the clips fall into the hub's recording.",
    )
    gripper: Path | None = Field(
        default=None,
        description="The gripper's calibration: exUMI's gripper_calibration.json, or CSV. "
        "Default: a file of that name in the session.",
    )
    intrinsics: Path | None = Field(
        default=None,
        description="How the GoPro sees: JSON of OpenImuCameraCalibrator. Default: a file "
        "gopro_intrinsics*.json in the session.",
    )
    margin_s: float = Field(
        default=0.5,
        ge=0.0,
        le=60.0,
        description="Seconds of the hub's recording that are kept before and after each clip.",
    )
    pose_latency_ms: float | None = Field(
        default=None,
        ge=-1000.0,
        le=1000.0,
        description="By how much poses are late at the hub. Default: measured by the latency clip "
        "if the gripper moves in it, else 60 ms, give or take 30.",
    )
    marker: int = Field(default=4, ge=0, description="Id of the marker in the latency clip.")
    marker_dictionary: str = Field(
        default="DICT_4X4_50", description="Its dictionary, as OpenCV calls it."
    )
    marker_side_m: float = Field(default=0.06, gt=0.0, description="Edge of its black square.")
    rig: str = Field(
        default="exumi",
        pattern="^(exumi|none)$",
        description="Whose fixed transforms are put on record: exumi (those of the released "
        "code) or none.",
    )
    place_by_clock: bool = Field(
        default=False,
        description="Place clips that nothing else can place by the camera's clock, to a second.",
    )
    decode: bool = Field(
        default=False,
        description="Store frames as JPEG instead of the videos: loses a little, reads faster.",
    )
    quality: int = Field(default=95, ge=50, le=100, description="JPEG quality, with decode.")
