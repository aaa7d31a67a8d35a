"""Thresholds of rules about documents, frames, names and finite values, on both sides."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from exumi_data.errors import UsageError
from exumi_data.model import RawData
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.video import is_grey
from exumi_validators import validate
from tests.exumi_data.builders import CLOCK, edit_json, edit_metadata, metadata

INVALID = 8


def of_documents(path: Path) -> list[str]:
    """The codes that the documents alone give."""
    return [problem.code for problem in validate(path, levels=["document"]).problems]


def widths(path: Path, values: list[float], raw: list[float], flags: list[int]) -> Path:
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        described = RawData(unit="mm")
        stream = writer.add_stream("width", kind="width", clock=CLOCK, raw=described)
        stream.append(
            np.arange(len(values)) * 10_000_000,
            np.array(values, np.float32),
            raw=np.array(raw, np.float32),
            flags=np.array(flags, np.uint32),
        )
    return path


@pytest.mark.parametrize(
    ("value", "raw", "flag", "found"),
    [
        (np.nan, np.nan, INVALID, []),
        (np.nan, 1.0, 0, ["data"]),
        (0.01, np.nan, 0, ["raw"]),
        (np.inf, 1.0, INVALID, ["data"]),
        (np.nan, -np.inf, INVALID, ["raw"]),
    ],
)
def test_only_invalid_samples_hold_nan(
    tmp_path: Path, value: float, raw: float, flag: int, found: list[str]
) -> None:
    path = widths(tmp_path / "e.zarr", [0.0, value, 0.02], [0.0, raw, 2.0], [0, flag, 0])
    problems = [p for p in validate(path).problems if p.code == "VAL-001"]
    assert [p.location.path for p in problems] == [f"streams/width/{array}" for array in found]
    assert all(p.location.index == 1 for p in problems)


@pytest.mark.parametrize(("after", "found"), [([-1], []), ([-1, 0], ["GAP-001"])])
def test_gaps_of_a_stream_of_nothing(tmp_path: Path, after: list[int], found: list[str]) -> None:
    path = widths(tmp_path / "e.zarr", [], [], [])
    gaps = [{"after": sample} for sample in after]
    edit_metadata(path, lambda exumi: exumi["streams"]["width"].update(gaps=gaps))
    assert [code for code in validate(path).codes() if code == "GAP-001"] == found


@pytest.mark.parametrize(
    ("encoding", "height", "fits"),
    [("array", 8192, True), ("array", 8193, False), ("encoded", 32768, True)],
)
def test_a_frame_fits_a_shard(tmp_path: Path, encoding: str, height: int, fits: bool) -> None:
    images: dict[str, Any] = {
        "encoding": encoding,
        "height": height,
        "width": 8192,
        "channels": 1,
        **({"media_type": "image/jpeg"} if encoding == "encoded" else {}),
    }
    path = tmp_path / "e.zarr"
    with EpisodeWriter(path, metadata(), durable=False) as writer:
        if not fits:
            with pytest.raises(UsageError, match="are larger than"):
                writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=images)
        small = {**images, "height": 8}
        writer.add_stream("rgb", kind="rgb", clock=CLOCK, images=small)
    edit_metadata(path, lambda exumi: exumi["streams"]["rgb"]["images"].update(height=height))
    assert ("IMG-001" in of_documents(path)) != fits


@pytest.mark.parametrize(
    ("licence", "found"),
    [
        ("NONE", []),
        ("none", ["LIC-001"]),
        ("NOASSERTION", []),
        ("Unknown", ["LIC-001"]),
        ("my own", ["LIC-002"]),
    ],
)
def test_licences(episode: Path, licence: str, found: list[str]) -> None:
    edit_metadata(episode, lambda exumi: exumi.update(licence=licence))
    assert of_documents(episode) == found


@pytest.mark.parametrize(
    ("version", "found"),
    [("1.0", []), ("01.0", ["DOC-004"]), ("1.00", ["DOC-004"]), ("1.1234567890", ["DOC-004"])],
)
def test_versions_have_one_spelling(episode: Path, version: str, found: list[str]) -> None:
    edit_metadata(episode, lambda exumi: exumi.update(version=version))
    assert of_documents(episode) == found


@pytest.mark.parametrize(
    ("name", "found"),
    [
        ("acme__slip", []),
        ("other_lab__slip_2", []),
        ("acme_slip", ["DRV-007"]),
        ("activty", ["DRV-007"]),
        ("a___b", ["DRV-007"]),
        ("acme__", ["DRV-007"]),
    ],
)
def test_names_of_derived_arrays(
    episode: Path, name: str, found: list[str], codes: Callable[[Path], list[str]]
) -> None:
    def rename(document: Any) -> None:
        items = document["attributes"]["exumi"]["items"]
        (key,) = [key for key in items if key.endswith("/activity")]
        items[f"{key.partition('/')[0]}/{name}"] = items.pop(key)

    edit_json(episode / "derived/zarr.json", rename)
    assert of_documents(episode) == found
    (activity,) = episode.glob("derived/*/activity")
    activity.rename(activity.with_name(name))
    # Without its activity TACT-011 looks at the frames, which are noise.
    assert [code for code in codes(episode) if code != "TACT-011"] == found


@pytest.mark.parametrize(
    ("value", "found"), [({"a": 1}, ["EXT-002"]), ({"schema_url": "x"}, []), (3, [])]
)
def test_objects_of_third_parties_in_derived(episode: Path, value: Any, found: list[str]) -> None:
    def add(document: Any) -> None:
        document["attributes"]["exumi"]["acme:farm"] = value

    edit_json(episode / "derived/zarr.json", add)
    assert of_documents(episode) == found


@pytest.mark.parametrize(
    ("pixel_format", "grey"),
    [("gray", True), ("gray10le", True), ("ya8", True), ("monow", True), ("yuv420p", False),
     ("pal8", False), ("gbrp", False), ("yuyv422", False), (None, False)],
)  # fmt: skip
def test_pixel_formats_without_colours(pixel_format: str | None, grey: bool) -> None:
    assert is_grey(pixel_format) == grey
