"""A simulated play session: the truth, and what five sensors say about it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from exumi_data.simulation.encoder import WidthEncoder
from exumi_data.simulation.gel_look import PAD_WIDTH_M, make_pad
from exumi_data.simulation.motion import (
    Float64Array,
    multiply_quaternions,
    quaternion_from_rotation_vector,
)
from exumi_data.simulation.objects import OBJECTS, Finger, object_by_name
from exumi_data.simulation.plan import plan_play
from exumi_data.simulation.streams import SimulatedStream, sample_times_ns
from exumi_data.simulation.truth import Grasp, Truth

__all__ = ["DEFAULT_LATENCY_NS", "PlaySession", "simulate_play"]

DEFAULT_LATENCY_NS: Mapping[str, int] = {
    "tactile_left": 42_000_000,
    "tactile_right": 47_000_000,
    "rgb": 95_000_000,
    "pose": 28_000_000,
    "width": 1_200_000,
}
"""Latencies in the order of magnitude of USB cameras, an action camera's capture card, a headset
over Wi-Fi and an I2C encoder."""

TACTILE_RATE_HZ = 30.0
RGB_RATE_HZ = 30.0
POSE_RATE_HZ = 90.0
WIDTH_RATE_HZ = 200.0

_MIN_DURATION_S = 3.0
_MIN_SIDE_PX = 32
_POSE_NOISE_M = 1.5e-4
_POSE_NOISE_RAD = 8e-4
_ENCODER_NOISE_M = 4e-5
_CAMERA_JITTER_S = 4e-4
_POSE_JITTER_S = 1.0e-3
_WIDTH_JITTER_S = 1.0e-4


@dataclass(frozen=True, slots=True)
class PlaySession:
    """A play session.

    Attributes
    ----------
    seed : int
        The seed it was made from.
    truth : Truth
        What really happens, at any time.
    streams : dict of str to SimulatedStream
        ``tactile_left``, ``tactile_right``, ``rgb``, ``pose``, ``width``.
    tactile_m_per_px : float
        Scale of the tactile images, metres per pixel along both axes.
    dotted : bool
        Whether the pads have dots.
    encoder : WidthEncoder
        How the width stream's counts become metres.
    camera_matrix : ndarray of float64, shape (3, 3)
        Intrinsics of the wrist camera, pixels; no distortion.
    gripper_camera : ndarray of float64, shape (4, 4)
        ``T_gripper_camera``: x right, y down, z forward, metres.
    """

    seed: int
    truth: Truth
    streams: dict[str, SimulatedStream]
    tactile_m_per_px: float
    dotted: bool
    encoder: WidthEncoder
    camera_matrix: Float64Array
    gripper_camera: Float64Array

    @property
    def grasps(self) -> tuple[Grasp, ...]:
        """The grasps in order of time: the session's natural segments."""
        return self.truth.grasps


def simulate_play(  # noqa: PLR0913  # keyword-only options, each with a default
    *,
    seed: int = 0,
    duration_s: float = 20.0,
    objects: Sequence[str] | None = None,
    tactile_size: tuple[int, int] = (240, 320),
    rgb_size: tuple[int, int] = (240, 320),
    dotted: bool = False,
    latency_ns: Mapping[str, int] = DEFAULT_LATENCY_NS,
    drop: float = 0.0,
    taps: int = 0,
) -> PlaySession:
    """Return a play session with known truth.

    The same arguments give the same session, bit for bit on the same machine and library
    versions. Images are drawn only when asked for.

    Parameters
    ----------
    seed : int, optional
        Chooses everything that is left to chance; not negative.
    duration_s : float, optional
        Length in seconds, at least 3; about one grasp every 5 s.
    objects : sequence of str, optional
        What lies on the table, grasped in turn; all of ``OBJECTS`` if not given.
    tactile_size, rgb_size : (int, int), optional
        Height and width of the images, pixels, at least 32 each.
    dotted : bool, optional
        Print dots on the pads.
    latency_ns : mapping of str to int, optional
        Latency of streams by name, nanoseconds, not negative; those not named keep their default.
    drop : float, optional
        Part of the frames and poses that get lost, 0 to below 1. The width never loses samples:
        it is polled by the hub itself.
    taps : int, optional
        How often, at most, the fingers close on an object and open again before they pick it up, at
        random times and to random depths; not negative. Each makes a grasp 0.9 s longer.

    Returns
    -------
    PlaySession
        The session.

    Raises
    ------
    ValueError
        If an argument is outside its range or names something unknown.
    """
    _check_arguments(seed, duration_s, tactile_size, rgb_size, latency_ns, drop)
    if taps < 0:
        raise ValueError(f"Invalid taps ({taps}). It must not be negative.")
    names = [item.name for item in OBJECTS] if objects is None else list(objects)
    if not names:
        raise ValueError("Invalid objects (none). Name at least one, or leave it out for all.")
    lying = tuple(object_by_name(name) for name in names)
    truth = plan_play(_rng(seed, 0), duration_s, lying, taps=taps)
    sampler = _Sampler(seed, truth, drop, {**DEFAULT_LATENCY_NS, **latency_ns})
    encoder = WidthEncoder()
    rgb, camera_matrix, gripper_camera = sampler.wrist(rgb_size)
    streams = (
        sampler.tactile("left", tactile_size, dotted),
        sampler.tactile("right", tactile_size, dotted),
        rgb,
        sampler.pose(),
        sampler.width(encoder),
    )
    return PlaySession(
        seed=seed,
        truth=truth,
        streams={stream.name: stream for stream in streams},
        tactile_m_per_px=PAD_WIDTH_M / tactile_size[1],
        dotted=dotted,
        encoder=encoder,
        camera_matrix=camera_matrix,
        gripper_camera=gripper_camera,
    )


