"""Small parts: unknown keys, licences, frozen frames, nominal grids."""

from fractions import Fraction

import numpy as np
import pytest

from exumi_data.time import nominal_times
from exumi_validators.checks.time import off_grid
from exumi_validators.document_rules import is_real_date, is_spdx_expression
from exumi_validators.frozen import FrozenFrames
from exumi_validators.schema_walk import unknown_keys
from exumi_validators.video_file import looks_like

CLOCK = {"source": "x", "stamp_point": "unknown"}


def keys(document: dict[str, object], name: str = "episode") -> list[tuple[int | str, ...]]:
    return list(unknown_keys(name, document))


def test_unknown_keys_are_found_at_every_depth() -> None:
    document = {
        "colour": 1,
        "acme:fine": 1,
        "task": {"name": 3, "nam": 1},
        "streams": {
            "a": {"kind": "rgb", "images": {"encoding": "video", "files": [{"nme": 1}], "x": 1}},
            "b": {"kind": "acme:thing", "frames": {}},
            "c": {"kind": "nobody knows", "whatever": 1},
            "d": {"kind": "pose", "clock": {**CLOCK, "drift": 1}, "frames": None},
            "e": 3,
        },
        "source": {"settings": {"free": 1}, "lossy": [{"step": "x"}, {"stp": 1}]},
        "calibration": {"any name": {"value": {"free": 1}, "sigma": 1}},
        "annotations": {"labels": [{"value": 1, "weight": 2}]},
        "quality": "not a list",
    }
    assert keys(document) == [
        ("colour",),
        ("task", "nam"),
        ("streams", "a", "images", "files", 0, "nme"),
        ("streams", "a", "images", "x"),
        ("streams", "b", "frames"),
        ("streams", "d", "clock", "drift"),
        ("source", "lossy", 1, "stp"),
        ("calibration", "any name", "sigma"),
        ("annotations", "labels", 0, "weight"),
    ]


@pytest.mark.parametrize("key", ["Vendor:x", "v:", ":x", "v:x\n", "v x:y"])
def test_what_only_looks_like_an_extension(key: str) -> None:
    assert keys({key: 1}) == [(key,)]


def test_other_documents_are_walked_too() -> None:
    assert keys({"lists": {"train": []}, "sed": 1}, "split") == [("sed",)]
    assert keys({"made_by": {"tol": 1}}, "dataset") == [("made_by", "tol")]
    assert keys({"items": {"a/b": {"paramters": {}}}}, "derived") == [("items", "a/b", "paramters")]


@pytest.mark.parametrize(
    ("licence", "fine"),
    [
        ("CC-BY-4.0", True),
        ("NOASSERTION", True),
        ("LicenseRef-acme", True),
        ("DocumentRef-x:LicenseRef-y", True),
        ("Apache-2.0 OR MIT", True),
        ("(LGPL-2.1-only OR MIT) AND BSD-3-Clause", True),
        ("GPL-2.0-or-later WITH Bison-exception-2.2", True),
        ("GPL-2.0+", True),
        ("CC BY 4.0", False),
        ("free for research", False),
        ("(MIT", False),
        ("MIT OR", False),
        ("", False),
        ("(" * 2000, False),
    ],
)
def test_spdx(licence: str, fine: bool) -> None:
    assert is_spdx_expression(licence) == fine


@pytest.mark.parametrize(
    ("timestamp", "real"),
    [
        ("2024-02-29T10:00:00Z", True),
        ("2023-02-29T10:00:00Z", False),
        ("0000-01-01T10:00:00Z", False),
        ("2026-11-31T10:00:00.123456789Z", False),
        ("no timestamp: another rule's", True),
        (None, True),
    ],
)
def test_dates(timestamp: str | None, real: bool) -> None:
    assert is_real_date(timestamp) == real


def runs(values: str, step_s: float) -> list[tuple[int, int]]:
    frozen = FrozenFrames(longer_than_s=1.0, frames=3)
    found = [frozen.add(i, int(i * step_s * 1e9), ord(v)) for i, v in enumerate(values)]
    return [run[:2] for run in (*found, frozen.end()) if run]


def test_frozen_runs() -> None:
    assert runs("abcdef", 1.0) == []
    assert runs("abbbbc", 0.5) == [(1, 4)]
    assert runs("aabbccdd", 5.0) == [], "two equal frames of a slow camera are no run"
    assert runs("aaabbbb", 0.6) == [(0, 3), (3, 4)]
    assert runs("aaaa", 0.3) == []


@pytest.mark.parametrize("rate", [Fraction(25), Fraction(60000, 1001), Fraction(999_983, 7)])
def test_nominal_times_lie_on_their_grid(rate: Fraction) -> None:
    times = nominal_times(200_000, rate)
    assert off_grid(times, 0, rate).max() <= 1
    shifted = times + np.int64(3_000_000_000_123)
    assert off_grid(shifted, int(shifted[0]), rate).max() <= 1
    kept = times[[0, 1, 5, 77, 1999]]
    assert off_grid(kept, 0, rate).max() <= 1


def test_off_the_grid_is_measured_exactly() -> None:
    times = np.array([0, 40_000_007, 2**61], dtype=np.int64)
    assert off_grid(times, 0, Fraction(25)).tolist()[:2] == [0, 7]
    huge = Fraction(10**17 + 3, 10**16)
    assert off_grid(times, 0, huge)[0] == 0


@pytest.mark.parametrize(
    ("head", "media_type", "fine"),
    [
        (b"\0\0\0 ftypisom", "video/mp4", True),
        (b"\0\0\0\x14wide....", "video/quicktime", True),
        (b"RIFF\0\0\0\0AVI ", "video/x-msvideo", True),
        (b"RIFF\0\0\0\0WAVE", "video/x-msvideo", False),
        (b"\x1aE\xdf\xa3........", "video/webm", True),
        (b"#EXTM3U\nfile", "video/mp4", False),
        (b"", "video/mp4", False),
    ],
)
def test_containers_by_their_first_bytes(head: bytes, media_type: str, fine: bool) -> None:
    assert looks_like(head, media_type) == fine
