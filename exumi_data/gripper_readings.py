"""From encoder counts to a gripper's opening: readings at known openings, a monotone map.

What the released calibration of exUMI's gripper does is read as it stands: counts that run over the
encoder's end, and a file that says centimetres and holds metres.
"""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from exumi_data.calibration_items import CalibrationRefusedError
from exumi_data.errors import SourceError
from exumi_data.model.description import CalibrationItem
from exumi_data.model.documents import load_json
from exumi_data.raw_to_data import KEY

__all__ = [
    "GRIPPER_METHOD",
    "GripperMap",
    "GripperReadings",
    "check_openings",
    "fit_gripper",
    "gripper_item",
    "read_gripper_file",
    "readings_at_rest",
    "unwrap",
]

GRIPPER_METHOD = "exumi-gripper-pchip/1"

_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}
# Travel of a gripper, metres: openings in another unit than was said are found by it.
_LEAST_TRAVEL_M, _MOST_TRAVEL_M = 0.02, 0.4
_SHORTEST_TRAVEL_M = 0.005
_FEWEST = 5
_MOST_STEP_M = 0.0201
_POINTS_PER_STEP = 8
_MODULUS = 4096
# Of a rule or a gauge block held between the fingers, and of a count.
_GAUGE_M = 5e-4
_QUANTUM = 1.0 / math.sqrt(12.0)
# The map is monotone, so a wrong reading shows by what its neighbours say of it.
_MOST_MISSED_STEPS = 0.5
_MOST_MISSED_GAUGES = 5.0
_STILL_COUNTS = 8.0
# A point that is left out is predicted by its neighbours: their errors are in it as well.
_OWN_SHARE = math.sqrt(1.5)
_MOST_SPREAD_COUNTS = 40.0
_REST_S, _REST_COUNTS = 0.8, 6
_MOST_FILE_BYTES = 4 << 20

Float64Array = NDArray[np.float64]


@dataclass(frozen=True)
class GripperReadings:
    """Encoder counts at known openings.

    Attributes
    ----------
    opening_m : tuple of float
        Metres, one for each group of readings.
    counts : tuple of ndarray
        What the encoder said there, (n,) int64 or, where somebody averaged, float64 each.
    modulus : int or None
        Where the counts wrap; None where they hold their turns.
    notes : tuple of str
        What was found on the way, such as a unit that was not the one that was said.
    """

    opening_m: tuple[float, ...]
    counts: tuple[NDArray[np.int64] | Float64Array, ...]
    modulus: int | None = _MODULUS
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class GripperMap:
    """A monotone map from counts to openings.

    Attributes
    ----------
    raw : (K,) float64
        Unwrapped counts, ascending.
    opening_m : (K,) float64
        Metres; linear between the points.
    knots : (k, 2) float64
        The openings that were set and the mean counts there, by opening.
    residual_m : (k,) float64
        What the map misses an opening by when it is made without it; NaN at both ends.
    uncertainty_m : float
        Standard deviation of an opening: readings, gauge, and what the map misses.
    modulus : int or None
        Where the counts wrap; None where the map goes on for more than a turn.
    notes : tuple of str
    """

    raw: Float64Array
    opening_m: Float64Array
    knots: Float64Array
    residual_m: Float64Array
    uncertainty_m: float
    modulus: int | None
    notes: tuple[str, ...]

    @property
    def residual_rms_m(self) -> float:
        """Root mean square of the residuals, metres."""
        return float(np.sqrt(np.nanmean(self.residual_m**2)))


def unwrap(counts: NDArray[np.integer], modulus: int = _MODULUS) -> NDArray[np.int64]:
    """Return counts that go on where the encoder's begin anew.

    Parameters
    ----------
    counts : (N,) int
        In the order in which they were read, less than half a turn from one to the next.
    modulus : int, optional

    Returns
    -------
    (N,) int64
        The first one is kept.
    """
    values = np.asarray(counts, np.int64)
    half = modulus // 2
    steps = (np.diff(values) + half) % modulus - half
    return np.concatenate([values[:1], values[:1] + np.cumsum(steps)])


