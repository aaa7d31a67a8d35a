#!/usr/bin/env python3
"""Write a described episode with `exumi_data`: what ``run_writer.py`` asks of a writer.

Exit code 0: written. 3: the library has no way to write this. Anything else: it failed.
"""

import argparse
import json
import sys
from pathlib import Path
from typing import Any

import numpy as np

from exumi_data.errors import ExumiError
from exumi_data.model import EpisodeMetadata, VideoFile
from exumi_data.model.clock import Clock
from exumi_data.store.episode_writer import EpisodeWriter
from exumi_data.store.stream_writer import VideoStreamWriter

NOT_SUPPORTED = 3
BESIDE_TIME = ("time_host", "time_device", "sequence", "flags", "raw")


class NotSupportedError(Exception):
    """The library has no way to write this."""


def load(folder: Path, about: dict[str, Any]) -> np.ndarray:
    """Read an array of a description."""
    raw = (folder / about["file"]).read_bytes()
    dtype = np.dtype(about["dtype"]).newbyteorder("<")
    return np.frombuffer(raw, dtype=dtype).reshape(about["shape"]).astype(about["dtype"])


def write_stream(writer: EpisodeWriter, folder: Path, about: dict[str, Any]) -> None:
    """Write one stream."""
    fields = dict(about["fields"])
    arrays = {name: load(folder, array) for name, array in about["arrays"].items()}
    beside = {name: arrays.pop(name) for name in BESIDE_TIME if name in arrays}
    reference = fields.pop("reference", None)
    videos = [VideoFile(**file) for file in fields.get("images", {}).get("files", [])]
    if videos:
        fields["images"] = {k: v for k, v in fields["images"].items() if k != "files"}
    clock = Clock(**fields.pop("clock"))
    stream = writer.add_stream(about["name"], kind=about["kind"], clock=clock, **fields)
    time = arrays.pop("time")
    if "frames" in about:
        stream.append(time, [(folder / name).read_bytes() for name in about["frames"]], **beside)
    elif "videos" in about:
        if clock.raw_time is not None:
            beside["time"] = time  # else it follows from the pts
        contents = [(folder / name).read_bytes() for name in about["videos"]]
        index = {name: arrays.pop(name) for name in ("file", "pts", "keyframe")}
        write_videos(stream, videos, contents, index, beside)
    elif about["kind"] == "audio":
        blocks = np.split(arrays.pop("data"), arrays.pop("offset")[1:-1].astype(np.int64))
        stream.append(time, blocks[: len(time)], **beside)
    elif len(time):
        stream.append(time, arrays.pop("data"), **beside)
    else:
        arrays.pop("data")
    if "reference" in arrays:
        stream.set_reference(arrays.pop("reference"), **reference)
    if "valid" in arrays:
        stream.set_valid(arrays.pop("valid"))
    if arrays:
        raise NotSupportedError(f"arrays {', '.join(arrays)} of {about['name']}")


def write_videos(
    stream: VideoStreamWriter,
    files: list[VideoFile],
    contents: list[bytes],
    index: dict[str, np.ndarray],
    beside: dict[str, np.ndarray],
) -> None:
    """Write the video files of a stream."""
    for number, (file, content) in enumerate(zip(files, contents, strict=True)):
        own = np.flatnonzero(index["file"] == number)
        first = int(own[0]) if len(own) else 0
        stream.append_file(
            content,
            file,
            pts=index["pts"][own],
            keyframe=index["keyframe"][own].astype(np.int64) - first,
            **{name: values[own] for name, values in beside.items()},
        )


def write(folder: Path, target: Path) -> None:
    """Write an episode as a description says."""
    document = json.loads((folder / "description.json").read_bytes())
    metadata = EpisodeMetadata.model_validate_json(json.dumps(document["episode"]))
    with EpisodeWriter(target, metadata, durable=False) as writer:
        for stream in document["streams"]:
            write_stream(writer, folder, stream)
        for path, array in document["arrays"].items():
            writer.add_calibration_array(path.removeprefix("calibration/"), load(folder, array))
        for derived in document["derived"]:
            values = load(folder, derived["array"])
            writer.add_derived(derived["stream"], derived["name"], values, **derived["fields"])


def main() -> int:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("description", type=Path, metavar="DESCRIPTION")
    parser.add_argument("target", type=Path, metavar="TARGET")
    arguments = parser.parse_args()
    try:
        write(arguments.description, arguments.target)
    except NotSupportedError as error:
        sys.stderr.write(f"not supported: {error}\n")
        return NOT_SUPPORTED
    except ExumiError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
