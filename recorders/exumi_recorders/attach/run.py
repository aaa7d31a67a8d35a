"""Attach a folder of clips to the session in which they were filmed."""

import errno
import re
import time
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from pathlib import Path

from pydantic import ValidationError

from exumi_data._version import __version__
from exumi_data.clips.clip import Clip, find_clips, list_frames, read_clip
from exumi_data.clips.markers import MarkerSettings
from exumi_data.clips.sweeps import find_sweep
from exumi_data.episode import Episode, open_episode
from exumi_data.errors import ExumiError, MetadataError, UsageError
from exumi_data.model import UNKNOWN_LICENCE, DatasetMetadata, MadeBy
from exumi_data.model.base import STREAM_NAME
from exumi_data.model.calibration import INTRINSICS, Intrinsics
from exumi_data.model.documents import problems_of
from exumi_data.synchronisation.matching import Candidate, Match, match_clips
from exumi_data.synchronisation.motion import Turning, of_gyro, of_pose_stream
from exumi_data.synchronisation.sweep import MarkerTrack
from exumi_recorders.attach.destination import Destination, opened
from exumi_recorders.attach.missing import skipped_numbers, uncovered
from exumi_recorders.attach.poses import PoseReader
from exumi_recorders.attach.report import AttachReport, ClipReport, MissingReport, Status
from exumi_recorders.attach.sessions import find_sessions, pose_stream
from exumi_recorders.attach.writing import (
    DOUBTFUL,
    TOOL,
    Attachment,
    describe,
    notes_on,
    offset_sigma_s,
    write_episode,
)
from exumi_recorders.calibration.files import read_calibration

__all__ = ["AttachOptions", "attach"]

_MOST_SESSION_S = 48 * 3600.0
_NAME = re.compile(STREAM_NAME)
_NO_INTRINSICS = (
    "it has no gyroscope, and is not searched for a sweep before a marker: no intrinsics/{0.stream}"
    " says how its camera sees (exumi calibrate camera, then --calibration FILE)"
)