def circular_mean(
    counts: NDArray[np.integer] | NDArray[np.floating], modulus: int | None
) -> tuple[float, float]:
    """Return mean and standard deviation of readings, on the circle where they wrap; counts."""
    values = np.asarray(counts, np.float64)
    if modulus is None:
        centre = float(values.mean())
    else:
        mean = np.exp(2j * np.pi * values / modulus).mean()
        centre = float(np.angle(mean)) / (2 * np.pi) * modulus % modulus
    away = from_mean(values, centre, modulus)
    spread = float(np.sqrt(np.sum(away**2) / max(len(away) - 1, 1)))
    return centre, spread


def from_mean(values: NDArray[Any], mean: float, modulus: int | None) -> Float64Array:
    """Return how far readings are from another, the shorter way round where they wrap; counts."""
    away = np.asarray(values, np.float64) - mean
    return away if modulus is None else (away + modulus / 2) % modulus - modulus / 2


def fit_gripper(readings: GripperReadings, *, gauge_m: float = _GAUGE_M) -> GripperMap:
    """Fit the map: circular means, unwrapped by opening, and a monotone cubic through them.

    Parameters
    ----------
    readings : GripperReadings
    gauge_m : float, optional
        Standard deviation of the openings as they were set, metres.

    Returns
    -------
    GripperMap

    Raises
    ------
    CalibrationRefusedError
        There are too few openings, they are too far apart, readings at one opening scatter, or the
        counts do not go one way; or an opening does not fit between its neighbours.
    """
    means, spreads = (
        zip(*(circular_mean(counts, readings.modulus) for counts in readings.counts), strict=True)
        if readings.counts
        else ((), ())
    )
    order = np.argsort(readings.opening_m, kind="stable")
    opening = np.array(readings.opening_m, np.float64)[order]
    spread = np.array(spreads)[order]
    check_openings(opening)
    _check_spread(opening, spread)
    raw = _unwrapped_means(np.array(means)[order], opening, readings.modulus)
    if raw[-1] < raw[0]:
        points_raw, points_opening = raw[::-1], opening[::-1]
    else:
        points_raw, points_opening = raw, opening
    fine, width, bent = _sampled(points_raw, points_opening)
    residual = _left_out(points_raw, points_opening)
    _check_missed(points_opening, residual, gauge_m)
    slope = float(np.abs(np.gradient(points_opening, points_raw)).max())
    reading = math.hypot(float(np.sqrt(np.mean(spread**2))), _QUANTUM) * slope
    missed = float(np.sqrt(np.nanmean(residual**2))) / _OWN_SHARE
    modulus = readings.modulus
    travel = float(points_raw[-1] - points_raw[0])
    notes = [*readings.notes]
    if modulus is not None and travel > modulus:
        notes.append(
            f"the travel is {travel / modulus:.2f} turns: the driver has to count them, by "
            f"home = {round(raw[0]) % modulus} in the rig file"
        )
        modulus = None
    elif modulus is not None and (points_raw[0] < 0 or points_raw[-1] >= modulus):
        notes.append(f"the counts run over {modulus - 1} to 0 within the range")
    if bent > 0.1 * gauge_m:
        notes.append(f"linear pieces leave the cubic by up to {1e3 * bent:.2f} mm")
    if raw[-1] < raw[0]:
        residual = residual[::-1]
    return GripperMap(
        raw=fine,
        opening_m=width,
        knots=np.stack([opening, raw if modulus is None else np.mod(raw, modulus)], axis=1),
        residual_m=residual,
        uncertainty_m=math.hypot(gauge_m, reading, missed),
        modulus=modulus,
        notes=tuple(notes),
    )


def check_openings(openings_m: Sequence[float] | Float64Array) -> None:
    """Refuse openings that make no map.

    Parameters
    ----------
    openings_m : sequence of float
        Metres, in any order.

    Raises
    ------
    CalibrationRefusedError
        There are too few, one is negative or there twice, they are too far apart, or they span
        what no gripper does.
    """
    ordered = sorted(float(opening) for opening in openings_m)
    if len(ordered) < _FEWEST:
        raise CalibrationRefusedError(
            f"there are {len(ordered)} openings, needed are {_FEWEST}",
            fix="Set the gripper to one opening a centimetre, from closed to open.",
        )
    if ordered[0] < 0:
        raise CalibrationRefusedError(
            f"an opening of {1e3 * ordered[0]:g} mm", fix="Openings begin at 0, closed."
        )
    for low, high in pairwise(ordered):
        if high <= low:
            raise CalibrationRefusedError(
                f"the opening of {1e3 * low:.1f} mm is there twice",
                fix="Put all readings of one opening together.",
            )
        if high - low > _MOST_STEP_M:
            raise CalibrationRefusedError(
                f"nothing between {1e3 * low:.0f} and {1e3 * high:.0f} mm: too coarse",
                fix="Set the gripper to one opening a centimetre.",
            )
    span = ordered[-1] - ordered[0]
    if not _SHORTEST_TRAVEL_M <= span <= _MOST_TRAVEL_M:
        raise CalibrationRefusedError(
            f"the openings span {1e3 * span:.3g} mm, which no gripper does",
            fix="Say in which unit they are: --unit m, cm or mm.",
        )


