"""What is demanded of every spoiled store: a report or our own error, and the same of reading."""

import re
import traceback
import warnings
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path

import numpy as np

import exumi_data
from exumi_data.errors import ExumiError
from exumi_data.model.episode import DerivedMetadata
from exumi_data.model.images import EncodedImages, VideoImages
from exumi_data.splits import make_split
from exumi_validators import validate

__all__ = ["Verdict", "judge"]

_CODE = re.compile(r"[A-Z]+-\d{3}")
_FRAMES = 50


@dataclass
class Verdict:
    """What became of one store."""

    exit_code: int = 2
    codes: list[str] = field(default_factory=list)
    message: str = ""
    refused: int = 0
    mistakes: list[str] = field(default_factory=list)


def judge(path: Path) -> Verdict:
    """Validate a store and read all of it."""
    verdict = Verdict()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        # What was not expected is not passed over in silence.
        warnings.simplefilter("error", RuntimeWarning)
        _validate(path, verdict)
        _read(path, verdict)
    return verdict


def _validate(path: Path, verdict: Verdict) -> None:
    try:
        report = validate(path, workers=1)
        text, _ = report.to_text(), report.to_json()
    except ExumiError as error:
        verdict.message = str(error)
        if not error.what or "\n" in error.what:
            verdict.mistakes.append(f"no clear message: {error.what!r}")
        return
    except Exception:  # noqa: BLE001  # that is what is looked for
        verdict.mistakes.append(traceback.format_exc())
        return
    verdict.exit_code = report.exit_code
    verdict.codes = sorted(report.codes())
    if report.exit_code == 1 and not report.count("error") and not report.coverage.unchecked:
        verdict.mistakes.append("invalid without an error")
    for item in report.coverage.unchecked:
        # A check that fails is named by its rules.
        stopped = item.reason.startswith("TooManyFindingsError")
        if (_CODE.search(item.what) or item.what == "the episode") and not stopped:
            verdict.mistakes.append(f"unchecked: {item}")
    if any(not line.isprintable() for line in text.splitlines()):
        verdict.mistakes.append("the report holds what cannot be printed")


def _attempt(step: Callable[[], object], verdict: Verdict) -> object:
    try:
        return step()
    except ExumiError:
        verdict.refused += 1
    except Exception:  # noqa: BLE001  # that is what is looked for
        verdict.mistakes.append(traceback.format_exc())
    return None


def _read(path: Path, verdict: Verdict) -> None:
    opened = _attempt(lambda: exumi_data.open(path), verdict)
    if isinstance(opened, exumi_data.Dataset):
        _attempt(lambda: opened.splits, verdict)
        _attempt(lambda: opened.fingerprint, verdict)
        _attempt(lambda: make_split(opened), verdict)
        for index in range(min(len(opened), 10)):
            episode = _attempt(partial(opened.__getitem__, index), verdict)
            if isinstance(episode, exumi_data.Episode):
                _read_episode(episode, verdict)
    elif isinstance(opened, exumi_data.Episode):
        _read_episode(opened, verdict)


def _read_episode(episode: exumi_data.Episode, verdict: Verdict) -> None:
    with episode:
        steps: list[Callable[[], object]] = [
            episode.check_complete,
            episode.digest,
            lambda: episode.duration_s,
            lambda: episode.derived,
        ]
        for name in episode.streams:
            steps += _steps(episode, name)
        for step in steps:
            _attempt(step, verdict)
        derived = _attempt(lambda: episode.derived, verdict)
        for key in derived.items if isinstance(derived, DerivedMetadata) else ():
            _attempt(partial(episode.derived_array, key), verdict)


def _steps(episode: exumi_data.Episode, name: str) -> list[Callable[[], object]]:
    stream = episode[name]
    steps: list[Callable[[], object]] = [
        lambda: len(stream),
        lambda: stream.time,
        lambda: stream.activity,
        lambda: stream.salient,
        *(partial(stream.array, array) for array in stream.metadata.arrays),
    ]
    if stream.is_image:
        steps += [partial(_frame, stream, index) for index in range(_FRAMES)]
        steps.append(lambda: stream.frames.read(range(min(len(stream), 3)), grey=True))
    images = getattr(stream.metadata, "images", None)
    if isinstance(images, EncodedImages):
        steps.append(lambda: stream.encoded(0) if len(stream) else None)
    if isinstance(images, VideoImages):
        steps += [partial(stream.container, file) for file in range(min(len(images.files), 3))]
    return steps


def _frame(stream: exumi_data.StreamView, index: int) -> np.ndarray | None:
    return stream.frames[index] if index < len(stream) else None
