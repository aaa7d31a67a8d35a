"""How a stream's times came about (spec: Time)."""

from typing import Annotated, Literal

from pydantic import Field

from exumi_data.model.base import Identifier, Int64, Model

__all__ = ["STAMP_POINTS", "Clock", "Gap", "StampPoint"]

StampPoint = Literal[
    "kernel_rx",
    "user_rx",
    "buffer_soe",
    "bracket_mid",
    "device",
    "container_pts",
    "nominal_rate",
    "simulated",
    "unknown",
]
STAMP_POINTS: tuple[str, ...] = StampPoint.__args__  # type: ignore[attr-defined]  # typing's own way to list a Literal


class Clock(Model):
    """The clock of a stream and the correction from its raw times to ``time``.

    ``time = (raw - t_ref_ns)·(1 + drift_ppm·1e-6) + offset_ns - latency_ns``, rounded.
    If any term is not zero, the stream must hold a raw time array (``time_host`` or
    ``time_device``), so that the correction can be computed again.
    """

    source: Identifier
    """Name of the clock, such as ``hub_monotonic``, ``container`` or ``none``."""
    stamp_point: StampPoint
    """Where on its way the sample was stamped; ``nominal_rate`` means no stamp was measured."""
    t_ref_ns: Int64 = 0
    offset_ns: Int64 = 0
    offset_sigma_ns: Annotated[float, Field(ge=0)] | None = None
    drift_ppm: Annotated[float, Field(gt=-1e5, lt=1e5)] = 0.0
    drift_sigma_ppm: Annotated[float, Field(ge=0)] | None = None
    latency_ns: Int64 = 0
    latency_sigma_ns: Annotated[float, Field(ge=0)] | None = None
    raw_time: Literal["time_host", "time_device"] | None = None
    """The raw time array that ``time`` was computed from."""
    method: str | None = None
    """How offset, drift and latency were estimated."""

    @property
    def is_identity(self) -> bool:
        """Whether ``time`` equals the raw time."""
        return not (self.t_ref_ns or self.offset_ns or self.drift_ppm or self.latency_ns)


class Gap(Model):
    """Samples that are known to be missing."""

    after: Annotated[int, Field(ge=-1)]
    """Index of the last sample before the gap; -1 before the first."""
    lost: Annotated[int, Field(ge=1)] | None = None
    """How many samples were lost, if known."""
    reason: str | None = None
