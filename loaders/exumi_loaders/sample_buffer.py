"""The last samples of one live stream, in the order of their capture; memory is bounded."""

from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

__all__ = ["Sample", "SampleBuffer"]


@dataclass(slots=True)
class Sample:
    """One sample. `value` is None for a frame that turned out to be damaged."""

    time_ns: int
    value: bytes | np.ndarray | None

    @property
    def size(self) -> int:
        """Bytes."""
        if isinstance(self.value, np.ndarray):
            return self.value.nbytes
        return 0 if self.value is None else len(self.value)


class SampleBuffer:
    """The last samples of one live stream.

    Parameters
    ----------
    most_samples : int
    most_bytes : int
        Beyond either the oldest samples are dropped, but never the last one.

    Attributes
    ----------
    first_ns : int or None
        Capture time of the first sample of all that were ever pushed.
    dropped : int
        Samples that were dropped before `forget` would have, or came too late to be of use.
    """

    def __init__(self, most_samples: int, most_bytes: int) -> None:
        self._most_samples = most_samples
        self._most_bytes = most_bytes
        self._times: list[int] = []
        self._samples: list[Sample] = []
        self._bytes = 0
        self._forgotten_ns: int | None = None
        self.first_ns: int | None = None
        self.dropped = 0

    def __len__(self) -> int:
        return len(self._samples)

    @property
    def bytes(self) -> int:
        """Bytes of all samples that are kept."""
        return self._bytes

    @property
    def times_ns(self) -> np.ndarray:
        """(N,) int64: capture times of the samples that are kept, ascending."""
        return np.array(self._times, dtype=np.int64)

    def __getitem__(self, index: int) -> Sample:
        return self._samples[index]

    def push(self, sample: Sample) -> None:
        """Add a sample, in whatever order it came.

        Parameters
        ----------
        sample : Sample
        """
        if self._forgotten_ns is not None and sample.time_ns <= self._forgotten_ns:
            self.dropped += 1  # samples after it are gone: it would pass for the newest of its time
            return
        position = bisect_right(self._times, sample.time_ns)
        self._times.insert(position, sample.time_ns)
        self._samples.insert(position, sample)
        self._bytes += sample.size
        if self.first_ns is None or sample.time_ns < self.first_ns:
            self.first_ns = sample.time_ns
        while len(self) > 1 and (len(self) > self._most_samples or self._bytes > self._most_bytes):
            self._drop(1)
            self.dropped += 1

    def replace(self, sample: Sample, value: np.ndarray | None) -> None:
        """Give a sample that is kept another value: what was decoded, or None.

        Parameters
        ----------
        sample : Sample
        value : ndarray, optional
        """
        self._bytes -= sample.size
        sample.value = value
        self._bytes += sample.size

    def forget(self, before_ns: int) -> None:
        """Drop the samples that are at hand at no time from `before_ns` on.

        Parameters
        ----------
        before_ns : int
        """
        self._drop(max(bisect_right(self._times, before_ns) - 1, 0))

    def _drop(self, count: int) -> None:
        if not count:
            return
        self._forgotten_ns = self._times[count - 1]
        self._bytes -= sum(sample.size for sample in self._samples[:count])
        del self._times[:count], self._samples[:count]
