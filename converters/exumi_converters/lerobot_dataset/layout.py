"""Where a LeRobotDataset v3.0 keeps what, as the package ``lerobot`` itself writes it."""

from fractions import Fraction
from typing import Any, Literal

from pydantic import BaseModel, ConfigDict

from exumi_data.model import Frames, Sensor
from exumi_data.model.streams import StreamModel

__all__ = [
    "ACTION",
    "ACTIVITY",
    "CHUNK_FILES",
    "DATA_PATH",
    "DECLARATION",
    "DEFAULT_FEATURES",
    "EPISODES_FOLDER",
    "IMAGES",
    "INFO",
    "POSE_PARTS",
    "STATE",
    "STATS",
    "TASKS",
    "VERSION",
    "VIDEO_PATH",
    "WIDTH_PART",
    "Declaration",
    "DeclaredStream",
    "fps_number",
    "fps_of",
    "label",
    "place",
]

VERSION = "v3.0"
INFO = "meta/info.json"
STATS = "meta/stats.json"
TASKS = "meta/tasks.parquet"
EPISODES_FOLDER = "meta/episodes"
DATA_PATH = "data/chunk-{chunk_index:03d}/file-{file_index:03d}.parquet"
VIDEO_PATH = "videos/{video_key}/chunk-{chunk_index:03d}/file-{file_index:03d}.mp4"
CHUNK_FILES = 1000
"""Most files of a chunk."""
_LONGEST_NAME = 255

DECLARATION = "meta/exumi.json"
"""Ours: what the features were before. LeRobot passes it over."""

IMAGES = "observation.images."
STATE = "observation.state"
ACTION = "action"
ACTIVITY = "observation.activity"
POSE_PARTS = ("x", "y", "z", "qx", "qy", "qz", "qw")
WIDTH_PART = "width_m"

DEFAULT_FEATURES: dict[str, str] = {
    "timestamp": "float32",
    "frame_index": "int64",
    "episode_index": "int64",
    "index": "int64",
    "task_index": "int64",
}
"""Name to type of the columns that every dataset has."""


class DeclaredStream(BaseModel):
    """What a stream was before it became part of a feature."""

    model_config = ConfigDict(extra="ignore", frozen=True)

    feature: str
    kind: Literal["rgb", "tactile", "pose", "width", "wrench", "taxels"]
    sensor: Sensor | None = None
    description: str | None = None
    frames: Frames | None = None
    mm_per_px: list[float] | None = None
    components: list[str] | None = None
    reference_frame: str | None = None
    grid: list[int] | None = None
    unit: str | None = None
    sign: int | None = None
    offset: float | None = None

    def fields(self) -> dict[str, Any]:
        """Return what `EpisodeWriter.add_stream` takes, beside kind and images."""
        document: dict[str, Any] = self.model_dump(mode="json", exclude_none=True)
        return {key: value for key, value in document.items() if key not in {"feature", "kind"}}

    @classmethod
    def of(cls, feature: str, model: StreamModel) -> "DeclaredStream":
        """Describe a stream of an episode."""
        said = model.model_dump(mode="json", exclude_none=True)
        return cls.model_validate({**said, "feature": feature})


class Declaration(BaseModel):
    """Our file beside LeRobot's: how the values came about, and what the streams were."""

    model_config = ConfigDict(extra="ignore")

    format: Literal["exumi-lerobot"] = "exumi-lerobot"
    version: Literal[1] = 1
    fps: str
    timeline: str | None
    """The stream whose first frame the ticks begin with."""
    images: str = "the frame nearest in time to the tick; frames are never blended"
    poses: str = "x y z in metres, quaternion qx qy qz qw with its real part last"
    action: str
    licence: str
    regime: Literal["demonstration", "play", "touch"] | None = None
    """Where all episodes have the same."""
    streams: dict[str, DeclaredStream]


def fps_number(fps: Fraction) -> int | float:
    """Return what ``info.json`` says of a rate: a whole number where it is one."""
    return fps.numerator if fps.denominator == 1 else float(fps)


def fps_of(number: float) -> Fraction:
    """Return the rate that a number of ``info.json`` stands for: 59.94... is 60000/1001."""
    for most in (1, 1001, 1_000_000):
        rate = Fraction(number).limit_denominator(most)
        if abs(float(rate) - number) <= 1e-9 * abs(number):
            return rate
    return Fraction(number).limit_denominator(1_000_000)


def label(text: str) -> str:
    """Return a text as a name: on one line, and not longer than names may be."""
    return " ".join(text.split())[:_LONGEST_NAME].strip()


def place(number: int) -> tuple[int, int]:
    """Return chunk and file of the file of that number."""
    return divmod(number, CHUNK_FILES)
