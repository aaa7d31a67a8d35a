"""What streams say over time, as curves that can be compared."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from exumi_validators.context import EpisodeContext
from exumi_validators.sample_flags import flagged

__all__ = ["Curve", "activity_of", "curve_of", "of_kind", "width_of"]

# A latency is the same all along: the first hour at 1 kHz tells enough.
_MOST_SAMPLES = 1 << 22


@dataclass(frozen=True, slots=True, eq=False)
class Curve:
    """A stream's valid samples.

    Attributes
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    values : (N, ...) float
    """

    time_ns: NDArray[np.int64]
    values: NDArray[np.floating]

    def cut(self, at_ns: int) -> "tuple[Curve, Curve]":
        """Return what lies before a time, and what lies at it or after it."""
        place = int(np.searchsorted(self.time_ns, at_ns))
        return (
            Curve(self.time_ns[:place], self.values[:place]),
            Curve(self.time_ns[place:], self.values[place:]),
        )


def of_kind(episode: EpisodeContext, kind: str) -> list[str]:
    """Return the names of the streams of a kind."""
    return [name for name, stream in episode.streams.items() if stream.kind == kind]


def width_of(episode: EpisodeContext, name: str) -> str | None:
    """Return the width stream of the gripper that a sensor sits on.

    The only one, or the one whose name ends like the sensor's: ``width_left``, ``tactile_left``.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the sensor's stream.
    """
    widths = of_kind(episode, "width")
    if len(widths) > 1:
        ending = name.rpartition("_")[2]
        widths = [width for width in widths if width.rpartition("_")[2] == ending]
    return widths[0] if len(widths) == 1 else None


def activity_of(episode: EpisodeContext, name: str) -> Curve | str:
    """Return the activity of a tactile stream, or why it cannot be used."""
    path = f"{name}/activity"
    if path not in episode.derived:
        return "no stored activity, which exumi prepare stores"
    return curve_of(episode, name, f"derived/{path}")


def curve_of(episode: EpisodeContext, name: str, path: str) -> Curve | str:
    """Return the valid samples of a stream, or why they cannot be used.

    Parameters
    ----------
    episode : EpisodeContext
    name : str
        Of the stream.
    path : str
        Of the array with a row for each sample.
    """
    stream = episode.streams[name]
    if stream.clock.stamp_point == "nominal_rate":
        return "times are nominal"
    paths = [f"streams/{name}/time", path]
    if "flags" in stream.arrays:
        paths.append(f"streams/{name}/flags")
    times, values, count = [], [], 0
    for _, rows in episode.blocks(*paths):
        time, value, *flag = (column[: _MOST_SAMPLES - count] for column in rows)
        good = np.isfinite(value.reshape(len(value), -1)).all(axis=1)
        if flag:
            good &= ~flagged(flag[0], "invalid")
        times.append(time[good])
        values.append(value[good])
        count += len(time)
        if count >= _MOST_SAMPLES:
            break
    if not count:
        return "arrays cannot be read"
    joined = np.concatenate(times)
    if not (joined[1:] > joined[:-1]).all():
        return "times do not increase"
    return Curve(joined, np.concatenate(values))
