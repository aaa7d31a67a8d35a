"""The cache of timelines: one folder of plain .npy files and a small JSON document each."""

import json
import os
import shutil
import tempfile
from dataclasses import asdict
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from exumi_data.dataset import Dataset
from exumi_loaders.layout import Layout

if TYPE_CHECKING:
    from exumi_loaders.timeline import Timeline, TimelineSettings

__all__ = ["cache_key", "default_cache", "load_timeline", "save_timeline"]

_VERSION = 3
_GROUPS = ("frame", "low", "valid", "seen_frame", "seen_low", "seen_valid")
_OPTIONAL = ("active_all", "active_future")


def default_cache() -> Path:
    """Return the cache folder: ``$EXUMI_CACHE``, or the user's own cache folder."""
    import platformdirs  # used here alone

    chosen = os.environ.get("EXUMI_CACHE")
    base = Path(chosen) if chosen else platformdirs.user_cache_path("exumi-data", appauthor=False)
    return base / "windows"


def cache_key(dataset: Dataset, layout: Layout, settings: "TimelineSettings") -> str:
    """Return the name of a timeline in the cache: of its content, streams and settings."""
    document = {
        "version": _VERSION,
        "dataset": dataset.fingerprint,
        "streams": [layout.tactile, layout.rgb, layout.pose, layout.width],
        "settings": {key: str(value) for key, value in asdict(settings).items()},
    }
    return sha256(json.dumps(document, sort_keys=True).encode()).hexdigest()[:40]


def save_timeline(timeline: "Timeline", folder: Path) -> None:
    """Write a timeline; one that cannot be written is no error."""
    arrays: dict[str, np.ndarray] = {
        "edges": timeline.edges,
        "start_ns": timeline.start_ns,
        "roots": timeline.roots,
    }
    for group in _GROUPS:
        arrays |= {f"{group}.{name}": array for name, array in getattr(timeline, group).items()}
    for name in _OPTIONAL:
        if getattr(timeline, name) is not None:
            arrays[name] = getattr(timeline, name)
    document = {
        "layout": asdict(timeline.layout),
        "encodings": timeline.encodings,
        "arrays": list(arrays),
    }
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        temporary = Path(tempfile.mkdtemp(prefix=".partial-", dir=folder.parent))
    except OSError:
        return  # a cache that cannot be written is no reason to stop
    try:
        for name, array in arrays.items():
            np.save(temporary / f"{name}.npy", array, allow_pickle=False)
        (temporary / "timeline.json").write_text(json.dumps(document))
        temporary.rename(folder)
    except OSError:
        shutil.rmtree(temporary, ignore_errors=True)  # another process was first, or no space


def load_timeline(folder: Path, settings: "TimelineSettings") -> "Timeline | None":
    """Return a timeline, its arrays mapped from their files; None where it is not there whole."""
    from exumi_loaders.timeline import Timeline  # the two modules need each other

    try:
        document: dict[str, Any] = json.loads((folder / "timeline.json").read_text())
        arrays = {
            name: np.load(folder / f"{name}.npy", mmap_mode="r", allow_pickle=False)
            for name in document["arrays"]
        }
        made = document["layout"]
        layout = Layout(
            tuple(made["tactile"]),
            tuple(made["rgb"]),
            tuple(made["pose"]),
            tuple(made["width"]),
            {name: tuple(shape) for name, shape in made["shapes"].items()},
            made["references"],
            made["children"],
            made["parents"],
            made["calibrations"],
            made["common_parent"],
        )
    except (OSError, ValueError, KeyError, TypeError):
        return None  # not there, or not whole: computed anew

    def group(prefix: str) -> dict[str, np.ndarray]:
        return {
            name.removeprefix(f"{prefix}."): array
            for name, array in arrays.items()
            if name.startswith(f"{prefix}.")
        }

    return Timeline(
        layout,
        settings,
        arrays["edges"],
        arrays["start_ns"],
        group("frame"),
        group("low"),
        group("valid"),
        arrays.get("active_all"),
        arrays.get("active_future"),
        document["encodings"],
        arrays["roots"],
        group("seen_frame"),
        group("seen_low"),
        group("seen_valid"),
    )
