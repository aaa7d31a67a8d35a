"""Touch: activity, references, saturated, dark, shifted, swapped and damaged images."""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from exumi_data.model.calibration import RIG_REFERENCE
from exumi_data.model.description import CalibrationItem
from exumi_data.model.streams import TactileStream
from exumi_data.tactile import pattern_difference, resembled_finger, thumbnail, to_grey
from exumi_data.time import NS_PER_S
from exumi_validators.context import EpisodeContext
from exumi_validators.findings import problem
from exumi_validators.frame_statistics import FrameStatistics, UInt8Array
from exumi_validators.registry import Finding, check
from exumi_validators.report import Skipped
from exumi_validators.touch_measures import (
    coarse,
    difference,
    median_image,
    shift_between,
    texture,
)
from exumi_validators.touch_pass import image_of, stored_rows

__all__ = [
    "active_share",
    "as_the_frames",
    "dark",
    "reference_fits",
    "saturated",
    "shifted",
    "swapped",
    "wrapped",
]

_REGIME_RULES = {"play": ("TACT-004", "TACT-013"), "demonstration": ("TACT-005",)}
_FEWEST = 3
_MIN_SHIFT_SIDE = 16
_NO_FRAMES = "no frames were decoded"
_NO_PAIR = "no reference, or too few frames"


def _tactile(episode: EpisodeContext) -> Iterator[str]:
    for name, stream in episode.streams.items():
        if isinstance(stream, TactileStream):
            yield name


# ---------------------------------------------------------------------------------------- activity


@dataclass(frozen=True, slots=True)
class _Active:
    """How many frames of a stream are active, of how many, from the first to the last."""

    active: int
    frames: int
    seconds: float


