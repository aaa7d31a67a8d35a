"""Write an episode with the temperature of a fingertip that touches something warm."""

import argparse
import uuid
from pathlib import Path
from typing import Any

import numpy as np

from acme_thermal.kind import KIND, SCHEMA_URL, VERSION
from exumi_data import EpisodeWriter
from exumi_data.errors import ExumiError
from exumi_data.model import Clock, EpisodeMetadata, Source, Task

__all__ = ["main", "write_episode"]

_RATE_HZ = 20


def write_episode(path: Path, celsius: np.ndarray, **keys: Any) -> Path:
    """Write an episode with one temperature a sample, 20 a second.

    Parameters
    ----------
    path : pathlib.Path
        Of the new episode.
    celsius : (n,) float32
    **keys
        Metadata of the stream besides its emissivity, such as ``acme:range_celsius``.
    """
    metadata = EpisodeMetadata(
        id=str(uuid.uuid5(uuid.NAMESPACE_URL, f"{SCHEMA_URL}#{path.name}")),
        task=Task(name="touch the cup"),
        regime="touch",
        licence="CC0-1.0",
        source=Source(type="simulated", tool="acme-thermal", tool_version="1.0"),
    )
    time_ns = np.arange(len(celsius)) * (1_000_000_000 // _RATE_HZ)
    with EpisodeWriter(path, metadata) as writer:
        stream = writer.add_stream(
            "finger_heat",
            kind=KIND,
            clock=Clock(source="hub_monotonic", stamp_point="kernel_rx"),
            extension_version=VERSION,
            schema_url=SCHEMA_URL,
            **{"acme:emissivity": 0.94, **keys},
        )
        stream.append(time_ns, celsius.astype(np.float32))
    return path


def main() -> None:
    """Run the program."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("path", type=Path, help="the new episode, such as warm.zarr")
    seconds = np.arange(200) / _RATE_HZ
    warming = 24 + 12 * (1 - np.exp(-np.maximum(seconds - 2, 0) / 3))
    try:
        write_episode(parser.parse_args().path, warming, **{"acme:range_celsius": [-40.0, 125.0]})
    except ExumiError as error:  # such as an episode of that name from an earlier run
        parser.exit(2, f"error: {error}\n")


if __name__ == "__main__":
    main()
