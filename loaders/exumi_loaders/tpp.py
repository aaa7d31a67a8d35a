"""Windows for Tactile Prediction Pretraining (exUMI)."""

from collections.abc import Mapping, Sequence
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal, NamedTuple

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.ticks import DEFAULT_TICK_S
from exumi_loaders.actions import (
    action_columns,
    between_columns,
    between_grippers,
    relative_actions,
    relative_to_start,
)
from exumi_loaders.buffers import ItemSpec
from exumi_loaders.draws import history_steps, normal
from exumi_loaders.episode_windows import EpisodeWindows
from exumi_loaders.layout import Names, choose_layout
from exumi_loaders.masks import Mask, make_masks
from exumi_loaders.options import one_of
from exumi_loaders.steps import WindowSteps
from exumi_loaders.timeline import TimelineSettings
from exumi_loaders.window_frames import OnCorrupt

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["TPPWindows"]

_NOISE = 20  # a purpose of draws, see draws.py


class _Drawn(NamedTuple):
    """What is drawn of some windows.

    Attributes
    ----------
    masked : dict of str to (R,) bool
        Whether each modality is left out.
    tactile_steps : (R, K) int64 or None
    frames : dict of str to ((R, K) int, (R, K) bool)
        Of each image stream the frames, -1 for none, and which are hidden on purpose.
    """

    masked: dict[str, np.ndarray]
    tactile_steps: np.ndarray | None
    frames: dict[str, tuple[np.ndarray, np.ndarray]]


