"""Small changes of finished episodes: what an editor is given, with keys that it does not know.

The format is in ``spec/conformance/README.md``.
"""

import json
from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from corpus import bases
from corpus.draft import Draft

__all__ = ["Edit", "edits"]


@dataclass(frozen=True)
class Edit:
    """One folder of ``editing``.

    Attributes
    ----------
    name : str
    about : str
        One sentence.
    source : str
        The episode to change, below the folder of the version.
    changes : dict
        JSON pointer below the attribute ``exumi`` to the value that is put there.
    store : dict
        Files of an episode of its own, where `source` is one.
    """

    name: str
    about: str
    source: str
    changes: dict[str, Any]
    store: dict[str, bytes] = field(default_factory=dict)

    def output(self) -> dict[str, bytes]:
        """Return the files of the edit's folder."""
        document = {
            "edit": 1,
            "about": self.about,
            "source": self.source,
            "set": [{"pointer": at, "value": value} for at, value in self.changes.items()],
        }
        text = json.dumps(document, indent=1, ensure_ascii=True) + "\n"
        return {
            "edit.json": text.encode(),
            **{f"store.zarr/{path}": data for path, data in self.store.items()},
        }


def _later() -> Draft:
    """Return an episode of version 1.9: keys in objects of all sorts, arrays, a flag."""
    draft = bases.derived(
        version="1.9",
        revision=4,
        start="2026-05-04T10:20:30Z",
        weather={"sky": "rain", "kelvin": 288.5, "gusts": [1, None, 9007199254740993]},
        device={"name": "hand", "batch": 7},
        embodiment={"name": "gripper", "paint": "grey"},
        quality=[{"code": "dark", "message": "It was dark.", "seen_by": "two"}],
    )
    metadata = draft.metadata
    tcp = {
        "value": [0, 0, 0.1, 0, 0, 0, 1],
        "unit": "m",
        "uncertainty": 0.001,
        "method": "measured",
    }
    metadata["calibration"] = {"tcp": {**tcp, "room": "\u00e4 1"}}
    metadata["task"]["difficulty"] = 0.5
    metadata["source"]["node"] = {"rack": 3, "acme:slot": "b"}
    label = {"property": "soft", "value": 7, "scale": [0, 9], "provenance": "human", "raters": 2}
    label["doubt"] = 0.25
    segment = {"name": "touch", "start_ns": 0, "end_ns": 1, "sure": False}
    metadata["annotations"] = {
        "object_id": "egg",
        "weight_g": 60,
        "labels": [label],
        "segments": [segment],
    }
    stream = metadata["streams"]["tactile"]
    stream["light"] = {"leds": [0.5, 0.25], "colour": "white"}
    stream["gaps"] = [{"after": 1, "lost": 1, "missed": "a frame"}]
    for part in ("clock", "images", "reference", "sensor"):
        stream[part]["later"] = part
    draft.put("streams/tactile/exposure", np.array([8, 8, 9, 8], dtype=np.uint16))
    draft.put("streams/tactile/flags", np.array([0, 0, 64, 0], dtype=np.uint32))
    group = draft.nodes["derived"]["attributes"]["exumi"]
    group["version"] = "1.9"
    group["farm"] = "b"
    group["items"]["tactile/activity"]["seconds"] = 1.25
    slip = np.array([0, 0, 1, 0], dtype=np.uint8)
    draft.derive("tactile/slip", slip, names=("time",), algorithm="slip/2", seed=3)
    return draft


def edits() -> Iterator[Edit]:
    """Yield all edits."""
    valid = "valid/{}/store.zarr".format
    label = {"property": "grip", "value": "firm", "provenance": "human", "raters": 1}
    yield Edit(
        "newer_version",
        "A label more, in an episode of 1.9 with keys, arrays and a flag that 1.0 does not have.",
        "editing/newer_version/store.zarr",
        {"/annotations/labels/-": label, "/success": True},
        _later().files(),
    )
    yield Edit(
        "third_parties",
        "Another trial, in an episode with third parties' keys in objects of all sorts.",
        valid("extension__keys_everywhere"),
        {"/annotations/trial": 5, "/task/instruction": "Press it once more."},
    )
    yield Edit(
        "third_party_kind",
        "A site, for a stream of a kind that only its vendor knows.",
        valid("extension__kind_and_keys"),
        {"/site": "kitchen"},
    )
    yield Edit(
        "first_revision",
        "Success, of an episode that states no revision.",
        valid("pose__minimal"),
        {"/success": False},
    )
    yield Edit(
        "all_of_a_recording",
        "A note on the quality of a recording with gaps, flags and counters.",
        valid("source__recorded"),
        {"/quality": [{"code": "late", "message": "It began late."}], "/operator": "p-08"},
    )
    bench = {"value": 0.5, "unit": "m", "uncertainty": 0.001, "method": "with a rule"}
    licence = {"/licence": "CC-BY-4.0"}
    yield Edit("video", "A licence for two video files.", valid("images__two_videos"), licence)
    yield Edit(
        "calibration_arrays",
        "A calibration item more, beside arrays that are too big for JSON.",
        valid("calibration__fingers"),
        {"/calibration/bench": bench},
    )
    archive = "valid/packed__derived/store.zarr.zip"
    yield Edit("packed", "Success, of a packed episode.", archive, {"/success": True})
