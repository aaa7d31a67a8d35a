"""Windows for policies in the style of Diffusion Policy, with what is late at run time."""

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from exumi_data.errors import UsageError
from exumi_data.ticks import DEFAULT_TICK_S
from exumi_loaders.actions import motion_columns
from exumi_loaders.at_hand import Observed
from exumi_loaders.buffers import ItemSpec
from exumi_loaders.episode_windows import EpisodeWindows
from exumi_loaders.layout import Layout, Names, choose_layout
from exumi_loaders.observation import base_poses, put_proprioception
from exumi_loaders.options import one_of
from exumi_loaders.policy_spec import PolicySpec, PolicyStreamSpec
from exumi_loaders.timeline import TimelineSettings
from exumi_loaders.window_frames import OnCorrupt
from exumi_loaders.windows import Item

if TYPE_CHECKING:
    from exumi_data.dataset import Dataset as EpisodeDataset

__all__ = ["PolicyWindows"]

_LONGEST_S = 60.0  # of a latency or a stale limit: more is a mistake in the unit


class PolicyWindows(EpisodeWindows):
    """Windows of observations and actions: what a policy has at hand at a tick, and what was done.

    A stream is late at run time: its sample is at hand only some time after it was captured. A
    window of the tick at time t holds, for each observed step and stream, the newest sample that
    was captured at least ``latency_s`` before that step: what `PolicyStream` would give at t. No
    sample of a later time is looked at, not even to interpolate.

    Actions are where the grippers really were at the ticks after t, interpolated. Relative ones are
    ``inv(T)·T_then`` in the child frame of the pose stream, where T is the pose *at hand* at t: at
    run time no other is known. With several grippers each is relative to its own.

    Every item is a dict of tensors (a batch has one more axis in front). n observed steps, A
    actions, G grippers with pose and width:

    ========================  ======================  ============================================
    key                       shape, dtype            meaning
    ========================  ======================  ============================================
    ``<image stream>``        (n, C, H, W) uint8      frames at hand
    ``<stream>_valid``        (n,) bool               a frame is there: not stale, not damaged
    ``<stream>_reference``    (C, H, W) uint8         image without contact (tactile)
    ``proprioception``        (n, 10·G) float32       poses and widths at hand, as ``action``
    ``proprioception_valid``  (n,) bool               not stale
    ``between``               (n, 9·(G−1)) float32    of several poses: as seen from the first one
                                                      at step 0; `between_columns`
    ``between_valid``         (n,) bool               not stale
    ``observation_padding``   (n,) bool               the step lies before the first tick, which
                                                      stands for it
    ``action``                (A, 10·G) float32       `action_columns`: x y z, the first two rows
                                                      of the rotation matrix, absolute width
    ``action_valid``          (A,) bool               measured there (no sample gap), inside the
                                                      episode; relative to a pose that is not stale
    ``action_padding``        (A,) bool               after the last tick, which stands for it
    ``valid``                 () bool                 all of the above that end in ``_valid`` are
    ``episode``               () int64                position in ``windows.episodes``
    ``time_ns``               () int64                time of step 0 since the episode's start
    ``replaced``              () int64                ``on_corrupt="skip"`` only: see `TPPWindows`
    ``substituted``           () int64                ``on_corrupt="substitute"`` only
    ========================  ======================  ============================================

    An episode's first tick is when all its streams are at hand, its last is when one of them ends.
    Stale frames are black; a stale pose or width keeps its last value and is not valid.

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
        Train to val.
    tactile, rgb, pose, width : str or sequence of str, optional
        Streams in the wanted order; default all of the kind, sorted by name. An empty sequence
        takes none.
    grey_tactile : bool
        Give one channel (luma) of tactile frames that are stored in colour.
    observation_steps, action_steps : int
        Number of observations, the last at step 0, and of actions.
    observation_stride, action_stride : int
        Distance of two of them in ticks.
    first_action : int
        Where the first action lies, in strides after step 0. 0 begins with the pose at step 0
        itself, as UMI does.
    tick_s : fractions.Fraction or float
        Distance of two ticks; default 3/59.94 s.
    latency_s : mapping of str to float, optional
        Of each stream how long after its capture a sample is at hand at run time; 0 for those that
        are not named. Measure it: give what nearly all samples keep to, not the mean.
    stale_s : float or mapping of str to float
        How much older than its latency a sample may be.
    max_gap_s : float, optional
        Longest stretch that actions are interpolated over; see `TimelineSettings`.
    action : {"relative", "absolute"}
        Absolute poses are in the parent frame, which has to be the same in all episodes.
    proprioception : bool
        Give poses and widths with the observations.
    same_calibration : bool
        Refuse episodes whose poses have the same child frame, but other values of its calibration.
    edges : {"pad", "drop"}
        Whether every tick is the step 0 of a window, or only those whose steps all lie within
        the episode.
    stride : int
        Distance of windows in ticks.
    active_above : float, optional
        Activity above which a frame is active; default what is stored with the activity.
    on_corrupt : {"raise", "skip", "substitute"}
        What happens at damaged data; see `TPPWindows`.
    seed : int
        Of draws and splits.
    cache : bool or path
        Keep the timelines in the user's cache folder (default), in a given folder, or nowhere.

    Raises
    ------
    UsageError
        Streams are missing, differ in size, or there is neither pose nor width; poses have other
        child frames, calibrations or (absolute actions) parent frames: both episodes are named.

    Examples
    --------
    >>> windows = PolicyWindows(dataset, latency_s={"rgb": 0.12})  # doctest: +SKIP
    >>> for batch in windows.loader(batch_size=64):  # doctest: +SKIP
    ...     batch["action"].shape
    torch.Size([64, 16, 10])
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
        observation_steps: int = 2,
        action_steps: int = 16,
        observation_stride: int = 1,
        action_stride: int = 1,
        first_action: int = 1,
        tick_s: Fraction | float = DEFAULT_TICK_S,
        latency_s: Mapping[str, float] | None = None,
        stale_s: float | Mapping[str, float] = 0.25,
        max_gap_s: float | None = None,
        action: Literal["relative", "absolute"] = "relative",
        proprioception: bool = True,
        same_calibration: bool = True,
        edges: Literal["pad", "drop"] = "pad",
        stride: int = 1,
        active_above: float | None = None,
        on_corrupt: OnCorrupt = "raise",
        seed: int = 0,
        cache: bool | str | Path = True,
    ) -> None:
        super().__init__(edges=edges, stride=stride, on_corrupt=on_corrupt, seed=seed)
        one_of("action", action, ("relative", "absolute"))
        observed = _steps("observation", observation_steps, observation_stride)
        self._action_steps = first_action * action_stride + np.array(
            _steps("action", action_steps, action_stride)
        )
        if first_action < 0:
            raise UsageError(f"first_action is {first_action}, which lies before step 0")
        self._select(dataset, split, split_by, split_ratio)
        layout = choose_layout(self.episodes, tactile=tactile, rgb=rgb, pose=pose, width=width)
        if not layout.low:
            raise UsageError("no pose and no width to make actions of", where=dataset.path)
        latency = dict.fromkeys(layout.streams, 0.0) | dict(latency_s or {})
        stale = dict.fromkeys(layout.streams, 0.25)
        stale |= stale_s if isinstance(stale_s, Mapping) else dict.fromkeys(stale, stale_s)
        settings = TimelineSettings(
            tick_s=Fraction(tick_s).limit_denominator(10**9),
            max_gap_s=max_gap_s,
            active_above=active_above,
            span=(-observed[-1], int(self._action_steps[-1])),
            future_steps=(),
            observed=Observed(
                tuple(-step for step in reversed(observed)),
                _nanoseconds("latency_s", latency, layout),
                _nanoseconds("stale_s", stale, layout),
            ),
        )
        self._open(layout, settings, cache)
        self._same_calibration = same_calibration
        self._check_frames(action)
        self.policy_spec = self._describe(settings, action, proprioception, grey_tactile)
        self._spec = self._make_spec()

    def _check_frames(self, action: str) -> None:
        layout = self.layout
        for name in layout.pose:
            if self._same_calibration:
                self._refuse_mixture(
                    f"the calibration of {name} (tool frame {layout.children[name]!r})",
                    layout.calibrations[name],
                    "Select episodes of one calibration; or, if it is the same tool measured "
                    "twice, same_calibration=False.",
                )
            if action == "absolute":
                self._refuse_mixture(
                    f"the parent frame of {name}",
                    layout.parents[name],
                    'Select episodes of one parent frame, or take action="relative".',
                )

    def _refuse_mixture(self, what: str, found: Mapping[str, str], fix: str) -> None:
        if len(found) < 2:
            return
        (one, first), (other, second) = list(found.items())[:2]
        raise UsageError(
            f"{what} is {_short(one)} in episode {first} and {_short(other)} in {second}: their "
            "actions are not the same thing",
            where=self.episodes.path,
            fix=fix,
        )

    def _describe(
        self,
        settings: TimelineSettings,
        action: Literal["relative", "absolute"],
        proprioception: bool,
        grey_tactile: bool,
    ) -> PolicySpec:
        layout, observed = self.layout, settings.observed
        assert observed is not None  # noqa: S101  # as __init__ made it
        kinds = ("tactile", "rgb", "pose", "width")
        streams = {}
        for kind in kinds:
            for name in getattr(layout, kind):
                height, width, channels = layout.shapes.get(name, (None, None, None))
                streams[name] = PolicyStreamSpec.model_validate(
                    {
                        "kind": kind,
                        "latency_ns": observed.latency_ns[name],
                        "stale_ns": observed.stale_ns[name],
                        "height": height,
                        "width": width,
                        "channels": channels,
                        "grey": grey_tactile and kind == "tactile" and channels == 3,
                        "reference": layout.references.get(name, False),
                        "parents": tuple(sorted(layout.parents.get(name, ()))),
                        "child": layout.children.get(name),
                        "calibrations": tuple(sorted(layout.calibrations.get(name, ()))),
                    }
                )
        return PolicySpec(
            tick_s=str(settings.tick_s),
            observation_steps=observed.steps,
            action_steps=tuple(self._action_steps.tolist()),
            action=action,
            proprioception=proprioception,
            tactile=layout.tactile,
            rgb=layout.rgb,
            pose=layout.pose,
            width=layout.width,
            streams=streams,
            dataset=self.episodes.fingerprint,
            split=self.split,
        )

    def _make_spec(self) -> dict[str, ItemSpec]:
        length = len(self._action_steps)
        spec = self.policy_spec.observation
        spec["action"] = ItemSpec((length, len(self.action_columns)), "float32")
        spec["action_valid"] = ItemSpec((length,), "bool")
        spec["action_padding"] = ItemSpec((length,), "bool")
        spec["valid"] = ItemSpec((), "bool")
        spec["episode"] = ItemSpec((), "int64")
        spec["time_ns"] = ItemSpec((), "int64")
        counted = {"skip": "replaced", "substitute": "substituted"}.get(self._on_corrupt)
        if counted:
            spec[counted] = ItemSpec((), "int64")
        return spec

    @property
    def spec(self) -> Mapping[str, ItemSpec]:
        """Shape and type of each key of an item; see `policy_spec` for what they mean."""
        return self._spec

    @property
    def alike(self) -> Mapping[str, object]:
        """What windows must have in common with others to be mixed, beside their shapes."""
        layout, spec = self.layout, self.policy_spec
        alike = {**spec.motion, "latency_ns": {n: s.latency_ns for n, s in spec.streams.items()}}
        if self._same_calibration:
            alike["calibration"] = {name: sorted(layout.calibrations[name]) for name in layout.pose}
        if spec.action == "absolute":
            alike["parent frames"] = {name: sorted(layout.parents[name]) for name in layout.pose}
        return alike

    @property
    def action_columns(self) -> tuple[str, ...]:
        """Name of each column of ``action``: one gripper after the other, pose then width."""
        return self.policy_spec.action_columns

    @property
    def between_columns(self) -> tuple[str, ...]:
        """Name of each column of ``between``."""
        return self.policy_spec.between_columns

    def observation(self, item: Item) -> Item:
        """Return the part of an item or a batch that a policy is given: as `PolicyStream` does.

        Parameters
        ----------
        item : dict of str to Tensor
        """
        return {name: item[name] for name in self.policy_spec.observation}

    def low_dimensional(self, at: np.ndarray) -> dict[str, np.ndarray]:
        """Return what is not images of some windows; nothing is decoded.

        Parameters
        ----------
        at : (R,) int64
            Which windows, in [0, len(self)).

        Returns
        -------
        dict of str to ndarray
            ``action``, ``proprioception``, ``between`` and the ``..._valid`` of each.
        """
        names = [name for name in ("action", "proprioception", "between") if name in self.spec]
        names += [f"{name}_valid" for name in names]
        names += ["observation_padding", "action_padding"]
        arrays = {
            name: np.zeros((len(at), *self.spec[name].shape), self.spec[name].dtype)
            for name in names
        }
        self._add_motion(arrays, np.arange(len(at)), at)
        return arrays

    def _frames(self, epochs: np.ndarray, at: np.ndarray) -> dict[str, np.ndarray]:
        """Return of each image stream the frames at hand; nothing is drawn."""
        anchors = self._anchors[at]
        return {
            name: np.asarray(self.timeline.seen_frame[name][anchors]) for name in self.layout.images
        }

    def _fill(
        self,
        arrays: Mapping[str, np.ndarray],
        rows: np.ndarray,
        epochs: np.ndarray,
        at: np.ndarray,
    ) -> np.ndarray:
        """Fill rows; return how many frames of each are damaged, (R,) int."""
        complete = self._add_motion(arrays, rows, at)
        damaged = np.zeros(len(at), dtype=np.int64)
        for name, frames in self._frames(epochs, at).items():
            there, bad = self._add_frames(arrays, name, rows, at, frames)
            complete &= there.all(axis=1)
            damaged += bad
        arrays["valid"][rows] = complete
        arrays["episode"][rows] = self._episode[at]
        arrays["time_ns"][rows] = self._time_ns(at)
        return damaged

    def _add_motion(
        self, arrays: Mapping[str, np.ndarray], rows: np.ndarray, at: np.ndarray
    ) -> np.ndarray:
        """Fill actions and proprioception; return of which windows all of them are valid."""
        timeline, spec, anchor = self.timeline, self.policy_spec, self._anchors[at]
        low = self.layout.low
        seen = {name: np.asarray(timeline.seen_low[name][anchor]) for name in low}
        fresh = {name: np.asarray(timeline.seen_valid[name][anchor]) for name in low}
        put_proprioception(spec, arrays, rows, seen, fresh)
        ticks, padding = self._ticks(at, self._action_steps)
        base = base_poses(spec, seen)
        values, valid = timeline.motion(ticks)
        valid &= ~padding
        for name in self.layout.pose if base is not None else ():
            valid &= fresh[name][:, -1:]
        arrays["action"][rows] = motion_columns(self.layout.grippers, values, base)
        arrays["action_valid"][rows] = valid
        arrays["action_padding"][rows] = padding
        arrays["observation_padding"][rows] = self._observation_padding(at)
        complete = valid.all(axis=1)
        for name in ("proprioception_valid", "between_valid"):
            if name in arrays:
                complete &= arrays[name][rows].all(axis=1)
        return np.asarray(complete)

    def _observation_padding(self, at: np.ndarray) -> np.ndarray:
        """Return at which observed steps the episode's first tick stands for an earlier time."""
        timeline = self.timeline
        since_first = self._time_ns(at) - timeline.start_ns[self._episode[at]]
        before = timeline.tick_offset_ns(-np.array(self.policy_spec.observation_steps))
        return np.asarray(since_first[:, None] < before)


def _steps(name: str, count: int, stride: int) -> list[int]:
    if count < 1 or stride < 1:
        raise UsageError(f"{name}_steps is {count} and {name}_stride {stride}: both at least 1")
    return [step * stride for step in range(count)]


def _nanoseconds(option: str, seconds: Mapping[str, float], layout: Layout) -> dict[str, int]:
    for name, value in seconds.items():
        if name not in layout.streams:
            raise UsageError(
                f"{option} names {name!r}, which these windows do not have",
                fix=f"They have {', '.join(layout.streams)}.",
            )
        if not 0 <= value <= _LONGEST_S:
            raise UsageError(f"{option} of {name} is {value}, not in [0, {_LONGEST_S:g}] seconds")
    return {name: round(seconds[name] * 1e9) for name in layout.streams}


def _short(value: str) -> str:
    return repr(value[:12]) if value else "not stated"