@check("TACT-004", "TACT-005", "TACT-013")
def active_share(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge the share of active frames against the regime."""
    rules = _REGIME_RULES.get(episode.section("regime") or "", ())
    for name in _tactile(episode) if rules else ():
        counted = _count_active(episode, name)
        for rule in rules:
            yield from _share_findings(episode, name, rule, counted)


def _count_active(episode: EpisodeContext, name: str) -> _Active | None:
    """Count the active frames of a stream; None where activity or its threshold is not stored."""
    item, count = episode.derived.get(f"{name}/activity"), episode.count(name)
    threshold = item.parameters.get("active_above") if item else None
    activity = stored_rows(episode, f"derived/{name}/activity", count) if count else None
    time = stored_rows(episode, f"streams/{name}/time", count) if count else None
    if activity is None or isinstance(threshold, bool) or not isinstance(threshold, int | float):
        return None
    seconds = 0.0 if time is None else (int(time[-1]) - int(time[0])) / NS_PER_S
    return _Active(int(np.count_nonzero(activity > threshold)), len(activity), seconds)


def _share_findings(
    episode: EpisodeContext, name: str, rule: str, counted: _Active | None
) -> Iterator[Finding]:
    path = f"derived/{name}/activity"
    if counted is None:
        yield Skipped(
            rule,
            "no stored activity with its threshold, which exumi prepare stores",
            f"streams/{name}",
        )
        return
    if counted.frames < episode.limit(rule, "frames"):
        yield Skipped(rule, "too few frames", path)
        return
    share = episode.limit(rule, "active_share")
    most = share * counted.frames
    if rule == "TACT-004":
        wrong, expected = counted.active < most, f"{share:.0%}"
    elif rule == "TACT-005":
        wrong = counted.active == 0 or counted.active > most
        expected = f"some, and at most {share:.0%}"
    else:
        if counted.seconds < episode.limit(rule, "seconds"):
            yield Skipped(rule, "too short for a pause to be expected", path)
            return
        wrong, expected = counted.active >= most, f"{share:.0%}"
    if wrong:
        seconds = f"{counted.seconds:.0f}"
        yield problem(
            rule,
            path,
            expected=expected,
            found=counted.active,
            frames=counted.frames,
            seconds=seconds,
        )


# ------------------------------------------------------------------------------------------ frames


def _statistics(
    episode: EpisodeContext, rule: str
) -> Iterator[tuple[str, str, FrameStatistics | Skipped]]:
    """Go through the tactile streams: name, path of the frames, and their statistics if any."""
    for name in _tactile(episode):
        path = f"streams/{name}/data"
        found = episode.frame_statistics.get(name)
        if found is None or not found.glanced:
            yield name, path, Skipped(rule, _NO_FRAMES, path)
        else:
            yield name, path, found


@check("TACT-007")
def saturated(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that frames are not white."""
    for _, path, found in _statistics(episode, "TACT-007"):
        if isinstance(found, Skipped):
            yield found
        elif found.saturated.count:
            tally = found.saturated
            detail = f"{tally.value:.0%}"
            yield problem(
                "TACT-007",
                path,
                index=tally.first,
                found=tally.count,
                frames=found.glanced,
                detail=detail,
            )


@check("TACT-008")
def dark(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that frames are not dark."""
    for _, path, found in _statistics(episode, "TACT-008"):
        if isinstance(found, Skipped):
            yield found
        elif found.dark.count:
            tally = found.dark
            yield problem(
                "TACT-008",
                path,
                index=tally.first,
                found=tally.count,
                frames=found.glanced,
                detail=round(tally.value, 1),
            )


@check("TACT-006")
def reference_fits(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that some frames resemble the reference."""
    limit = episode.limit("TACT-006", "median_grey_levels")
    for name, path, found in _statistics(episode, "TACT-006"):
        pair = _pair(found)
        if pair is None:
            yield found if isinstance(found, Skipped) else Skipped("TACT-006", _NO_PAIR, path)
            continue
        reference, quiet = pair
        levels = float(np.median(difference(quiet, reference)))
        if levels > limit:
            reference_path = f"streams/{name}/reference"
            yield problem("TACT-006", reference_path, expected=limit, found=round(levels, 1))


def _pair(found: FrameStatistics | Skipped) -> tuple[UInt8Array, UInt8Array] | None:
    """Return a stream's reference and the median of the frames that resemble it most."""
    if isinstance(found, Skipped) or found.reference is None or found.quiet is None:
        return None
    return found.reference, found.quiet


@check("TACT-014")
def as_the_frames(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that the reference has its sides and its colours as the frames have them."""
    for name, path, found in _statistics(episode, "TACT-014"):
        if isinstance(found, Skipped):
            yield found
            continue
        pair, colours = _pair(found), found.colours
        if pair is None:
            yield Skipped("TACT-014", _NO_PAIR, path)
            continue
        # The light tells the sides apart, and a pattern that is displaced does not disturb it.
        reference, quiet = (_light(episode, image) for image in pair)
        mirrored = np.ascontiguousarray(reference[:, ::-1])
        yield from _change_findings(episode, name, quiet, reference, mirrored, "mirrored")
        if colours is None or found.colours_of_reference is None:
            yield Skipped("TACT-014", "frames or reference have no colours", path)
            continue
        reference = found.colours_of_reference
        reversed_ = np.ascontiguousarray(reference[..., ::-1])
        detail = "with its channels reversed"
        yield from _change_findings(episode, name, colours, reference, reversed_, detail)


def _light(episode: EpisodeContext, image: UInt8Array) -> UInt8Array:
    """Average an image to the grid that references are compared on."""
    columns, rows = (max(1, int(episode.limit("TACT-012", n))) for n in ("columns", "rows"))
    return np.frombuffer(coarse(image, columns, rows), np.uint8).reshape(rows, columns)


def _change_findings(
    episode: EpisodeContext,
    name: str,
    image: UInt8Array,
    reference: UInt8Array,
    changed: UInt8Array,
    detail: str,
) -> Iterator[Finding]:
    """Judge that an image resembles the reference as it is, not changed in some way."""
    path, rule = f"streams/{name}/reference", "TACT-014"
    least = episode.limit(rule, "asymmetry_grey_levels")
    as_it_is, otherwise = (pattern_difference(image, each) for each in (reference, changed))
    # The references differ by at least as much as these two do: mostly nothing need be computed.
    if abs(otherwise - as_it_is) < least and pattern_difference(reference, changed) < least:
        yield Skipped(rule, f"{detail}, the reference looks the same", path)
    elif otherwise < episode.limit(rule, "difference_ratio") * as_it_is:
        expected, found = round(as_it_is, 1), round(otherwise, 1)
        yield problem(rule, path, expected=expected, found=found, detail=detail)


@check("TACT-009")
def shifted(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that frames and reference show the sensor at one place."""
    for name, path, found in _statistics(episode, "TACT-009"):
        pair = _pair(found)
        if pair is None:
            yield found if isinstance(found, Skipped) else Skipped("TACT-009", _NO_PAIR, path)
            continue
        reference, quiet = pair
        yield from _shift_findings(episode, name, reference, quiet)


def _shift_findings(
    episode: EpisodeContext, name: str, reference: UInt8Array, quiet: UInt8Array
) -> Iterator[Finding]:
    path, rule = f"streams/{name}/reference", "TACT-009"
    stream = episode.streams[name]
    assert isinstance(stream, TactileStream)  # noqa: S101  # that is what was asked for
    if min(reference.shape) < _MIN_SHIFT_SIDE:
        yield Skipped(rule, "too few pixels", path)
        return
    if texture(reference) < episode.limit(rule, "texture_grey_levels"):
        yield Skipped(rule, "too little texture", path)
        return
    shift = shift_between(reference, quiet)
    length = shift.length * stream.images.height / reference.shape[0]
    limit = episode.limit(rule, "shift_px")
    if length > limit and shift.left_over < episode.limit(rule, "left_over"):
        yield problem(rule, path, expected=limit, found=round(length, 1))


@check("TACT-011")
def wrapped(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that levels do not jump as those of wrapped differences do."""
    for _, path, found in _statistics(episode, "TACT-011"):
        if isinstance(found, Skipped):
            yield found
            continue
        of_pairs, of_steps = found.jumps.rates()
        if (
            int(found.jumps.jumps.max()) >= episode.limit("TACT-011", "jumps")
            and of_pairs > episode.limit("TACT-011", "jumps_per_10000")
            and of_steps > episode.limit("TACT-011", "jumps_per_step")
        ):
            yield problem("TACT-011", path, found=round(of_pairs, 1))


# ----------------------------------------------------------------------------------------- fingers


@check("TACT-010")
def swapped(episode: EpisodeContext) -> Iterator[Finding]:
    """Judge that no finger is another one, by the rig's own references."""
    references = _rig_references(episode)
    images = _typical(episode) if references else {}
    for name in _tactile(episode):
        path = f"streams/{name}/data"
        if not references:
            yield Skipped("TACT-010", "no references of the rig's fingers", path)
            continue
        if name not in images:
            yield Skipped("TACT-010", "too few frames were decoded", path)
            continue
        fitting = {
            other: reference
            for other, reference in references.items()
            if reference.shape == images[name].shape
        }
        if name not in fitting or len(fitting) < 2:
            yield Skipped("TACT-010", "no references of the rig's fingers", path)
            continue
        yield from _swap_findings(episode, name, images[name], fitting)


def _typical(episode: EpisodeContext) -> dict[str, UInt8Array]:
    """Return the median of the kept frames of each tactile stream."""
    found = {name: episode.frame_statistics.get(name) for name in _tactile(episode)}
    return {
        name: median_image(statistics.thumbnails.values())
        for name, statistics in found.items()
        if statistics is not None and len(statistics.thumbnails) >= _FEWEST
    }


def _rig_references(episode: EpisodeContext) -> dict[str, UInt8Array]:
    """Return the thumbnails of the rig's references by the name of the stream."""
    found = {}
    pixels = max(1, int(episode.limit("TACT-006", "thumbnail_pixels")))
    for pointer, item in episode.parts(CalibrationItem, "calibration"):
        key = str(pointer[-1])
        image = image_of(episode, item.array) if item.array else None
        if key.startswith(RIG_REFERENCE) and image is not None:
            found[key.removeprefix(RIG_REFERENCE)] = thumbnail(to_grey(image), pixels)
    return found


def _swap_findings(
    episode: EpisodeContext, name: str, image: UInt8Array, references: dict[str, UInt8Array]
) -> Iterator[Finding]:
    path = f"streams/{name}/data"
    found = resembled_finger(
        name,
        image,
        references,
        difference_ratio=episode.limit("TACT-010", "difference_ratio"),
        references_grey_levels=episode.limit("TACT-010", "references_grey_levels"),
    )
    if found is None:
        yield Skipped("TACT-010", "the rig's references look alike", path)
    elif found != name:
        yield problem("TACT-010", path, expected=name, found=found)
