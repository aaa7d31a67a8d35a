"""How devices and streams are doing: what was lost, and what the operator has to know."""

from collections.abc import Mapping

from exumi_recorders.contract import Health
from exumi_recorders.recording.device import DeviceThread, RecordedStream
from exumi_recorders.recording.lanes import Lane
from exumi_recorders.recording.status import Problem, StreamStatus

__all__ = [
    "MALFORMED",
    "lost_since",
    "problems_of_device",
    "problems_of_stream",
    "status_of",
]

MALFORMED = "malformed"
"""Cause of samples that cannot be stored: of another length, or stamped in the future."""
_SILENT_S = 0.5
_SILENT_PERIODS = 5.0


def lost_since(thread: DeviceThread, now: Health, before: Health) -> dict[str, dict[str, int]]:
    """Return what a device has lost since an episode began, by stream and cause.

    A cause of a device with several ports is that of the first one, unless it is named
    ``<port>/<cause>``.

    Parameters
    ----------
    thread : DeviceThread
    now, before : Health
        Of this moment, and of the episode's beginning.
    """
    found: dict[str, dict[str, int]] = {}
    first = next(iter(thread.streams), None)
    for key, number in now.lost.items():
        since = number - before.lost.get(key, 0)
        port, divided, cause = key.rpartition("/")
        stream = thread.streams.get(port if divided else first or "")
        # It may be less than before: what was missed then came late.
        if stream is not None and since > 0:
            found.setdefault(stream.name, {})[cause] = since
    return found


def status_of(
    stream: RecordedStream, lane: Lane | None, lost: Mapping[str, int], now_ns: int
) -> StreamStatus:
    """Tell how a stream is going.

    Parameters
    ----------
    stream : RecordedStream
    lane : Lane or None
        Of the episode that is being recorded.
    lost : mapping of str to int
        Samples lost in the device, by cause.
    now_ns : int
    """
    rate, jitter = stream.meter.measure(now_ns)
    newest = stream.meter.last_host_ns
    return StreamStatus(
        name=stream.name,
        device=stream.device,
        kind=stream.port.kind,
        rate_hz=rate,
        jitter_s=jitter,
        age_s=None if newest is None else (now_ns - newest) / 1e9,
        samples=0 if lane is None else lane.written,
        dropped=0 if lane is None else lane.dropped,
        lost=lost if lane is None or not lane.malformed else {**lost, MALFORMED: lane.malformed},
        queue_bytes=0 if lane is None else lane.waiting_bytes,
        queue_age_s=0.0 if lane is None else lane.age_ns(now_ns) / 1e9,
    )


def problems_of_device(thread: DeviceThread) -> list[Problem]:
    """Return what is the matter with a device.

    Parameters
    ----------
    thread : DeviceThread
    """
    problems = [Problem(thread.name, "device", text) for text in thread.health.problems]
    if not thread.connected:
        text = f"{thread.name} is gone: {thread.trouble or 'it is not open'}."
        problems.append(Problem(thread.name, "device_lost", text))
    return problems


def problems_of_stream(
    stream: RecordedStream,
    thread: DeviceThread,
    status: StreamStatus,
    opened_ns: int,
    now_ns: int,
) -> list[Problem]:
    """Return what is the matter with a stream.

    Parameters
    ----------
    stream : RecordedStream
    thread : DeviceThread
        Of its device.
    status : StreamStatus
    opened_ns, now_ns : int
        When the devices were open, and the present, on the monotonic clock.
    """
    problems = []
    if status.dropped:
        text = f"{status.dropped} samples were dropped: the disk cannot keep up."
        problems.append(Problem(stream.name, "dropping", text))
    if malformed := status.lost.get(MALFORMED):
        text = f"{malformed} samples were not what the driver promised, and are left out."
        problems.append(Problem(stream.name, MALFORMED, text))
    if stream.frozen:
        problems.append(
            Problem(stream.name, "frozen", "The pose does not change: tracking may be lost.")
        )
    arrived = max(stream.meter.last_arrival_ns or 0, opened_ns)
    allowed = _SILENT_S
    if stream.rate_hz is not None:
        allowed = max(allowed, _SILENT_PERIODS / stream.rate_hz)
    if thread.connected and opened_ns and (now_ns - arrived) / 1e9 > allowed:
        text = f"No sample has come for {(now_ns - arrived) / 1e9:.1f} s."
        problems.append(Problem(stream.name, "no_samples", text))
    return problems