class TPPWindows(EpisodeWindows):
    """Windows of tactile frames, RGB frames and relative actions on a common timeline.

    A window lies around one tick, its step 0. With the defaults, which are the paper's, it holds

    - 8 frames of each tactile stream: 4 of the history (drawn without replacement from steps
      −15..0, ascending) and 4 of the future (steps 4, 8, 12, 16);
    - 1 frame of each RGB stream, at step 0;
    - actions at steps −15..16: of each gripper ``inv(T_0)·T_t`` as xyz and the first two rows of
      its rotation matrix, and its absolute width: 10 numbers (9 without width, 1 without pose);
    - with several grippers, where the others are as seen from the first one at step 0;
    - on request, proprioception: poses of the history relative to a noisy start pose.

    Every item is a dict of tensors (a batch has one more axis in front). K = 8 tactile frames,
    S = 32 steps, H = 16 of them history, G grippers with pose and width:

    =========================  =======================  =========================================
    key                        shape, dtype             meaning
    =========================  =======================  =========================================
    ``<image stream>``         (K, C, H, W) uint8       frames; of a camera, one for each RGB step;
                                                        `JpegFrames` with ``decode="device"``
    ``<stream>_valid``         (K,) bool                a frame is there: near enough, not masked,
                                                        not damaged
    ``<stream>_reference``     (C, H, W) uint8          image without contact (tactile)
    ``tactile_steps``          (K,) int64               step of each tactile frame
    ``action``                 (S, 10·G) float32        `action_columns`
    ``action_valid``           (S,) bool                measured there (no sample gap), inside the
                                                        episode, and not masked
    ``between``                (S, 9·(G−1)) float32     `between_columns`; of several poses only
    ``between_valid``          (S,) bool                as ``action_valid``
    ``proprioception``         (H, 10·G) float32        `action_columns`, relative to the start
    ``proprioception_valid``   (H,) bool                as ``action_valid``
    ``<modality>_masked``      () bool                  the modality was left out on purpose:
                                                        ``tactile_history``, ``rgb``, ``action``,
                                                        ``proprioception``
    ``padding``                (S,) bool                the step lies outside the episode
    ``valid``                  () bool                  everything that is not masked is valid,
                                                        nothing padded
    ``episode``                () int64                 position in ``windows.episodes``
    ``time_ns``                () int64                 time of step 0 since the episode's start
    ``replaced``               () int64                 damaged windows that this one stands for
                                                        (``on_corrupt="skip"`` only)
    ``substituted``            () int64                 damaged frames that are black
                                                        (``on_corrupt="substitute"`` only)
    =========================  =======================  =========================================

    Keys of streams that the dataset does not have are not there. Steps outside the episode repeat
    its first or last tick and are marked in ``padding``; a frame with no neighbour within the
    tolerance is black and marked in ``<stream>_valid``. What is masked is zero (also rotations)
    and never decoded.

    Parameters
    ----------
    dataset : exumi_data.Dataset
        With frames of one size: ``exumi prepare`` makes them.
    split : str, optional
        ``train`` or ``val`` of a split made on the fly, or ``<name>/<list>`` of a split stored
        with the dataset.
    split_by : {"episode", "object", "part"}
        What is kept together by a split made on the fly.
    split_ratio : (int, int)
        Train to val; 15:1 in exUMI.
    tactile, rgb, pose, width : str or sequence of str, optional
        Streams in the wanted order; default all of the kind, sorted by name. An empty sequence
        takes none.
    grey_tactile : bool
        Give one channel (luma) of tactile frames that are stored in colour.
    decode : {"cpu", "device"}
        ``device`` leaves JPEG files as they are (`JpegFrames` in place of images), for
        `exumi_loaders.device.DecodeJpeg`. Frames that are stored otherwise, and references, are
        images all the same.
    history, future : int
        Steps of history (step 0 is its last) and of future, in ticks.
    history_frames, future_frames : int
        Tactile frames of each. Those of the future lie at every ``future // future_frames``-th
        step.
    random_history : bool
        False takes every ``history // history_frames``-th step up to 0: −12, −8, −4, 0.
    rgb_steps : sequence of int
        Steps at which there is a frame of each camera.
    edges : {"pad", "drop"}
        Whether every tick is the step 0 of a window, or only those whose steps all lie within
        the episode (an episode that is too short for any gives one padded window at its middle).
    stride : int
        Distance of windows in ticks.
    activity : {"all", "future"}
        What makes a window active: any tactile frame of its span, or one at a future step.
    tick_s : fractions.Fraction or float
        Distance of two ticks, which is the rate of actions; default 3/59.94 s.
    image_tolerance_s, max_gap_s : float, optional
        See `TimelineSettings`.
    active_above : float, optional
        Activity above which a frame is active; default what is stored with the activity.
    mask : {"none", "action", "rgb", "action+rgb", "tactile_history"}
        What all windows leave out: the five inputs that exUMI compares. ``action`` takes
        proprioception along, which tells of the same motion.
    dropout : mapping of str to float, optional
        Probability that a modality (``tactile_history``, ``rgb``, ``action``,
        ``proprioception``) is left out of a window, each on its own.
    proprioception : bool
        Give poses of the history relative to the episode's first, which noise was added to.
    start_noise_m, start_noise_rad : float
        Standard deviation of that noise along and about each axis (UMI: 0.05 both). It is drawn
        anew for each window and gripper; 0 leaves the start as it is.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data. ``raise``: an error that names episode, stream and frame.
        ``skip``: another window that is as active takes the place (drawn by seed, epoch and
        index), and ``replaced`` counts the damaged ones; batches keep their size. ``substitute``:
        the frame is black, marked in ``<stream>_valid`` and counted in ``substituted``. A dataset
        that changed since it was opened is an error in any case. With ``decode="device"`` what is
        wrong with a file's checksum, header, size or number of scans is damage; what only decoding
        finds out is an error of `DecodeJpeg`.
    seed : int
        Of draws and splits. Draws are a pure function of (seed, epoch, index).
    cache : bool or path
        Keep the timelines in the user's cache folder (default), in a given folder, or nowhere.

    Raises
    ------
    UsageError
        Streams are missing or differ in size; no activity is stored but asked for.

    Examples
    --------
    >>> windows = TPPWindows(exumi_data.open("training-set"), split="train")  # doctest: +SKIP
    >>> for batch in windows.loader(batch_size=64, reject_inactive=0.9):  # doctest: +SKIP
    ...     batch["tactile_left"].shape
    torch.Size([64, 8, 1, 224, 224])
    """

    def __init__(  # noqa: PLR0913  # keyword-only options, each with a default
        self,
        dataset: "EpisodeDataset",
        *,
        split: str | None = None,
        split_by: Literal["episode", "object", "part"] = "episode",
        split_ratio: tuple[int, int] = (15, 1),
        tactile: Names = None,
        rgb: Names = None,
        pose: Names = None,
        width: Names = None,
        grey_tactile: bool = False,
        decode: Literal["cpu", "device"] = "cpu",
        history: int = 16,
        future: int = 16,
        history_frames: int = 4,
        future_frames: int = 4,
        random_history: bool = True,
        rgb_steps: Sequence[int] = (0,),
        edges: Literal["pad", "drop"] = "pad",
        stride: int = 1,
        activity: Literal["all", "future"] = "all",
        tick_s: Fraction | float = DEFAULT_TICK_S,
        image_tolerance_s: float | None = None,
        max_gap_s: float | None = None,
        active_above: float | None = None,
        mask: Mask = "none",
        dropout: Mapping[str, float] | None = None,
        proprioception: bool = False,
        start_noise_m: float = 0.05,
        start_noise_rad: float = 0.05,
        on_corrupt: OnCorrupt = "raise",
        seed: int = 0,
        cache: bool | str | Path = True,
    ) -> None:
        super().__init__(edges=edges, stride=stride, on_corrupt=on_corrupt, seed=seed)
        one_of("decode", decode, ("cpu", "device"))
        one_of("activity", activity, ("all", "future"))
        if not (0 <= start_noise_m < np.inf and 0 <= start_noise_rad < np.inf):
            raise UsageError("start_noise_m and start_noise_rad are to be finite and not negative")
        self.steps = WindowSteps(history, future, history_frames, future_frames, tuple(rgb_steps))
        if activity == "future" and not future_frames:
            raise UsageError('activity="future" needs frames of the future (future_frames)')
        self._select(dataset, split, split_by, split_ratio)
        self._random_history = random_history
        self._activity = activity
        self._noise = np.repeat([start_noise_m, start_noise_rad], 3)
        layout = choose_layout(self.episodes, tactile=tactile, rgb=rgb, pose=pose, width=width)
        settings = TimelineSettings(
            Fraction(tick_s).limit_denominator(10**9),
            image_tolerance_s,
            max_gap_s,
            active_above,
            (self.steps.first, self.steps.last),
            tuple(self.steps.tactile_future.tolist()),
        )
        self._open(layout, settings, cache)
        self._proprioception = proprioception
        if proprioception and not self.layout.pose:
            raise UsageError("proprioception needs a pose stream", where=self.episodes.path)
        self._modalities = self._choose_modalities()
        self._masks = make_masks(mask, dropout, self._modalities)
        self._spec = self._make_spec(grey_tactile=grey_tactile, as_files=decode == "device")

    def _choose_modalities(self) -> tuple[str, ...]:
        there = {
            "tactile_history": bool(self.layout.tactile),
            "rgb": bool(self.layout.rgb),
            "action": bool(self.layout.low),
            "proprioception": self._proprioception,
        }
        return tuple(name for name, is_there in there.items() if is_there)

    def _make_spec(self, *, grey_tactile: bool, as_files: bool) -> dict[str, ItemSpec]:
        layout, steps = self.layout, self.steps
        tactile = steps.history_frames + steps.future_frames
        spec: dict[str, ItemSpec] = {}
        for name in layout.images:
            height, width, channels = layout.shapes[name]
            is_tactile = name in layout.tactile
            size = (height, width, 1 if grey_tactile and is_tactile else channels)
            count = tactile if is_tactile else len(steps.rgb)
            files = as_files and self.timeline.encodings[name] == "encoded"
            spec[name] = ItemSpec((count, *size), "uint8", image=True, files=files)
            spec[f"{name}_valid"] = ItemSpec((count,), "bool")
            if layout.references.get(name, False):
                spec[f"{name}_reference"] = ItemSpec(size, "uint8", image=True)
        if layout.tactile:
            spec["tactile_steps"] = ItemSpec((tactile,), "int64")
        columns = len(self.action_columns)
        motion = []
        if layout.low:
            motion.append(("action", len(steps.all), columns))
        if len(layout.pose) > 1:
            motion.append(("between", len(steps.all), len(self.between_columns)))
        if self._proprioception:
            motion.append(("proprioception", steps.history, columns))
        for name, length, width in motion:
            spec[name] = ItemSpec((length, width), "float32")
            spec[f"{name}_valid"] = ItemSpec((length,), "bool")
        for name in self._modalities:
            spec[f"{name}_masked"] = ItemSpec((), "bool")
        spec["padding"] = ItemSpec((len(steps.all),), "bool")
        spec["valid"] = ItemSpec((), "bool")
        spec["episode"] = ItemSpec((), "int64")
        spec["time_ns"] = ItemSpec((), "int64")
        counted = {"skip": "replaced", "substitute": "substituted"}.get(self._on_corrupt)
        if counted:
            spec[counted] = ItemSpec((), "int64")
        return spec

    @property
    def spec(self) -> Mapping[str, ItemSpec]:
        """Shape and type of each key of an item."""
        return self._spec

    @property
    def alike(self) -> Mapping[str, object]:
        """What windows must have in common with others to be mixed, beside their shapes."""
        return {
            "tick_s": self.timeline.settings.tick_s,
            "steps": self.steps,
            "action_columns": self.action_columns,
            "child frames": self.layout.children,
        }

    @property
    def action_columns(self) -> tuple[str, ...]:
        """Name of each column of ``action``: one gripper after the other, pose then width."""
        return action_columns(self.layout)

    @property
    def between_columns(self) -> tuple[str, ...]:
        """Name of each column of ``between``."""
        return between_columns(self.layout)

    def _fill(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, epochs: np.ndarray, at: np.ndarray
    ) -> np.ndarray:
        """Fill rows; return how many frames of each are damaged, (R,) int."""
        timeline, layout, steps = self.timeline, self.layout, self.steps
        episode = self._episode[at]
        drawn = self._draw(epochs, at)
        masked = drawn.masked
        for name, values in masked.items():
            arrays[f"{name}_masked"][rows] = values
        if drawn.tactile_steps is not None:
            arrays["tactile_steps"][rows] = drawn.tactile_steps
        complete = np.ones(len(at), dtype=bool)
        damaged = np.zeros(len(at), dtype=np.int64)
        for name, (frames, hidden) in drawn.frames.items():
            there, bad = self._add_frames(arrays, name, rows, at, frames)
            complete &= (there | hidden).all(axis=1)
            damaged += bad
        flat, padding = self._ticks(at, steps.all)
        complete &= ~padding.any(axis=1)
        if layout.low:
            action = relative_actions(timeline, flat, zero=steps.zero)
            complete &= _put(arrays, "action", rows, *action, padding, masked["action"])
        if len(layout.pose) > 1:
            between = between_grippers(timeline, flat, zero=steps.zero)
            complete &= _put(arrays, "between", rows, *between, padding, masked["action"])
        if self._proprioception:
            count = len(layout.pose)
            noise = normal(self._seed, epochs, at, count * 6, purpose=_NOISE)
            noise = noise.reshape(-1, count, 6) * self._noise
            past = slice(None, steps.history)
            known = relative_to_start(timeline, flat[:, past], timeline.edges[episode], noise)
            hidden = masked["proprioception"]
            complete &= _put(arrays, "proprioception", rows, *known, padding[:, past], hidden)
        arrays["padding"][rows] = padding
        arrays["valid"][rows] = complete
        arrays["episode"][rows] = episode
        arrays["time_ns"][rows] = self._time_ns(at)
        return damaged

    def _frames(self, epochs: np.ndarray, at: np.ndarray) -> dict[str, np.ndarray]:
        """Return of each image stream the frames of windows, but for hidden ones."""
        return {name: frames for name, (frames, _) in self._draw(epochs, at).frames.items()}

    def _draw(self, epochs: np.ndarray, at: np.ndarray) -> _Drawn:
        """Draw what windows leave out and the steps of their history."""
        layout, steps = self.layout, self.steps
        masked = {name: self._masks.draw(name, self._seed, epochs, at) for name in self._modalities}
        tactile_steps = None
        frames: dict[str, tuple[np.ndarray, np.ndarray]] = {}
        if layout.tactile:
            tactile_steps = self._tactile_steps(epochs, at)
            hidden = np.zeros(tactile_steps.shape, dtype=bool)
            hidden[:, : steps.history_frames] = masked["tactile_history"][:, None]
            flat, _ = self._ticks(at, tactile_steps)
            for name in layout.tactile:
                frames[name] = np.where(hidden, -1, self.timeline.frame[name][flat]), hidden
        if layout.rgb:
            flat, _ = self._ticks(at, np.array(steps.rgb))
            hidden = np.repeat(masked["rgb"][:, None], len(steps.rgb), axis=1)
            for name in layout.rgb:
                frames[name] = np.where(hidden, -1, self.timeline.frame[name][flat]), hidden
        return _Drawn(masked, tactile_steps, frames)

    def _tactile_steps(self, epochs: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        steps, count = self.steps, self.steps.history_frames
        if self._random_history:
            history = history_steps(self._seed, epochs, chosen, steps=steps.past, count=count)
        else:
            history = np.broadcast_to(steps.fixed_history, (len(chosen), count))
        future = np.broadcast_to(steps.tactile_future, (len(chosen), steps.future_frames))
        return np.concatenate((history, future), axis=1)


def _put(  # what, where, and what is wrong with it
    arrays: Mapping[str, np.ndarray],
    name: str,
    rows: np.ndarray,
    values: np.ndarray,
    valid: np.ndarray,
    padding: np.ndarray,
    masked: np.ndarray,
) -> np.ndarray:
    """Store what was computed of a modality; return which windows have it whole, or masked."""
    valid = valid & ~padding
    complete = np.asarray(valid.all(axis=1) | masked)
    arrays[name][rows] = np.where(masked[:, None, None], np.float32(0), values)
    arrays[f"{name}_valid"][rows] = valid & ~masked[:, None]
    return complete
