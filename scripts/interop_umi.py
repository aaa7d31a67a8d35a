"""Read a replay buffer as UMI's and exUMI's training code does, with zarr 2 and imagecodecs.

Run this with the Python of an environment that has them (it needs nothing of this project)::

    python3.11 -m venv ZARR2
    ZARR2/bin/pip install zarr==2.16.1 numcodecs==0.12.1 imagecodecs==2023.9.18 "numpy<2" scipy
    ZARR2/bin/python scripts/interop_umi.py BUFFER.zarr.zip
    ZARR2/bin/python scripts/interop_umi.py BUFFER.zarr.zip --code universal_manipulation_interface

The steps are those of ``UmiDataset`` and ``ReplayBuffer.copy_from_store``: the zip is copied into
memory without recoding, every array must be as long as the last episode's end, numbers are read
whole, frames one slice at a time. With ``--code`` the classes themselves do it: name a checkout of
real-stanford/universal_manipulation_interface or silicx/exUMI.

Prints JSON: for each array its shape, type, and the SHA-256 of what was read. The project's tests
run this where the environment variable ``EXUMI_ZARR2_PYTHON`` names such a Python.
"""

import argparse
import hashlib
import json
import sys
from importlib import import_module
from pathlib import Path
from typing import Any


def main() -> None:
    """Read the buffer and print what was found."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("buffer", type=Path)
    parser.add_argument("--code", type=Path, help="checkout of UMI's or exUMI's repository")
    arguments = parser.parse_args()
    import zarr

    if not zarr.__version__.startswith("2."):
        sys.exit(f"this reads as UMI does, with zarr 2, not {zarr.__version__}")
    result: dict[str, Any] = {"zarr": zarr.__version__, "way": "steps"}
    if arguments.code is None:
        from imagecodecs.numcodecs import register_codecs

        register_codecs(verbose=False)
        root = _copy(zarr, arguments.buffer)
    else:
        result["way"] = "their classes"
        root = _their_buffer(zarr, arguments.buffer, arguments.code, result)
    ends = root["meta"]["episode_ends"][:]
    result["episode_ends"] = ends.tolist()
    result["arrays"] = {
        name: _read(array, int(ends[-1])) for name, array in sorted(root["data"].items())
    }
    print(json.dumps(result))


def _open(zarr: Any, path: Path) -> Any:
    return zarr.ZipStore(str(path), mode="r") if path.is_file() else zarr.DirectoryStore(str(path))


def _copy(zarr: Any, path: Path) -> Any:
    """Copy a buffer into memory as ``ReplayBuffer.copy_from_store`` does."""
    source, target = _open(zarr, path), zarr.MemoryStore()
    root = zarr.group(store=target)
    found = zarr.group(source)
    zarr.copy_store(source, target, source_path="/meta", dest_path="/meta", if_exists="replace")
    root.create_group("data", overwrite=True)
    for key in found["data"]:
        where = f"/data/{key}"
        zarr.copy_store(source, target, source_path=where, dest_path=where, if_exists="replace")
    return root


def _their_buffer(zarr: Any, path: Path, code: Path, result: dict[str, Any]) -> Any:
    """Open a buffer with the real classes, and draw windows with the real sampler."""
    sys.path.insert(0, str(code))
    codecs = import_module("diffusion_policy.codecs.imagecodecs_numcodecs")
    ReplayBuffer = import_module("diffusion_policy.common.replay_buffer").ReplayBuffer  # a class
    SequenceSampler = import_module("diffusion_policy.common.sampler").SequenceSampler  # a class
    codecs.register_codecs(verbose=False)
    buffer = ReplayBuffer.copy_from_store(src_store=_open(zarr, path), store=zarr.MemoryStore())
    images = [key for key in buffer.keys() if len(buffer[key].shape) == 4]  # noqa: SIM118  # no dict
    numbers = [key for key in buffer.keys() if key not in images]  # noqa: SIM118  # no dict
    every = dict.fromkeys((*images, *numbers, "action"), 2)
    sampler = SequenceSampler(
        shape_meta={"obs": {}, "action": {}},
        replay_buffer=buffer,
        rgb_keys=images,
        lowdim_keys=numbers,
        key_horizon=every,
        key_latency_steps=dict.fromkeys(every, 0),
        key_down_sample_steps=dict.fromkeys(every, 3),
    )
    window = sampler.sample_sequence(len(sampler) // 2)
    result["windows"] = len(sampler)
    result["window"] = {key: list(value.shape) for key, value in sorted(window.items())}
    return buffer.root


def _read(array: Any, rows: int) -> dict[str, Any]:
    """Read an array and check its length as ``ReplayBuffer`` does."""
    if array.shape[0] != rows:
        sys.exit(f"{array.path} has {array.shape[0]} rows, the last episode ends at {rows}")
    digest = hashlib.sha256()
    for row in range(rows):
        digest.update(array[row : row + 1].tobytes())
    codec = None if array.compressor is None else array.compressor.codec_id
    return {
        "shape": list(array.shape),
        "chunks": list(array.chunks),
        "dtype": str(array.dtype),
        "codec": codec,
        "sha256": digest.hexdigest(),
    }


if __name__ == "__main__":
    main()
