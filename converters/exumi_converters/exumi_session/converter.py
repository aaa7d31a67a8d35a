"""Finding the demonstrations of raw exUMI sessions, and writing one of them."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import ValidationError

from exumi_converters.converter import ConvertOptions, Discovery, EpisodeSource, SourceFile
from exumi_converters.exumi_session.camera_stream import CAMERA_STREAM, add_clip
from exumi_converters.exumi_session.decoded import estimated_bytes
from exumi_converters.exumi_session.finger_stream import FingerFiles, add_finger
from exumi_converters.exumi_session.gripper import gripper_calibration, widths_of
from exumi_converters.exumi_session.hub import Hub, PoseSession, join_readings, read_hub
from exumi_converters.exumi_session.layout import (
    SIDES,
    Chunk,
    SessionFiles,
    find_sessions,
    holds_session,
)
from exumi_converters.exumi_session.options import SessionOptions
from exumi_converters.exumi_session.plan import ClipPlan, EpisodePlan, Latency, as_timestamp
from exumi_converters.exumi_session.readings_stream import add_readings
from exumi_converters.exumi_session.rig import rig_items
from exumi_converters.exumi_session.tables import read_angles
from exumi_converters.exumi_session.timing import (
    Late,
    SessionTiming,
    Told,
    find_timing,
    marker_settings,
)
from exumi_converters.format_options import FormatOptions, parse_options
from exumi_converters.identity import relative_name
from exumi_converters.report import Failure
from exumi_converters.source_folder import count_names
from exumi_data.calibration import add_intrinsics
from exumi_data.camera import from_open_camera_calibrator, resized
from exumi_data.clips.clip import Clip, list_frames, read_clip
from exumi_data.errors import ExumiError, SourceError, UsageError
from exumi_data.model import Device, Embodiment, QualityNote, Task
from exumi_data.model.calibration import Intrinsics
from exumi_data.model.documents import dump, load_json
from exumi_data.standard import sensors
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.synchronisation.matching import Match

__all__ = ["ExumiSessionConverter"]

_NS = 1_000_000_000
_SENSOR = "9dtact"
_MOST_INTRINSICS_BYTES = 1 << 20
# Readings around a clip that are looked at for its files: latencies are shorter.
_AROUND_NS = 500_000_000
# Of exUMI's own GoPro at 2704 by 2028. For a sweep any camera's gains are fitted.
_STAND_IN = Intrinsics(
    model="fisheye",
    width=2704,
    height=2028,
    fx=796.8544625226342,
    fy=799.2283,
    cx=1354.4265245977356,
    cy=1011.4847310011687,
    distortion=[-0.02196117964, -0.01895971702, 0.00169388083, -0.00016807229],
)


class ExumiSessionConverter:
    """Each demonstration that the GoPro filmed becomes an episode, every stream at its own rate.

    When clips, poses and frames were is found out from the session itself while it is looked
    through: that decodes the latency clip, and the tactile frames of a few grasps.
    """

    name = "exumi-session"
    version = "1"
    id_version = 1
    describes = "raw exUMI sessions: the hub's tactile_<date>_<time>/ beside the GoPro's videos"
    keeps: tuple[str, ...] = (
        "the videos' bytes, of the GoPro and of both fingers",
        "times of all samples as they were stamped, and what is known of how late the stamps are",
        "poses as the hub computed them, encoder counts with the map to widths",
        "gaps as gaps, repeated frames as such, files that cannot be read as notes",
    )
    loses: tuple[str, ...] = (
        "parts of the hub's recording that no clip shows",
        "sound and other tracks of the GoPro's files, where they are decoded",
        "what exUMI's pipeline made of the session (it is interpolated), and pickles",
    )
    options: type[FormatOptions] = SessionOptions

    def recognise(self, source: Path) -> str | None:
        """Recognise a session by the hub's folder, or a folder of sessions."""
        return holds_session(source)

    def discover(self, source: Path, options: ConvertOptions) -> Discovery:
        """Find the demonstrations, and out when everything was; see the class."""
        told = parse_options(SessionOptions, options.settings, self.name)
        if options.labels is not None:
            raise UsageError(
                "the format exumi-session takes no table of labels", where=options.labels
            )
        marker_settings(told)
        sessions = find_sessions(source)
        if not sessions:
            raise SourceError(
                "no session of an exUMI hub: no folder tactile_<date>_<time>",
                where=source,
                fix="Copy the hub's folder beside raw_videos/. What exUMI's pipeline makes of a "
                "session (dataset.zarr.zip) is read with --from umi.",
            )
        items: list[EpisodeSource] = []
        failed: list[Failure] = []
        notices: list[str] = []
        for files in sessions:
            name = relative_name(files.root, source)
            prefix = "" if name == "." else f"{name}: "
            try:
                one = _discover_one(files, source, told, options)
            except SourceError as error:
                failed.append(Failure(name if name != "." else source.name, str(error)))
                continue
            items += one.items
            failed += one.failed
            notices += [f"{prefix}{text}" for text in one.notices]
        return Discovery(
            layout=f"exumi-session: {len(sessions)} session(s) with {len(items)} demonstration(s)",
            items=tuple(sorted(items, key=lambda item: item.key)),
            notices=tuple(notices),
            failed=tuple(failed),
        )

    def convert(self, item: EpisodeSource, writer: EpisodeWriter) -> int:
        """Write one demonstration."""
        plan = EpisodePlan.model_validate(item.settings["plan"])
        inputs = writer.metadata.source.inputs or []
        by_role: dict[str, list[int]] = {}
        for index, role in enumerate(item.settings["roles"]):
            by_role.setdefault(role, []).append(index)
        clip = by_role["clip"][0]
        path = item.files[clip].path
        frames = list_frames(path, Path(item.files[clip].name).name, sha256=inputs[clip].sha256)
        writer.metadata.start = as_timestamp(plan.start_ns)
        writer.metadata.device = Device(name="exumi")
        writer.metadata.embodiment = Embodiment(name="exumi", gripper="parallel")
        count = add_clip(writer, plan, path, frames)
        _add_intrinsics(writer, item.settings["intrinsics"], frames.width, frames.height)
        _add_angles(item, by_role.get("angle", []), plan, writer)
        for side in SIDES:
            rows = by_role.get(side, [])
            chunks = [
                FingerFiles(
                    item.settings["numbers"][video],
                    item.files[table].path,
                    item.files[video].path,
                    inputs[video],
                )
                for table, video in zip(rows[::2], rows[1::2], strict=True)
            ]
            if item.settings["has"][side]:
                count += add_finger(writer, plan, side, chunks)
        if plan.rig:
            writer.metadata.calibration.update(rig_items())
        return count