def _check_spread(opening_m: Float64Array, spread: Float64Array) -> None:
    worst = int(spread.argmax())
    if spread[worst] > _MOST_SPREAD_COUNTS:
        raise CalibrationRefusedError(
            f"readings at {1e3 * opening_m[worst]:.0f} mm scatter by {spread[worst]:.0f} counts",
            fix="Hold the gripper still while it is read; look at the magnet.",
        )


def _check_missed(opening_m: Float64Array, missed_m: Float64Array, gauge_m: float) -> None:
    """Refuse an opening that is far from where its neighbours say that it is."""
    between = np.abs(opening_m[2:] - opening_m[:-2]) / 2
    most = np.maximum(_MOST_MISSED_STEPS * between, _MOST_MISSED_GAUGES * gauge_m)
    beyond = np.abs(missed_m[1:-1]) / most
    worst = int(beyond.argmax())
    if beyond[worst] > 1:
        raise CalibrationRefusedError(
            f"the opening of {1e3 * opening_m[worst + 1]:.0f} mm does not fit between its "
            f"neighbours: the map without it misses it by {1e3 * missed_m[worst + 1]:+.1f} mm",
            fix="Set and read it and its neighbours again.",
        )


def _unwrapped_means(
    means: Float64Array, opening_m: Float64Array, modulus: int | None
) -> Float64Array:
    """Return mean counts that go on over the encoder's end; refuse what does not go one way.

    The count at the smallest opening is as the encoder says it: there its turns are counted from.
    """
    steps = np.diff(means)
    if modulus is not None:
        steps = (steps + modulus / 2) % modulus - modulus / 2
    coarse = np.abs(steps) > (math.inf if modulus is None else modulus / 4)
    if coarse.any():
        at = int(coarse.argmax())
        raise CalibrationRefusedError(
            f"from {1e3 * opening_m[at]:.0f} to {1e3 * opening_m[at + 1]:.0f} mm the counts go by "
            f"{steps[at]:+.0f} of {modulus}: too far to know which way round",
            fix="Take smaller steps, or look for a wrong reading there.",
        )
    if np.abs(np.cumsum(steps)).max() < _STILL_COUNTS:
        raise CalibrationRefusedError(
            f"the counts hardly change, {means[0]:.0f} to {means[-1]:.0f}",
            fix="Look whether the encoder turns with the gripper, and at its magnet.",
        )
    # By most of the steps: one wrong reading can be as large as the way.
    way = 1.0 if np.median(np.sign(steps)) >= 0 else -1.0
    wrong = way * steps <= 0
    if wrong.any():
        at = int(wrong.argmax())
        raise CalibrationRefusedError(
            f"the counts do not go one way: {means[at]:.0f} at {1e3 * opening_m[at]:.0f} mm, "
            f"{means[at + 1]:.0f} at {1e3 * opening_m[at + 1]:.0f} mm",
            fix="Read these openings again.",
        )
    return np.asarray(means[0] + np.concatenate([[0.0], np.cumsum(steps)]))


def _sampled(
    raw: Float64Array, opening_m: Float64Array
) -> tuple[Float64Array, Float64Array, float]:
    """Return points of the monotone cubic, and by how much lines between them leave it."""
    from scipy.interpolate import PchipInterpolator

    cubic = PchipInterpolator(raw, opening_m)
    share = np.arange(len(raw) * _POINTS_PER_STEP - _POINTS_PER_STEP + 1) / _POINTS_PER_STEP
    fine = np.interp(share, np.arange(len(raw)), raw)
    dense = np.linspace(raw[0], raw[-1], 4001)
    bent = float(np.abs(np.interp(dense, fine, cubic(fine)) - cubic(dense)).max())
    return fine, np.asarray(cubic(fine), np.float64), bent


