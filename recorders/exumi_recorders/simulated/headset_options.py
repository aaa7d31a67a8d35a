"""What a simulated headset does, and what goes wrong with it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

__all__ = ["HeadsetFaults", "HeadsetOptions", "SimulatedSession"]

Pose7 = tuple[float, float, float, float, float, float, float]
Share = Annotated[float, Field(ge=0, lt=1)]
Seconds = Annotated[float, Field(ge=0)]


class _Options(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class SimulatedSession(_Options):
    """Which session happens: arguments of `exumi_data.simulation.simulate_play`."""

    seed: Annotated[int, Field(ge=0)] = 0
    duration_s: Annotated[float, Field(ge=3)] = 20.0
    objects: tuple[str, ...] | None = None
    taps: Annotated[int, Field(ge=0)] = 0


class HeadsetFaults(_Options):
    """What goes wrong, on the way or in the headset."""

    lost: Share = 0.0
    """Part of the datagrams that never arrive."""
    late: Share = 0.0
    """Part that arrives one to three datagrams later."""
    twice: Share = 0.0
    """Part that arrives a second time, at once or later."""
    burst_s: Seconds = 0.0
    """The network holds what is sent and lets it go this often."""
    decimal_comma: bool = False
    """The headset's language writes numbers with a comma."""
    freeze_at_s: Seconds | None = None
    """The controller falls asleep: its pose stays as it is ..."""
    freeze_s: Seconds = 1.0
    """... for so long."""
    recentre_at_s: Seconds | None = None
    """The operator recentres the headset, and its whole world jumps."""


class HeadsetOptions(_Options):
    """Options of a simulated headset."""

    host: str = "127.0.0.1"
    """The hub."""
    port: Annotated[int, Field(gt=0, le=65535)] = 12346
    source: str = "127.0.0.1"
    """Address to send from."""
    dialect: Literal["a", "b", "c", "d"] = "b"
    """See `exumi_recorders.drivers.quest_dialects`."""
    hand: Literal["left", "right", "both"] = "right"
    """Dialects a and d say which hand it is; with both, the other is 0.3 m to the side."""
    rate_hz: Literal[60, 72, 90] = 72
    duration_s: Annotated[float, Field(gt=0)] = 20.0
    """For how long it sends."""
    epoch_ns: int | None = None
    """CLOCK_MONOTONIC of the session's second 0; by default as soon as it is ready."""
    session: SimulatedSession = SimulatedSession()
    seed: Annotated[int, Field(ge=0)] = 0
    """Of noise and faults."""
    lag_s: Annotated[float, Field(ge=0, le=0.1)] = 0.010
    """A pose is so old when it is sent."""
    noise_m: Seconds = 1.5e-4
    noise_rad: Seconds = 8e-4
    world_frame: Pose7 = (0.3, 0.75, 0.6, 0.0, 0.25881904510252074, 0.0, 0.9659258262890683)
    """In the headset's world, left-handed and y up: on a table, turned by 30 degrees."""
    world_frame_at_s: Seconds | None = 0.0
    """When it is sent; None for never."""
    mount: Pose7 | None = None
    """``T_gripper_controller``, right-handed, of the left controller that the app adds its fixed
    offset to; by default what is sent is the gripper's own pose."""
    head: tuple[float, float, float] = (0.05, -0.40, 0.45)
    """About where the headset is, metres in the session's world."""
    toggles_s: tuple[Seconds, ...] = ()
    """When the operator presses the button that starts and ends recording."""
    device_offset_ns: int = 3_600_000_000_000
    """The headset's clock at the epoch (dialect d)."""
    device_drift_ppm: Annotated[float, Field(ge=-1000, le=1000)] = 0.0
    echo_s: Annotated[float, Field(gt=0)] = 0.5
    """How often it asks for the hub's time (dialect d)."""
    faults: HeadsetFaults = HeadsetFaults()

    def device_time_ns(self, since_epoch_ns: int) -> int:
        """Return the headset's clock.

        Parameters
        ----------
        since_epoch_ns : int
            True time since the epoch.
        """
        drifted = since_epoch_ns + round(since_epoch_ns * self.device_drift_ppm * 1e-6)
        return drifted + self.device_offset_ns