def _add_angles(
    item: EpisodeSource, rows: Sequence[int], plan: EpisodePlan, writer: EpisodeWriter
) -> None:
    parts, lost = [], []
    count, before = 0, None
    for row in rows:
        readings = read_angles(item.files[row].path)
        stamps = readings.time_ns
        inside = (stamps >= plan.start_ns - _AROUND_NS) & (stamps < plan.stop_ns + _AROUND_NS)
        number = item.settings["numbers"][row]
        if before is not None and number != before + 1:
            lost.append((count - 1, "a file of the hub is missing or cannot be read"))
        before = number
        parts.append(readings.part(inside))
        count += int(inside.sum())
    readings = join_readings(parts)
    if not len(readings.time_ns):
        raise SourceError(
            "the hub has no reading of the time of this clip", where=item.files[0].path
        )
    add_readings(writer, plan, readings, lost)


def _add_intrinsics(
    writer: EpisodeWriter, stated: dict[str, Any] | None, width: int, height: int
) -> None:
    if stated is None:
        return
    camera = Intrinsics.model_validate(stated)
    if abs(camera.width * height - camera.height * width) > max(camera.width, camera.height):
        writer.metadata.quality.append(
            QualityNote(
                code="intrinsics-not-used",
                message=f"the camera's intrinsics hold for images of {camera.width}x"
                f"{camera.height}, which these are no smaller or larger form of",
                stream=CAMERA_STREAM,
            )
        )
        return
    fitted = (
        camera
        if (camera.width, camera.height) == (width, height)
        else resized(camera, width, height)
    )
    add_intrinsics(writer, CAMERA_STREAM, fitted, method="OpenImuCameraCalibrator, as given")


@dataclass(slots=True)
class _Found:
    items: list[EpisodeSource]
    failed: list[Failure]
    notices: list[str]