def _left_out(raw: Float64Array, opening_m: Float64Array) -> Float64Array:
    """Return by how much the map misses each point when it is made without it."""
    from scipy.interpolate import PchipInterpolator

    missed = np.full(len(raw), np.nan)
    for i in range(1, len(raw) - 1):
        others = np.arange(len(raw)) != i
        missed[i] = PchipInterpolator(raw[others], opening_m[others])(raw[i]) - opening_m[i]
    return missed


def gripper_item(found: GripperMap) -> CalibrationItem:
    """Make the calibration item of a map: what `raw.transform` of a width names.

    Parameters
    ----------
    found : GripperMap
    """
    readings = sum(not math.isnan(value) for value in found.residual_m)
    said = [
        f"{len(found.knots)} openings; residuals are those of {readings} openings that were left "
        "out one by one",
        *found.notes,
    ]
    return CalibrationItem(
        value={
            KEY: {
                "raw": [round(float(value), 4) for value in found.raw],
                "data": [round(float(value), 7) for value in found.opening_m],
            },
            "range_m": [round(float(value), 7) for value in sorted(found.opening_m[[0, -1]])],
            **({} if found.modulus is None else {"modulus": found.modulus}),
            "openings_m": [round(float(value), 7) for value in found.knots[:, 0]],
            "counts": [round(float(value), 2) for value in found.knots[:, 1]],
        },
        unit="m",
        uncertainty=round(found.uncertainty_m, 7),
        residual=round(found.residual_rms_m, 7),
        method=GRIPPER_METHOD,
        procedure="; ".join(said),
    )


def read_gripper_file(path: Path, *, unit: str | None = None) -> GripperReadings:
    """Read counts at openings from a file: JSON or CSV.

    JSON: exUMI's (``{"metadata": {"unit", "sensor_range"}, "calibration": [[opening, count]]}``).
    CSV: a header with ``count`` and one of ``opening_m``, ``opening_cm``, ``opening_mm``, a reading
    a line.

    Parameters
    ----------
    path : pathlib.Path
    unit : {"m", "cm", "mm"}, optional
        Of the openings, whatever the file says.

    Returns
    -------
    GripperReadings
        Where the stated unit makes a travel that no gripper has and one other does not, it is that
        one, and a note says so.

    Raises
    ------
    SourceError
        The file is none of these.
    """
    try:
        if path.stat().st_size > _MOST_FILE_BYTES:
            raise SourceError(f"larger than {_MOST_FILE_BYTES:,} bytes", where=path)
        raw = path.read_bytes()
    except OSError as error:
        raise SourceError(f"cannot be read ({error.strerror})", where=path) from None
    if path.suffix.lower() == ".csv":
        stated, pairs, modulus = _csv_pairs(raw, path)
    else:
        stated, pairs, modulus = _json_pairs(load_json(raw, path), path)
    scale, notes = _scale([opening for opening, _ in pairs], stated, unit)
    groups: dict[float, list[float]] = {}
    for opening, count in pairs:
        groups.setdefault(round(opening * scale, 7), []).append(count)
    return GripperReadings(
        tuple(groups), tuple(np.array(c, np.float64) for c in groups.values()), modulus, notes
    )


def _json_pairs(
    document: Mapping[str, Any], where: Path
) -> tuple[str, list[tuple[float, float]], int]:
    try:
        metadata = document["metadata"]
        stated = str(metadata["unit"])
        low, high = (int(value) for value in metadata.get("sensor_range", (0, _MODULUS - 1)))
        pairs = [(float(opening), float(count)) for opening, count in document["calibration"]]
    except (KeyError, TypeError, ValueError, AttributeError):
        raise SourceError(
            "no calibration of a gripper",
            where=where,
            fix='Expected {"metadata": {"unit"}, "calibration": [[opening, count], ...]}.',
        ) from None
    modulus = high - low + 1
    if low != 0 or modulus < 2:
        raise SourceError(f"a sensor_range from {low} to {high}", where=where)
    return stated, _checked(pairs, modulus, where), modulus


