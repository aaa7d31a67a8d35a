"""Live streams at run time, as the tensors that a policy was trained on."""

import threading
from collections import OrderedDict
from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

from exumi_data.episode import Episode
from exumi_data.errors import DamagedDataError, ExumiError, UsageError
from exumi_data.model import EpisodeMetadata
from exumi_data.store import jpeg
from exumi_data.ticks import tick_times_ns
from exumi_loaders.at_hand import at_hand, first_instant_ns, observation_times_ns
from exumi_loaders.buffers import BatchBuffers
from exumi_loaders.live_samples import checked_references, checked_sample
from exumi_loaders.observation import base_poses, put_proprioception
from exumi_loaders.options import one_of
from exumi_loaders.policy_spec import PolicySpec, check_rig
from exumi_loaders.sample_buffer import Sample, SampleBuffer
from exumi_loaders.targets import Targets, targets_of
from exumi_loaders.windows import Item

__all__ = ["LateStreamError", "PolicyStream", "StreamCounts"]

_MOST_SAMPLES = 8192
_REMEMBERED = 64
_TIME_LIMIT_NS = 2**62


class LateStreamError(ExumiError):
    """Live streams are missing, or too late to act on."""


@dataclass(slots=True)
class StreamCounts:
    """What went wrong with one live stream so far.

    Attributes
    ----------
    late : int
        Samples that arrived after an observation which should have had them: the latency that the
        policy was trained with is too small.
    dropped : int
        Samples that were dropped for lack of room, or arrived too late to be of any use.
    damaged : int
        Frames that could not be decoded: they are black and not valid.
    """

    late: int = 0
    dropped: int = 0
    damaged: int = 0


