"""What one episode of a session is made from, as JSON: it travels to the worker that writes it."""

from datetime import UTC, datetime, timedelta

from exumi_data.model.base import Model

__all__ = ["ClipPlan", "EpisodePlan", "Latency", "as_timestamp"]

_NS = 1_000_000_000


class Latency(Model):
    """By how much a stream's stamps are late."""

    latency_ns: int
    sigma_ns: int | None
    method: str


class ClipPlan(Model):
    """Where the clip is: on the hub's clock, in step with the encoder."""

    offset_ns: int
    """What to add to the clip's times at `t_ref_ns`, for Unix time."""
    t_ref_ns: int
    drift_ppm: float
    drift_sigma_ppm: float | None
    sigma_ns: int
    method: str
    camera: str | None
    model: str | None
    """Registered name of the camera's model."""


class EpisodePlan(Model):
    """What one episode is made from."""

    start_ns: int
    """Unix time of the episode's time 0."""
    stop_ns: int
    clip: ClipPlan
    pose: Latency
    fingers: dict[str, Latency]
    sensor: str
    gripper: dict[str, object] | None
    """The calibration item of the gripper's map."""
    rig: bool
    decode: bool
    quality: int


def as_timestamp(unix_ns: int) -> str:
    """Return a Unix time as the format's timestamp.

    Parameters
    ----------
    unix_ns : int
    """
    seconds, rest = divmod(unix_ns, _NS)
    moment = datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=seconds)
    return f"{moment:%Y-%m-%dT%H:%M:%S}.{rest:09d}Z"