OnProgress = Callable[[str, int, int], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class AttachOptions:
    """How clips are attached.

    Attributes
    ----------
    sessions : tuple of str
        Ids, where the dataset holds several.
    pose : str or None
        The pose stream of the hand that carries the camera, if it is not clear which.
    stream : str
        What the clips' stream is called.
    margin_s : float
        How much of the session is kept before and after each clip, seconds.
    without : tuple of str
        Streams of the session to leave out.
    calibration : pathlib.Path or None
        A calibration file with the camera's intrinsics, by which clips without a gyroscope are
        placed. Default: what the session says.
    marker : MarkerSettings
        What was swept past in those clips.
    check_frames : bool
        Decode every frame of a clip, and list only those that can be.
    dry_run : bool
        Write nothing.
    durable : bool
        Make every episode survive a power loss before it appears.
    """

    sessions: tuple[str, ...] = ()
    pose: str | None = None
    stream: str = "rgb"
    margin_s: float = 0.5
    without: tuple[str, ...] = ()
    calibration: Path | None = None
    marker: MarkerSettings = field(default_factory=MarkerSettings)
    check_frames: bool = False
    dry_run: bool = False
    durable: bool = True


@dataclass(slots=True)
class _Session:
    """A session with the clips that were found to be of it."""

    episode: Episode
    pose: str
    turning: Turning
    poses: PoseReader
    matches: list[Match] = field(default_factory=list)


def attach(
    clips: str | Path,
    session: str | Path,
    destination: str | Path,
    *,
    options: AttachOptions | None = None,
    on_progress: OnProgress | None = None,
) -> AttachReport:
    """Cut a session into one episode a clip, the clip verbatim in each.

    A clip is placed by its camera's gyroscope against the hand's poses; one without, by a sweep
    before a marker. What is not certain is refused, with the reason. Run again, it goes on where it
    was stopped.

    Parameters
    ----------
    clips : path-like
        A folder of clips, or one clip. Only read.
    session : path-like
        The episode that the hub recorded, or a dataset that holds it. Only read.
    destination : path-like
        The dataset: a new or empty folder, or one to go on with.
    options : AttachOptions, optional
    on_progress : callable, optional
        Told what is done, how many clips are, and of how many.

    Returns
    -------
    AttachReport

    Raises
    ------
    UsageError, NotAnEpisodeError
        An option, the clips, the session or the destination make no sense as a whole.
    DamagedDataError
        The session cannot be read.
    """
    began = time.perf_counter()
    options = options or AttachOptions()
    if not 0 <= options.margin_s <= 60:
        raise UsageError(f"Invalid margin ({options.margin_s:g}). It is 0 to 60 seconds")
    if not _NAME.fullmatch(options.stream):
        raise UsageError(
            f"{options.stream!r} is no name of a stream",
            fix="Names are lower-case letters, digits and _, and begin with a letter.",
        )
    source, session, destination = Path(clips), Path(session), Path(destination)
    tell = on_progress or (lambda _what, _done, _total: None)
    with ExitStack() as stack:
        sessions = [
            _open_session(path, options, stack)
            for path in find_sessions(session, options.sessions, options.stream)
        ]
        read, failed = _read_clips(source, tell)
        left = _match(sessions, _candidates(read, sessions, options, tell), read)
        notices = _notices(sessions)
        if options.dry_run:
            placed = [_report(*found, "placed") for found in _placed(sessions, read)]
        else:
            placed, problems = _write_all(sessions, read, destination, options, tell)
            notices += problems
        reports = sorted((*failed, *left, *placed), key=lambda report: report.name)
        return AttachReport(
            destination=str(destination),
            sessions=tuple(one.episode.id for one in sessions),
            clips=tuple(reports),
            missing=tuple(
                MissingReport(one.episode.id, stretch.start_s, stretch.stop_s)
                for one in sessions
                for stretch in uncovered(one.turning, one.matches)
            ),
            notices=tuple(notices),
            dry_run=options.dry_run,
            seconds=time.perf_counter() - began,
        )


def _open_session(path: Path, options: AttachOptions, stack: ExitStack) -> _Session:
    episode = stack.enter_context(open_episode(path))
    episode.check_complete()
    if options.stream in episode and options.stream not in options.without:
        raise UsageError(
            f"has a stream {options.stream!r} already",
            where=path,
            fix="Call the clips' stream something else with --stream NAME.",
        )
    for name in options.without:
        episode[name]  # it is an error to leave out what is not there
    pose = pose_stream(episode, options.pose)
    length_s = float(pose.time[-1] - pose.time[0]) * 1e-9 if len(pose) else 0.0
    if not 0 < length_s < _MOST_SESSION_S:
        raise UsageError(
            f"its stream {pose.name!r} covers {length_s / 3600:.3g} h, sessions at most "
            f"{_MOST_SESSION_S / 3600:g} h",
            where=path,
        )

    poses = PoseReader(episode, pose)
    return _Session(episode, pose.name, of_pose_stream(pose, poses.rows), poses)


def _read_clips(source: Path, tell: OnProgress) -> tuple[dict[str, Clip], list[ClipReport]]:
    paths = find_clips(source)
    root = source if source.is_dir() else source.parent
    read, failed = {}, []
    for done, path in enumerate(paths):
        tell("Reading clips", done, len(paths))
        name = path.relative_to(root).as_posix()
        try:
            read[name] = read_clip(path, name)
        except (ExumiError, OSError) as error:
            failed.append(ClipReport(name=name, status="failed", reason=str(error)))
    return read, failed


def _match(
    sessions: Sequence[_Session], todo: list[Candidate], clips: dict[str, Clip]
) -> list[ClipReport]:
    """Place every clip in the first session that it fits; report those that fit none."""
    reasons: dict[str, list[str]] = {name: [] for name in clips}
    for session in sessions:
        session.matches, _ = match_clips(session.turning, todo, session.poses)
        for match in session.matches:
            where = f"{session.episode.id}: " if len(sessions) > 1 else ""
            if match.placement is None:
                reasons[match.clip.name].append(where + match.reason)
        todo = [match.clip for match in session.matches if match.placement is None]
    return [
        ClipReport(
            name=clip.name,
            status="refused",
            duration_s=clips[clip.name].duration_s,
            reason="; ".join(dict.fromkeys(reasons[clip.name])),
        )
        for clip in todo
    ]


def _candidates(
    clips: dict[str, Clip], sessions: Sequence[_Session], options: AttachOptions, tell: OnProgress
) -> list[Candidate]:
    """Return what clips are placed by; the frames of those without a gyroscope are looked at."""
    silent = [name for name, clip in clips.items() if clip.gyro is None]
    camera = _camera(sessions, options) if silent else None
    markers: dict[str, MarkerTrack | str] = dict.fromkeys(silent, _NO_INTRINSICS.format(options))
    for done, name in enumerate(silent if camera else ()):
        tell("Looking for sweeps", done, len(silent))
        assert camera is not None  # noqa: S101  # there would be nothing to go through
        markers[name] = find_sweep(clips[name].path, camera, options.marker)
    return [
        Candidate(
            name=name,
            turning=None if clip.gyro is None else of_gyro(clip.gyro),
            start_ns=0,
            stop_ns=round(clip.duration_s * 1e9),
            clock_s=clip.clock_s,
            number=clip.number,
            marker=markers.get(name),
        )
        for name, clip in clips.items()
    ]


def _camera(sessions: Sequence[_Session], options: AttachOptions) -> Intrinsics | None:
    """Return how the clips' camera sees: by the file that is named, else by the first session."""
    name = INTRINSICS + options.stream
    if options.calibration is not None:
        items = read_calibration(options.calibration).items
        if name not in items:
            raise UsageError(f"has no {name}", where=options.calibration)
        return _intrinsics(items[name].value, options.calibration)
    for session in sessions:
        item = session.episode.metadata.calibration.get(name)
        if item is not None:
            return _intrinsics(item.value, session.episode.path)
    return None


def _intrinsics(value: object, where: object) -> Intrinsics:
    try:
        return Intrinsics.model_validate(value)
    except ValidationError as error:
        raise MetadataError(
            f"its intrinsics are none: {'; '.join(text for text, _ in problems_of(error))}",
            where=where,
        ) from None


def _placed(
    sessions: Sequence[_Session], clips: dict[str, Clip]
) -> list[tuple[_Session, Match, Clip]]:
    return [
        (session, match, clips[match.clip.name])
        for session in sessions
        for match in session.matches
        if match.placement is not None
    ]


def _notices(sessions: Sequence[_Session]) -> list[str]:
    notices = []
    for session in sessions:
        numbers = skipped_numbers(session.matches)
        if numbers:
            listed = ", ".join(f"{number:04d}" for number in numbers[:10])
            notices.append(
                f"the camera counted {len(numbers)} recording(s) that are not here: {listed}"
            )
    return notices


def _report(session: _Session, match: Match, clip: Clip, status: Status) -> ClipReport:
    placement = match.placement
    assert placement is not None  # noqa: S101  # only placed clips come here
    pose = session.episode[session.pose]
    return ClipReport(
        name=clip.name,
        status=status,
        duration_s=clip.duration_s,
        session=session.episode.id,
        start_s=match.start_ns * 1e-9,
        sigma_s=offset_sigma_s(pose, clip, placement),
        drift_ppm=placement.drift_ppm or None,
        correlation=placement.correlation,
        doubts=tuple(match.doubts),
    )


def _write_all(
    sessions: Sequence[_Session],
    clips: dict[str, Clip],
    destination: Path,
    options: AttachOptions,
    tell: OnProgress,
) -> tuple[list[ClipReport], list[str]]:
    """Write the episodes of all clips that were placed; return their reports, and notices."""
    todo = _placed(sessions, clips)
    if not todo:
        return [], []
    reports = []
    with opened(destination, _dataset_metadata(destination, sessions, options)) as dataset:
        digests: dict[str, str] = {}
        for done, (session, match, clip) in enumerate(todo):
            tell("Attaching clips", done, len(todo))
            report = _report(session, match, clip, "attached")
            try:
                reports.append(_write_one(session, match, clip, report, options, dataset, digests))
            except ExumiError as error:
                reports.append(replace(report, status="failed", reason=str(error)))
            except OSError as error:
                if error.errno == errno.ENOSPC:
                    raise
                reports.append(
                    replace(report, status="failed", reason=error.strerror or str(error))
                )
        return reports, [*dataset.cleaned, *dataset.refresh_catalog()]


def _write_one(  # what, from where, and whereto
    session: _Session,
    match: Match,
    clip: Clip,
    report: ClipReport,
    options: AttachOptions,
    dataset: Destination,
    digests: dict[str, str],
) -> ClipReport:
    episode = session.episode
    frames = list_frames(clip.path, clip.path.name, check=options.check_frames)
    if episode.id not in digests:
        digests[episode.id] = episode.digest()
    attachment = Attachment(
        session=episode,
        session_digest=digests[episode.id],
        pose=session.pose,
        stream=options.stream,
        margin_ns=round(options.margin_s * 1e9),
        without=options.without,
        clip=clip,
        frames=frames,
        match=match,
    )
    metadata = describe(attachment)
    notes = [note for note in notes_on(attachment) if note.code != DOUBTFUL]
    said = tuple(note.message.removeprefix(f"{clip.name}: ") for note in notes)
    report = replace(report, episode=metadata.id, notes=said)
    if dataset.is_current(metadata):
        return replace(report, status="present")
    write_episode(attachment, metadata, dataset.path_of(metadata), durable=options.durable)
    dataset.drop_packed(metadata)
    return report


def _dataset_metadata(
    destination: Path, sessions: Sequence[_Session], options: AttachOptions
) -> DatasetMetadata:
    licences = {session.episode.metadata.licence for session in sessions}
    return DatasetMetadata(
        name=destination.resolve().name,
        licence=licences.pop() if len(licences) == 1 else UNKNOWN_LICENCE,
        made_by=MadeBy(
            tool=TOOL,
            tool_version=__version__,
            settings={"stream": options.stream, "margin_s": options.margin_s},
        ),
    )
