"""Cases of signal quality: timing."""

from collections.abc import Iterator
from typing import Any

import numpy as np

from corpus import bases
from corpus.case import EXUMI, Case, Finding, case
from corpus.draft import Draft

__all__ = ["counted", "events", "timing_cases"]

ROOT = "zarr.json"
STEP_NS = 10_000_000
TIME = "streams/current/time"
WOBBLE_NS = np.array([0, 400_000, -300_000, 100_000, -500_000, 200_000, 300_000], dtype=np.int64)


def _regular(count: int, step_ns: int = STEP_NS) -> np.ndarray:
    """Return measured times: regular, with a little jitter."""
    return bases.times(count, step_ns) + np.resize(WOBBLE_NS, count)


def _current(time: np.ndarray, **fields: Any) -> Draft:
    """Return an episode with one number a sample."""
    draft = Draft()
    _add(draft, "current", time, **fields)
    return draft


def _add(draft: Draft, name: str, time: np.ndarray, **fields: Any) -> None:
    draft.stream(
        name,
        "acme:motor-current",
        extension_version="2",
        schema_url="https://acme.example/motor-current.json",
        **fields,
    )
    draft.put(f"streams/{name}/time", time)
    draft.put(f"streams/{name}/data", np.resize(np.arange(7, dtype=np.int16), len(time)))


def events() -> Draft:
    """Return an episode with samples that come when something happens, long pauses between."""
    intervals = np.array([40, 900, 70, 15, 2300, 5, 310, 120, 1, 650], dtype=np.int64)
    return _current(np.cumsum(np.resize(intervals, 90)) * 1_000_000)


def counted() -> Draft:
    """Return an episode with a counter, lost samples that are declared, one that came late."""
    kept = np.delete(np.arange(80, dtype=np.int64), [20, 21, 22, 40, 60, 61])
    gaps = [{"after": 19, "lost": 3, "reason": "kernel"}, {"after": 36, "lost": 1}]
    draft = _current(_regular(80)[kept], nominal_rate="100", gaps=gaps)
    sequence, flags = kept.astype(np.uint64), np.zeros(len(kept), dtype=np.uint32)
    sequence[[66, 67]] = sequence[[67, 66]]
    flags[56], flags[67] = 4, 2
    draft.put("streams/current/sequence", sequence)
    draft.put("streams/current/flags", flags)
    return draft


def _empty_cases() -> Iterator[Case]:
    draft = Draft()
    draft.stream("pose", "pose", frames={"parent": "world", "child": "gripper"})
    draft.put("streams/pose/time", bases.times(0))
    draft.put("streams/pose/data", np.empty((0, 7)), names=("time", "component"))
    draft.stream("rgb", "rgb", images=bases.images_of("encoded"))
    bases.put_encoded(draft, "rgb", [])
    places = [Finding("STRM-004", f"streams/{name}/time") for name in ("pose", "rgb")]
    yield case("STRM-004__no_samples", "Sensors that said nothing.", draft, *places)
    draft = _current(_regular(40))
    _add(draft, "later", _regular(30) + 1_000_000_000)
    at = Finding("TIME-009", "streams/later/time")
    yield case("TIME-009__one_after_the_other", "A clock that is a second ahead.", draft, at)


def _sound_cases() -> Iterator[Case]:
    draft = Draft()
    draft.stream("sound", "audio", rate="2000", channels=1)
    draft.put("streams/sound/time", bases.times(25))
    edges = np.arange(26, dtype=np.uint64) * 100
    draft.put("streams/sound/offset", edges, names=("edge",))
    sound = np.tile(np.arange(50, dtype=np.int16), 50)[:, None]
    draft.put("streams/sound/data", sound, names=("sample", "channel"))
    at = Finding("AUD-002", "streams/sound/time")
    yield case("AUD-002__half", "1000 samples/s, stated as 2000.", draft, at)


