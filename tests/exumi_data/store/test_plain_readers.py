"""Programs that never heard of us read our episodes: zarr-python and OpenCV alone."""

import subprocess
import sys
from pathlib import Path

import cv2
import numpy as np
import pytest

from exumi_data.episode import Episode, open_episode
from exumi_data.store.pack import pack
from tests.exumi_data.builders import FRAMES, clip, jpegs, pictures, write_episode

# What every script begins with: our packages cannot be imported, wherever they are installed.
ALONE = """
import sys
for name in ("data", "converters", "validators", "loaders", "recorders"):
    sys.modules[f"exumi_{name}"] = None
import cv2, numpy as np, zarr, zarr.storage
path, target = sys.argv[1:]
store = zarr.storage.ZipStore(path, read_only=True) if path.endswith(".zip") else path
root = zarr.open(store, mode="r")
"""

ALL_ARRAYS = """
found = {}
def walk(group, prefix):
    for name, node in group.members():
        if isinstance(node, zarr.Array):
            found[prefix + name] = node[...]
            assert node.metadata.dimension_names is not None, name
        else:
            walk(node, f"{prefix}{name}/")
walk(root, "")
np.savez(target, **found)
"""

FRAMES_OF_ALL_ENCODINGS = """
out = {}
stream = root["streams/tactile"]
offset, data = stream["offset"][:], stream["data"]
files = [data[int(a):int(b)] for a, b in zip(offset, offset[1:])]
out["encoded"] = [cv2.cvtColor(cv2.imdecode(file, cv2.IMREAD_COLOR), cv2.COLOR_BGR2RGB)
                  for file in files]
out["third"] = files[2]
out["array"] = root["streams/rgb/data"][:]
offset, data = root["streams/gopro/offset"][:], root["streams/gopro/data"]
with open(target + ".mp4", "wb") as file:
    file.write(data[int(offset[0]):int(offset[1])].tobytes())
video, frames = cv2.VideoCapture(target + ".mp4"), []
while (frame := video.read())[0]:
    frames.append(cv2.cvtColor(frame[1], cv2.COLOR_BGR2RGB))
out["video"] = frames
np.savez(target, **out)
"""


@pytest.fixture(scope="module", params=["folder", "zip"])
def episode(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Episode:
    path = write_episode(tmp_path_factory.mktemp("plain") / "a.zarr")
    return open_episode(path if request.param == "folder" else pack(path))


def run(script: str, episode: Episode, tmp_path: Path) -> dict[str, np.ndarray]:
    """Run a program that gets the episode's path, and return the arrays that it saved."""
    target = tmp_path / "out.npz"
    command = [sys.executable, "-I", "-W", "error", "-c", ALONE + script]
    done = subprocess.run(
        [*command, str(episode.path), str(target)],
        check=False,
        capture_output=True,
        text=True,
        cwd=tmp_path,
    )
    assert done.returncode == 0, done.stderr
    with np.load(target, allow_pickle=False) as saved:
        return dict(saved)


def test_zarr_reads_every_array_as_we_do(episode: Episode, tmp_path: Path) -> None:
    found = run(ALL_ARRAYS, episode, tmp_path)
    expected = {
        f"streams/{name}/{array}": stream.array(array)
        for name, stream in episode.streams.items()
        for array in stream.metadata.arrays
    }
    assert episode.derived is not None
    for key in episode.derived.items:
        values = episode.derived_array(key)
        assert values is not None
        expected[f"derived/{key}"] = values
    assert found.keys() == expected.keys()
    for name, values in expected.items():
        assert found[name].dtype == values.dtype, name
        np.testing.assert_array_equal(found[name], values, err_msg=name)


def opencv(file: bytes) -> np.ndarray:
    image = cv2.imdecode(np.frombuffer(file, np.uint8), cv2.IMREAD_COLOR)
    assert image is not None
    return np.asarray(cv2.cvtColor(image, cv2.COLOR_BGR2RGB))


def test_opencv_decodes_the_frames_of_every_encoding(episode: Episode, tmp_path: Path) -> None:
    found = run(FRAMES_OF_ALL_ENCODINGS, episode, tmp_path)
    assert found["third"].tobytes() == jpegs()[2] == episode["tactile"].encoded(2)
    ours = [opencv(file) for file in jpegs()]
    np.testing.assert_array_equal(found["encoded"], ours)
    np.testing.assert_array_equal(found["encoded"], episode["tactile"].frames[:])
    np.testing.assert_array_equal(found["array"], pictures())
    assert (tmp_path / "out.npz.mp4").read_bytes() == clip()[0] == episode["gopro"].container()
    assert len(found["video"]) == FRAMES
    difference = found["video"].astype(int) - episode["gopro"].frames[:]
    assert np.abs(difference).mean() < 2  # colours are computed by two different converters


def test_the_root_says_what_it_is(episode: Episode, tmp_path: Path) -> None:
    script = """
attributes = dict(root.attrs)
(convention,) = attributes["zarr_conventions"]
assert convention["name"] == attributes["exumi"]["format"] == "exumi-episode"
assert set(attributes["exumi"]["streams"]) == set(root["streams"].group_keys())
np.savez(target, version=attributes["exumi"]["version"])
"""
    assert run(script, episode, tmp_path)["version"] == "1.0"


def test_the_script_would_notice_our_package(episode: Episode, tmp_path: Path) -> None:
    with pytest.raises(AssertionError, match="import of exumi_data halted"):
        run("import exumi_data", episode, tmp_path)