def _csv_pairs(raw: bytes, where: Path) -> tuple[str, list[tuple[float, float]], int]:
    try:
        rows = list(csv.DictReader(io.StringIO(raw.decode("utf-8-sig"))))
        columns = [name for name in rows[0] if name.startswith("opening_")]
        (column,) = columns
        pairs = [(float(row[column]), float(row["count"])) for row in rows]
    except (UnicodeDecodeError, csv.Error, IndexError, KeyError, TypeError, ValueError):
        raise SourceError(
            "no readings of a gripper",
            where=where,
            fix="Expected columns, divided by commas: count, and one of opening_m, opening_cm, "
            "opening_mm.",
        ) from None
    return column.removeprefix("opening_"), _checked(pairs, _MODULUS, where), _MODULUS


def _checked(
    pairs: list[tuple[float, float]], modulus: int, where: Path
) -> list[tuple[float, float]]:
    for opening, count in pairs:
        # 0 is a reading like any other.
        if not 0 <= count < modulus or not math.isfinite(opening) or opening < 0:
            raise SourceError(
                f"opening {opening:g} with count {count:g} is no reading", where=where
            )
    return pairs


def _scale(
    openings: Sequence[float], stated: str, given: str | None
) -> tuple[float, tuple[str, ...]]:
    """Return metres a unit, and what there is to say about it."""
    for unit in (given, None if given else stated):
        if unit is not None and unit not in _UNITS:
            raise CalibrationRefusedError(
                f"openings in {unit!r}", fix=f"Say one of {', '.join(_UNITS)}."
            )
    if given is not None:
        said = () if given == stated else (f"openings are in {given}; the file says {stated}",)
        return _UNITS[given], said
    span = max(openings) - min(openings) if openings else 0.0
    possible = [
        unit for unit, scale in _UNITS.items() if _LEAST_TRAVEL_M <= span * scale <= _MOST_TRAVEL_M
    ]
    if stated in possible or len(possible) != 1:
        return _UNITS[stated], ()
    found = possible[0]
    return _UNITS[found], (
        f"the file says {stated}, which would be a travel of {1e3 * span * _UNITS[stated]:.3g} mm; "
        f"it holds {found}",
    )


def readings_at_rest(
    time_ns: NDArray[np.int64],
    counts: NDArray[np.integer],
    openings_m: Sequence[float],
    *,
    modulus: int | None = _MODULUS,
) -> GripperReadings:
    """Find the readings in a recording in which the gripper was set to openings, one by one.

    Parameters
    ----------
    time_ns : (N,) int64
        Strictly increasing.
    counts : (N,) int
    openings_m : sequence of float
        In the order in which they were set, metres; each was held for a second or more.
    modulus : int, optional
        Where the counts wrap; None where they hold their turns.

    Returns
    -------
    GripperReadings

    Raises
    ------
    CalibrationRefusedError
        The gripper rested another number of times.
    """
    steady = np.asarray(counts, np.int64) if modulus is None else unwrap(counts, modulus)
    rests = _rests(time_ns, steady)
    if len(rests) != len(openings_m):
        found = ", ".join(str(round(float(np.median(steady[rest])))) for rest in rests)
        raise CalibrationRefusedError(
            f"the gripper rested {len(rests)} times (counts {found or 'none'}), "
            f"{len(openings_m)} openings were named",
            fix="Hold each opening for two seconds, and move at once to the next one.",
        )
    groups = tuple(np.asarray(counts[rest], np.int64) for rest in rests)
    return GripperReadings(tuple(openings_m), groups, modulus)


def _rests(time_ns: NDArray[np.int64], steady: NDArray[np.int64]) -> list[slice]:
    """Return where the counts stay within a few for long enough; a drift ends a rest."""
    found: list[slice] = []
    start = 0
    low = high = int(steady[0]) if len(steady) else 0
    for i, value in enumerate([*steady.tolist(), None]):
        if value is not None and max(high, value) - min(low, value) <= _REST_COUNTS:
            low, high = min(low, value), max(high, value)
            continue
        if i > start and time_ns[i - 1] - time_ns[start] >= _REST_S * 1e9:
            found.append(slice(start, i))
        if value is not None:
            start, low, high = i, value, value
    return found