def _discover_one(
    files: SessionFiles, source: Path, told: SessionOptions, options: ConvertOptions
) -> _Found:
    """Find the demonstrations of one session."""
    hub = read_hub(files)
    epoch_ns = hub.span_ns[0] // _NS * _NS
    session = PoseSession(hub.readings, epoch_ns)
    gripper, said = gripper_calibration(told.gripper, files.gripper)
    camera, camera_said = _intrinsics(told.intrinsics, files.intrinsics)
    widths, invalid, _ = widths_of(gripper, session.counts)
    openings = np.where(invalid, np.nan, widths.astype(np.float64))
    clips, failed = _read_clips(files.clips, source)
    calibration, broken = _read_clips(files.latency_clips, source)
    serials = {
        relative_name(path, source): files.camera_of(path)
        for path in (*files.clips, *files.latency_clips)
    }
    timing = find_timing(
        Told(hub, session, epoch_ns, openings),
        clips,
        calibration,
        serials,
        camera or _STAND_IN,
        told,
    )
    failed += [
        Failure(name, f"its place in the hub's recording is not certain: {reason}")
        for name, reason in timing.refused.items()
    ]
    notices = [*said, *camera_said, *timing.notices, *_notices(files, hub, source)]
    notices += [f"{failure.name} does not calibrate: {failure.reason}" for failure in broken]
    if not files.latency_clips or timing.calibrated is None:
        notices.append(
            "no latency clip calibrates this session: how late poses are is "
            + ("as stated" if told.pose_latency_ms is not None else "assumed")
        )
    if gripper is None:
        notices.append(
            "there is no calibration of the gripper: counts are kept, widths are not known "
            "(-o gripper=gripper_calibration.json)"
        )
    maker = _Maker(files, hub, timing, told, options, source, epoch_ns)
    shared = {
        "intrinsics": None if camera is None else dump(camera),
        "gripper": None if gripper is None else dump(gripper),
    }
    items = [
        maker.item(name, clips[name], match, serials[name], shared)
        for name, match in timing.places.items()
    ]
    return _Found(items, failed, notices)


def _read_clips(paths: Sequence[Path], source: Path) -> tuple[dict[str, Clip], list[Failure]]:
    read, failed = {}, []
    for path in paths:
        name = relative_name(path, source)
        try:
            read[name] = read_clip(path, name)
        except ExumiError as error:
            failed.append(Failure(name, str(error)))
        except OSError as error:
            failed.append(Failure(name, f"{name}: {error.strerror or error}"))
    return read, failed


def _intrinsics(named: Path | None, lying: Sequence[Path]) -> tuple[Intrinsics | None, list[str]]:
    said: list[str] = []
    for path in [named] if named is not None else lying:
        try:
            size = path.stat().st_size
            raw = path.read_bytes() if size <= _MOST_INTRINSICS_BYTES else b""
            return from_open_camera_calibrator(load_json(raw, path)), said
        except (OSError, ExumiError, ValueError, TypeError, KeyError, ValidationError) as error:
            if named is not None:
                raise UsageError(f"no intrinsics of a camera ({error})", where=path) from None
            said.append(f"{path.name} is not used: no intrinsics of a camera")
    return None, said


def _notices(files: SessionFiles, hub: Hub, source: Path) -> Iterator[str]:
    for problem in hub.problems:
        yield f"{relative_name(problem.path, source)} was left out: {problem.reason}"
    for what, paths in (
        ("chunk(s) that repeat another one, not read", hub.repeated),
        ("file(s) of a finger without their other half, not read", files.alone),
        (
            "pickle(s) or NumPy file(s), never loaded: markers are found again from the video, and "
            "plans are not needed",
            files.pickles,
        ),
        ("product(s) of exUMI's pipeline, not read", files.made),
        ("other file(s), not read", files.foreign),
    ):
        if paths:
            yield count_names(what, source, paths)
    if hub.far_away:
        yield (
            f"{hub.far_away} reading(s) are stamped hours away from all others: the hub's clock "
            "was not set, and nothing tells when they were"
        )
    if hub.steps_back:
        yield f"the hub's clock went back {hub.steps_back} time(s)"