class PolicyStream:
    """Turn live samples into the observations of `PolicyWindows`, and actions into targets.

    Samples are pushed as they arrive, in any order and from any thread, each with the time at which
    it was captured; all times are on one clock. An observation at a time holds what a recorded
    window of that tick would: of each stream the newest sample that was captured at least its
    latency before. The two are the same, bit by bit, while every sample arrives within the latency
    that the policy was trained with. What arrives later is counted (`counts`), and used from then
    on.

    Parameters
    ----------
    spec : PolicySpec
        ``windows.policy_spec`` of the windows that the policy was trained on.
    rig : Episode or EpisodeMetadata
        The live rig, described as an episode that it records: its frames, tool frames and
        calibration are compared with those of the dataset.
    references : mapping of str to (H, W, C) uint8, optional
        The image without contact of each tactile stream whose reference the policy is given.
    accept : collection of str
        Streams whose calibration may differ from the dataset's.
    on_stale : {"flag", "raise"}
        Whether an observation with a stale stream marks it in ``<stream>_valid`` or
        ``proprioception_valid``, or is an error.
    slack_s : float
        How far before an earlier observation another one may lie.
    most_bytes : int
        Memory for the samples of one stream; the oldest are dropped beyond it.

    Attributes
    ----------
    counts : dict of str to StreamCounts

    Raises
    ------
    UsageError
        The rig is another than the policy was trained for: the stream is named, and what differs.

    Examples
    --------
    >>> stream = PolicyStream(spec, rig)  # doctest: +SKIP
    >>> stream.push("rgb", time_ns, jpeg_bytes)  # doctest: +SKIP
    >>> observation = stream.observation(now_ns)  # doctest: +SKIP
    >>> targets = stream.absolute_targets(policy(observation), now_ns)  # doctest: +SKIP
    """

    def __init__(
        self,
        spec: PolicySpec,
        rig: Episode | EpisodeMetadata,
        *,
        references: Mapping[str, np.ndarray] | None = None,
        accept: Collection[str] = (),
        on_stale: Literal["flag", "raise"] = "flag",
        slack_s: float = 1.0,
        most_bytes: int = 256 << 20,
    ) -> None:
        one_of("on_stale", on_stale, ("flag", "raise"))
        if not 0 <= slack_s <= 3600 or most_bytes < 1:
            raise UsageError(f"slack_s is {slack_s} s and most_bytes {most_bytes}")
        check_rig(spec, rig, accept)
        self.spec = spec
        self._items = spec.observation
        self._references = checked_references(spec, references or {})
        self._on_stale = on_stale
        self._slack_ns = round(slack_s * 1e9)
        self._most_bytes = most_bytes
        self._latency = {name: stream.latency_ns for name, stream in spec.streams.items()}
        reach = tick_times_ns(np.array([-spec.observation_steps[0]]), spec.tick)
        self._reach_ns = int(reach[0]) + self._slack_ns
        self._memory = BatchBuffers()
        self._lock = threading.Lock()
        self.reset()

    def reset(self) -> None:
        """Forget all samples, observations and counts: another episode begins."""
        with self._lock:
            self.counts = {name: StreamCounts() for name in self.spec.streams}
            self._buffers = {
                name: SampleBuffer(_MOST_SAMPLES, self._most_bytes) for name in self.spec.streams
            }
            self._bases: OrderedDict[int, dict[str, np.ndarray] | None] = OrderedDict()
            self._latest_ns: int | None = None

    def push(self, stream: str, time_ns: int, sample: bytes | npt.ArrayLike) -> None:
        """Add a sample that has arrived.

        Parameters
        ----------
        stream : str
        time_ns : int
            When it was captured.
        sample : bytes, or array
            The bytes of a JPEG, or a frame (H, W, C) uint8; a pose x y z qx qy qz qw; a width.
            It is copied.

        Raises
        ------
        UsageError
            The policy has no such stream, or this is no sample of it: its size, its type, numbers
            that are not finite.
        """
        if stream not in self.spec.streams:
            known = ", ".join(self.spec.streams)
            raise UsageError(f"the policy has no stream {stream!r}", fix=f"It has {known}.")
        time_ns = int(time_ns)
        if abs(time_ns) >= _TIME_LIMIT_NS:
            raise UsageError(f"{stream}: the time {time_ns} ns is not within ±2**62 ns")
        value = checked_sample(stream, self.spec.streams[stream], sample)
        with self._lock:
            buffer, counts = self._buffers[stream], self.counts[stream]
            latest = self._latest_ns
            if latest is not None and time_ns <= latest - self._latency[stream]:
                counts.late += 1
            buffer.push(Sample(time_ns, value))
            counts.dropped = buffer.dropped
            counts.damaged += value is None

    def observation(self, now_ns: int) -> Item:
        """Return what the policy has at hand.

        Parameters
        ----------
        now_ns : int
            The current time, on the clock of the samples.

        Returns
        -------
        dict of str to Tensor
            Keys, shapes and types of ``windows.observation(windows[i])``.

        Raises
        ------
        LateStreamError
            A stream has no sample at hand yet, or (``on_stale="raise"``) is stale. All such
            streams are named.
        UsageError
            `now_ns` lies further before an earlier observation than ``slack_s``.
        """
        now_ns = int(now_ns)
        with self._lock:
            wanted, padding = observation_times_ns(
                np.array([now_ns]), self.spec.observation_steps, self.spec.tick, self._start(now_ns)
            )
            chosen, fresh = self._choose(wanted[0])
            self._latest_ns = max(now_ns, self._latest_ns or now_ns)
            batch = self._memory.batch(self._items, 1)
            self._put_frames(batch.arrays, chosen, fresh)
            self._put_motion(batch.arrays, now_ns, chosen, fresh)
            batch.arrays["observation_padding"][0] = padding[0]
            for name, buffer in self._buffers.items():
                buffer.forget(self._latest_ns - self._latency[name] - self._reach_ns)
        return {name: tensor[0] for name, tensor in batch.tensors.items()}

    def _start(self, now_ns: int) -> int:
        """Return when all streams were first at hand."""
        first = {name: buffer.first_ns for name, buffer in self._buffers.items()}
        missing = [name for name, time in first.items() if time is None]
        there = {name: time for name, time in first.items() if time is not None}
        missing += [name for name, time in there.items() if time + self._latency[name] > now_ns]
        if missing:
            raise LateStreamError(
                f"no sample at hand of {', '.join(missing)}",
                fix="Wait until every stream has sent one, and its latency "
                f"({_in_ms(self._latency, missing)}) has passed.",
            )
        return first_instant_ns(there, self._latency)

    def _choose(
        self, wanted_ns: np.ndarray
    ) -> tuple[dict[str, list[Sample]], dict[str, np.ndarray]]:
        """Return the sample of each stream at each observed step, and whether it is fresh."""
        chosen, fresh, stale = {}, {}, []
        for name, buffer in self._buffers.items():
            limit = self.spec.streams[name].stale_ns
            index, fresh[name] = at_hand(buffer.times_ns, wanted_ns, self._latency[name], limit)
            if (index < 0).any():
                raise UsageError(
                    f"{name}: the samples of {int(wanted_ns[0])} ns are forgotten already",
                    fix=f"Observe in the order of time, at most {self._slack_ns / 1e9:g} s back "
                    "(slack_s), or give samples more room (most_bytes).",
                )
            chosen[name] = [buffer[i] for i in index.tolist()]
            if not fresh[name][-1]:
                age = int(wanted_ns[-1]) - chosen[name][-1].time_ns
                allowed = self._latency[name] + limit
                stale.append(f"{name} is {age / 1e6:.0f} ms old (limit {allowed / 1e6:.0f} ms)")
        if stale and self._on_stale == "raise":
            raise LateStreamError(f"stale: {', '.join(stale)}")
        return chosen, fresh

    def _put_frames(
        self,
        arrays: Mapping[str, np.ndarray],
        chosen: Mapping[str, list[Sample]],
        fresh: Mapping[str, np.ndarray],
    ) -> None:
        for name in self.spec.tactile + self.spec.rgb:
            for step, sample in enumerate(chosen[name]):
                out = arrays[name][0, step]
                is_there = bool(fresh[name][step]) and self._decode(name, sample, out)
                if not is_there:
                    out[:] = 0
                arrays[f"{name}_valid"][0, step] = is_there
            if name in self._references:
                arrays[f"{name}_reference"][0] = self._references[name]

    def _decode(self, name: str, sample: Sample, out: np.ndarray) -> bool:
        """Copy a frame; its JPEG is decoded once. Return whether it is sound."""
        if isinstance(sample.value, bytes):
            decoded = np.empty(out.shape, dtype=np.uint8)
            try:
                jpeg.decode_into(sample.value, decoded)
                self._buffers[name].replace(sample, decoded)
            except DamagedDataError:
                self._buffers[name].replace(sample, None)
                self.counts[name].damaged += 1
        if sample.value is None:
            return False
        out[:] = sample.value
        return True

    def _put_motion(
        self,
        arrays: Mapping[str, np.ndarray],
        now_ns: int,
        chosen: Mapping[str, list[Sample]],
        fresh: Mapping[str, np.ndarray],
    ) -> None:
        low = self.spec.pose + self.spec.width
        seen = {name: np.array([[sample.value for sample in chosen[name]]]) for name in low}
        put_proprioception(
            self.spec, arrays, np.array([0]), seen, {name: fresh[name][None] for name in low}
        )
        base = base_poses(self.spec, seen)
        if base is not None:
            base = {name: base[name][0, 0] for name in base if fresh[name][-1]}
        self._bases[now_ns] = base
        if len(self._bases) > _REMEMBERED:
            self._bases.popitem(last=False)

    def absolute_targets(self, action: npt.ArrayLike, at_ns: int) -> Targets:
        """Turn an action into where the grippers are to be, and when.

        Targets that lie in the past by now are for the caller to leave out.

        Parameters
        ----------
        action : (A, D) array or tensor
            As `PolicyWindows` has it: relative or absolute, not normalised. Rotations need not be
            orthogonal.
        at_ns : int
            The time of the observation that it answers.

        Returns
        -------
        Targets

        Raises
        ------
        UsageError
            The shape is another, a number is not finite, a rotation is none, or there was no
            observation at that time (the last 64 are remembered).
        LateStreamError
            The pose was stale in that observation.
        """
        at_ns = int(at_ns)
        with self._lock:
            if at_ns not in self._bases:
                raise UsageError(
                    f"there was no observation at {at_ns} ns, or more than {_REMEMBERED} ago"
                )
            base = self._bases[at_ns]
        late = [name for name in self.spec.pose if base is not None and name not in base]
        if late:
            raise LateStreamError(
                f"{', '.join(late)} was stale at {at_ns} ns: an action relative to it says nothing"
            )
        return targets_of(self.spec, action, base, at_ns)


def _in_ms(latency: Mapping[str, int], names: Iterable[str]) -> str:
    return ", ".join(f"{name} {latency[name] / 1e6:g} ms" for name in names)