def _rate_cases() -> Iterator[Case]:
    draft = _current(_regular(60, 15_000_000), nominal_rate="100")
    at = Finding("TIME-005", TIME)
    yield case("TIME-005__slower", "66.7 Hz, stated as 100 Hz.", draft, at)
    # up to half a period late or early
    time = bases.times(60) + np.resize(WOBBLE_NS, 60) * 90
    draft = _current(time, nominal_rate="10")
    at = Finding("TIME-007", TIME)
    yield case("TIME-007__jitter", "Stamps up to half a period off.", draft, at)
    time = _regular(60)
    time[33] = time[32] + 200_000
    at = Finding("TIME-008", TIME, index=33)
    yield case("TIME-008__twice", "Two samples within 0.2 ms.", _current(time), at)
    arrivals = _regular(16, 40_000_000).repeat(4) + np.resize(bases.times(4, 30_000), 64)
    at = Finding("TIME-008", TIME, index=1)
    draft = _current(arrivals, nominal_rate="100")
    yield case("TIME-008__bursts", "Four samples at a time, each packet on arrival.", draft, at)


def _gap_cases() -> Iterator[Case]:
    kept = np.delete(np.arange(60), [20, 21, 22, 40, 41])
    time = _regular(60)[kept]
    draft = _current(time, gaps=[{"after": 36}])
    at = Finding("TIME-006", TIME, index=20)
    yield case("TIME-006__silent", "Two gaps, of which one is told.", draft, at)
    draft = _current(bases.times(60, STEP_NS)[kept], nominal_rate="100", gaps=[{"after": 19}])
    draft.metadata["streams"]["current"]["clock"] = {
        "source": "none",
        "stamp_point": "nominal_rate",
    }
    at = Finding("TIME-006", TIME, index=37)
    yield case("TIME-006__nominal", "Nominal times with a hole.", draft, at)
    gaps = [{"after": 19, "lost": 3}, {"after": 36, "lost": 20}]
    at = Finding("GAP-002", ROOT, f"{EXUMI}/streams/current/gaps/1/lost", index=1)
    yield case("GAP-002__too_many", "20 lost in 30 ms.", _current(time, gaps=gaps), at)
    draft = counted()
    draft.metadata["streams"]["current"]["gaps"].pop()
    at = Finding("SEQ-002", "streams/current/sequence", index=37)
    yield case("SEQ-002__one_lost", "A number that nobody mentions.", draft, at)


def _clock_cases() -> Iterator[Case]:
    count = 200
    host = bases.times(count, 50_000_000) + 7_000_000_000
    time = host - 7_000_000_000 + np.resize(WOBBLE_NS, count)
    time[120:] += 35_000_000
    draft = _current(time)
    draft.put("streams/current/time_host", host)
    at = Finding("CLOCK-005", "streams/current/time_host", index=120)
    yield case("CLOCK-005__set_forward", "A wall clock that was set by 35 ms.", draft, at)
    yield from _drifting(200, 300_000_000)
    device = bases.times(60, 10)
    draft = _current(_regular(60), time_device_unit="us")
    draft.put("streams/current/time_device", device)
    at = Finding("CLOCK-006", "streams/current/time_device")
    yield case("CLOCK-006__unit", "Milliseconds that are called microseconds.", draft, at)


def _drifting(count: int, step_ns: int) -> Iterator[Case]:
    """Yield a minute in which the device is 1000 ppm slow, and nobody says so."""
    device = bases.times(count, step_ns // 1000)
    clock = {"source": "device", "stamp_point": "device", "raw_time": "time_device"}
    draft = _current(device * 1000, time_device_unit="us", clock=clock)
    draft.put("streams/current/time_device", device)
    host = bases.times(count, step_ns + step_ns // 1000) + np.resize(WOBBLE_NS, count)
    draft.put("streams/current/time_host", host + 7_000_000_000)
    at = Finding("CLOCK-006", "streams/current/time_host")
    yield case("CLOCK-006__not_declared", "A device that is 1000 ppm slow.", draft, at)


def timing_cases() -> Iterator[Case]:
    """Return the cases."""
    yield from _empty_cases()
    yield from _sound_cases()
    yield from _rate_cases()
    yield from _gap_cases()
    yield from _clock_cases()