@dataclass(frozen=True, slots=True)
class _Maker:
    """Makes the items of a session."""

    files: SessionFiles
    hub: Hub
    timing: SessionTiming
    told: SessionOptions
    options: ConvertOptions
    source: Path
    epoch_ns: int

    def item(
        self,
        name: str,
        clip: Clip,
        match: Match,
        serial: str | None,
        shared: dict[str, Any],
    ) -> EpisodeSource:
        """Make the item of one clip."""
        place, pose = match.placement, self.timing.pose
        assert place is not None  # noqa: S101  # only placed clips come here
        margin = round(self.told.margin_s * _NS)
        base = self.epoch_ns - pose.latency_ns
        start = base + place.to_session(0) - margin
        stop = base + place.to_session(round(clip.duration_s * _NS)) + margin
        variance = place.sigma_s**2 + place.camera_sigma_s**2
        variance += (clip.gyro.sigma_s if clip.gyro else 0.0) ** 2
        variance += ((pose.sigma_ns or 0) / _NS) ** 2
        plan = EpisodePlan(
            start_ns=start,
            stop_ns=stop,
            clip=ClipPlan(
                offset_ns=base + place.offset_ns,
                t_ref_ns=place.t_ref_ns,
                drift_ppm=round(place.drift_ppm, 4),
                drift_sigma_ppm=None
                if place.drift_sigma_ppm is None
                else round(place.drift_sigma_ppm, 4),
                sigma_ns=round(variance**0.5 * _NS),
                method=_method(match, self.timing),
                camera=serial,
                model=_camera_model(clip),
            ),
            pose=_latency(pose),
            fingers={side: _latency(late) for side, late in self.timing.fingers.items()},
            sensor=self.options.sensor or _SENSOR,
            gripper=shared["gripper"],
            rig=self.told.rig == "exumi",
            decode=self.told.decode,
            quality=self.told.quality,
        )
        chosen = list(self._files(clip, start, stop))
        return EpisodeSource(
            key=name,
            files=tuple(
                SourceFile(path, relative_name(path, self.source), identifies=role == "clip")
                for role, _, path in chosen
            ),
            task=Task(name=self.options.task),
            licence=self.options.licence,
            regime="demonstration",
            settings={
                "plan": dump(plan),
                "roles": [role for role, _, _ in chosen],
                "numbers": [number for _, number, _ in chosen],
                "has": {side: bool(self.hub.fingers.get(side)) for side in SIDES},
                "intrinsics": shared["intrinsics"],
            },
            quality=tuple(self._quality(match, clip, start + margin, stop - margin)),
            derived=None if self.told.decode else (),
            estimated_bytes=estimated_bytes(path for _, _, path in chosen if path.suffix != ".json")
            if self.told.decode
            else None,
        )

    def _files(self, clip: Clip, start: int, stop: int) -> Iterator[tuple[str, int, Path]]:
        """Yield role, number and path of the files that hold any of an episode's time."""
        first, last = start - _AROUND_NS, stop + _AROUND_NS
        yield "clip", 0, clip.path
        for piece in self.hub.angle_chunks:
            if piece.holds(first, last):
                yield "angle", piece.chunk.order[1], piece.chunk.table
        for side in SIDES:
            for piece in self.hub.fingers.get(side, []):
                if piece.holds(first, last):
                    yield from _halves(side, piece.chunk)

    def _quality(self, match: Match, clip: Clip, start: int, stop: int) -> Iterator[QualityNote]:
        for doubt in match.doubts:
            yield QualityNote(code="doubtful-place", message=doubt)
        if clip.gyro is not None and clip.gyro.problem:
            yield QualityNote(code="telemetry", message=clip.gyro.problem, severity="info")
        first, last = self.hub.span_ns
        outside = max(first - start, stop - last)
        if outside > _NS // 10:
            message = f"{outside / _NS:.1f} s of the clip lie outside of the hub's recording"
            yield QualityNote(code="session-short", message=message)
        if self.timing.pose.method.startswith("assumed"):
            yield QualityNote(
                code="pose-latency-assumed",
                message=f"how late poses and pictures are against touch and width is assumed: "
                f"{self.timing.pose.latency_ns / 1e6:.0f} ms, give or take "
                f"{(self.timing.pose.sigma_ns or 0) / 1e6:.0f}",
            )
        for side in SIDES:
            late = self.timing.fingers.get(side)
            if self.hub.fingers.get(side) and late is not None and late.sigma_ns is None:
                message = f"no grasps tell how late the stamps of the {side} finger are"
                yield QualityNote(code="touch-latency-unknown", message=message, severity="info")


def _halves(side: str, chunk: Chunk) -> Iterator[tuple[str, int, Path]]:
    assert chunk.video is not None  # noqa: S101  # chunks of fingers have one
    yield side, chunk.order[1], chunk.table
    yield side, chunk.order[1], chunk.video


def _latency(late: Late) -> Latency:
    return Latency(latency_ns=late.latency_ns, sigma_ns=late.sigma_ns, method=late.method)


def _method(match: Match, timing: SessionTiming) -> str:
    place = match.placement
    assert place is not None  # noqa: S101  # only placed clips come here
    said = f"{place.method}"
    if place.correlation:
        said += f": correlation with the poses {place.correlation:.3f}"
    said += f"; by itself {1e3 * place.sigma_s:.2f} ms"
    if timing.calibrated is not None:
        said += f"; pictures brought into step by {timing.calibrated}"
    return f"{said}; poses are {timing.pose.latency_ns / 1e6:.1f} ms late"


def _camera_model(clip: Clip) -> str | None:
    said = "".join(filter(str.isalnum, clip.gyro.device.casefold() if clip.gyro else ""))
    for name, model in sensors().items():
        if model.maker == "GoPro" and name.removeprefix("gopro-") in said:
            return name
    return None