@dataclass(frozen=True, slots=True)
class _Sampler:
    """Samples the truth with each of the sensors."""

    seed: int
    truth: Truth
    drop: float
    latency_ns: Mapping[str, int]

    def tactile(self, finger: Finger, size: tuple[int, int], dotted: bool) -> SimulatedStream:
        from exumi_data.simulation.renderers import make_tactile_renderer

        name, number = ("tactile_left", 1) if finger == "left" else ("tactile_right", 2)
        capture_ns, sequence = self._times(number, TACTILE_RATE_HZ, _CAMERA_JITTER_S, self.drop)
        pad = make_pad(size, dotted=dotted, seed=_number(self.seed, number, 1))
        noise_seed = _number(self.seed, number, 2)
        return SimulatedStream(
            name=name,
            kind="tactile",
            rate_hz=TACTILE_RATE_HZ,
            latency_ns=self.latency_ns[name],
            time_ns=capture_ns + self.latency_ns[name],
            sequence=sequence,
            reference=pad.reference(),
            renderer=make_tactile_renderer(self.truth, finger, pad, capture_ns * 1e-9, noise_seed),
        )

    def wrist(self, size: tuple[int, int]) -> tuple[SimulatedStream, Float64Array, Float64Array]:
        """Return the camera's stream, its intrinsics and its place on the gripper."""
        from exumi_data.simulation.camera import make_camera
        from exumi_data.simulation.renderers import make_wrist_renderer

        capture_ns, sequence = self._times(3, RGB_RATE_HZ, _CAMERA_JITTER_S, self.drop)
        camera = make_camera(size, seed=_number(self.seed, 3, 1))
        noise_seed = _number(self.seed, 3, 2)
        stream = SimulatedStream(
            name="rgb",
            kind="rgb",
            rate_hz=RGB_RATE_HZ,
            latency_ns=self.latency_ns["rgb"],
            time_ns=capture_ns + self.latency_ns["rgb"],
            sequence=sequence,
            renderer=make_wrist_renderer(self.truth, camera, capture_ns * 1e-9, noise_seed),
        )
        return stream, camera.matrix, camera.gripper_camera

    def pose(self) -> SimulatedStream:
        capture_ns, sequence = self._times(4, POSE_RATE_HZ, _POSE_JITTER_S, self.drop)
        noise = _rng(self.seed, 4, 1).standard_normal((len(capture_ns), 6))
        data = self.truth.pose(capture_ns * 1e-9)
        data[:, :3] += _POSE_NOISE_M * noise[:, :3]
        turn = quaternion_from_rotation_vector(_POSE_NOISE_RAD * noise[:, 3:])
        data[:, 3:] = multiply_quaternions(data[:, 3:], turn)
        return SimulatedStream(
            name="pose",
            kind="pose",
            rate_hz=POSE_RATE_HZ,
            latency_ns=self.latency_ns["pose"],
            time_ns=capture_ns + self.latency_ns["pose"],
            sequence=sequence,
            data=data,
        )

    def width(self, encoder: WidthEncoder) -> SimulatedStream:
        capture_ns, sequence = self._times(5, WIDTH_RATE_HZ, _WIDTH_JITTER_S, 0.0)
        noise_m = _ENCODER_NOISE_M * _rng(self.seed, 5, 1).standard_normal(len(capture_ns))
        raw = encoder.counts(self.truth.width_m(capture_ns * 1e-9) + noise_m)
        return SimulatedStream(
            name="width",
            kind="width",
            rate_hz=WIDTH_RATE_HZ,
            latency_ns=self.latency_ns["width"],
            time_ns=capture_ns + self.latency_ns["width"],
            sequence=sequence,
            data=encoder.width_m(raw),
            raw=raw,
        )

    def _times(
        self, number: int, rate_hz: float, jitter_s: float, drop: float
    ) -> tuple[np.ndarray, np.ndarray]:
        return sample_times_ns(
            _rng(self.seed, number), self.truth.duration_s, rate_hz, jitter_s=jitter_s, drop=drop
        )


def _rng(*key: int) -> np.random.Generator:
    return np.random.default_rng(key)


def _number(*key: int) -> int:
    """Return a seed that is independent of those of other keys."""
    return int(np.random.SeedSequence(key).generate_state(1)[0])


def _check_arguments(
    seed: int,
    duration_s: float,
    tactile_size: tuple[int, int],
    rgb_size: tuple[int, int],
    latency_ns: Mapping[str, int],
    drop: float,
) -> None:
    if seed < 0:
        raise ValueError(f"Invalid seed ({seed}). It must not be negative.")
    if not _MIN_DURATION_S <= duration_s < float("inf"):
        raise ValueError(f"Invalid duration_s ({duration_s}). It must be at least 3 seconds.")
    for name, size in (("tactile_size", tactile_size), ("rgb_size", rgb_size)):
        if min(size) < _MIN_SIDE_PX:
            raise ValueError(f"Invalid {name} ({size}). Height and width must be at least 32.")
    if not 0.0 <= drop < 1.0:
        raise ValueError(f"Invalid drop ({drop}). It must lie in [0, 1).")
    for name, value in latency_ns.items():
        if name not in DEFAULT_LATENCY_NS:
            names = ", ".join(DEFAULT_LATENCY_NS)
            raise ValueError(f"Invalid stream in latency_ns ({name!r}). Supported: {names}.")
        if value < 0:
            raise ValueError(f"Invalid latency_ns of {name} ({value}). It must not be negative.")
