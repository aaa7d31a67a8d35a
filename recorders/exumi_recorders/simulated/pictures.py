"""The JPEG files that simulated cameras send."""

from collections.abc import Callable
from typing import Protocol

import numpy as np

from exumi_data.simulation import Finger, PlaySession
from exumi_data.simulation.renderers import (
    TactileRenderer,
    WristRenderer,
    make_tactile_renderer,
    make_wrist_renderer,
)
from exumi_data.store import jpeg
from exumi_data.time import NS_PER_S
from exumi_recorders.simulated.camera_setup import CameraSetup

__all__ = ["Pictures", "jpeg_of_size", "pictures_of"]

_CHUNK = 32
_LOOP = 8
_COMMENT_HEAD = 4
_COMMENT_MOST = 65_533 - 2


class Pictures(Protocol):
    """Gives the file of frame `k`."""

    def __call__(self, k: int) -> bytes:
        """Return the JPEG of frame `k`."""


def pictures_of(setup: CameraSetup) -> Pictures:
    """Return what a camera shows; unless it is live, everything is drawn now."""
    if setup.shows == "synthetic":
        loop = [_synthetic(setup, index) for index in range(_LOOP)]
        return lambda k: loop[k % _LOOP]
    drawn = _Drawn(setup, setup.play.session(size=(setup.height, setup.width)))
    if setup.live:
        return drawn
    count = setup.frames_of_session
    files = [drawn(k) for k in range(count)]
    tail = min(count, max(1, round(float(NS_PER_S / setup.period))))
    return lambda k: files[k if k < count else count - tail + (k - count) % tail]


class _Drawn:
    """Draws the frames of a play session; the truth is looked up for many frames at once."""

    def __init__(self, setup: CameraSetup, session: PlaySession) -> None:
        self._setup = setup
        self._session = session
        self._bands = setup.bands if setup.readout_ns else 1
        self._moments = setup.exposures if setup.exposure_ns else 1
        self._chunk = -1
        self._render: Callable[[int], np.ndarray] | None = None

    def __call__(self, k: int) -> bytes:
        chunk, within = divmod(k, _CHUNK)
        if chunk != self._chunk or self._render is None:
            self._render, self._chunk = self._renderer(chunk), chunk
        render, per_frame = self._render, self._bands * self._moments
        height = self._setup.height
        edges = [height * band // self._bands for band in range(self._bands + 1)]
        strips = []
        for band in range(self._bands):
            first = within * per_frame + band * self._moments
            rows = slice(edges[band], edges[band + 1])
            seen = [render(first + moment)[rows] for moment in range(self._moments)]
            strips.append(seen[0] if len(seen) == 1 else _mean(seen))
        return jpeg.encode(np.concatenate(strips), self._setup.quality)

    def _renderer(self, chunk: int) -> Callable[[int], np.ndarray]:
        setup = self._setup
        starts_ns = np.array([setup.exposure_start_ns(chunk * _CHUNK + i) for i in range(_CHUNK)])
        band_ns = (np.arange(self._bands) + 0.5) / self._bands * setup.readout_ns
        moment_ns = (np.arange(self._moments) + 0.5) / self._moments * setup.exposure_ns
        since_ns = (starts_ns - setup.epoch_ns)[:, None, None]
        t_s = (since_ns + band_ns[:, None] + moment_ns).reshape(-1) / NS_PER_S
        renderer = self._session.streams[setup.shows].renderer
        truth, seed = self._session.truth, chunk * len(t_s)
        if isinstance(renderer, TactileRenderer):
            finger: Finger = "left" if setup.shows == "tactile_left" else "right"
            return make_tactile_renderer(truth, finger, renderer.pad, t_s, renderer.seed + seed)
        if isinstance(renderer, WristRenderer):
            return make_wrist_renderer(truth, renderer.camera, t_s, renderer.seed + seed)
        msg = f"the session has no camera {setup.shows}"
        raise TypeError(msg)


def _mean(images: list[np.ndarray]) -> np.ndarray:
    mean: np.ndarray = np.stack(images).mean(axis=0, dtype=np.float32)
    return mean.round().astype(np.uint8)


def _synthetic(setup: CameraSetup, index: int) -> bytes:
    """Return a picture of noise on a gradient."""
    rng = np.random.default_rng((setup.seed, 3, index))
    ramp = np.linspace(40, 200, setup.width, dtype=np.float32)[None, :, None]
    coarse = rng.normal(0.0, 18.0, (setup.height // 4 + 1, setup.width // 4 + 1, 3))
    noise = coarse.repeat(4, axis=0).repeat(4, axis=1)[: setup.height, : setup.width]
    image = np.clip(ramp + noise, 0, 255).astype(np.uint8)
    return jpeg_of_size(image, setup.bytes_per_frame)


def jpeg_of_size(image: np.ndarray, size: int) -> bytes:
    """Return an image as a JPEG of exactly `size` bytes.

    The best quality that fits is taken; comments fill what is left.

    Parameters
    ----------
    image : ndarray of uint8, shape (H, W, 3)
    size : int

    Raises
    ------
    ValueError
        The image does not fit at any quality.
    """
    low, high, best = 1, 100, b""
    while low <= high:
        quality = (low + high) // 2
        file = jpeg.encode(image, quality)
        # What is left must have room for a comment's head, or be nothing.
        if len(file) == size or len(file) <= size - _COMMENT_HEAD:
            best, low = file, quality + 1
        else:
            high = quality - 1
    if not best:
        msg = f"Invalid size ({size}). The image takes more bytes even at the lowest quality."
        raise ValueError(msg)
    return best[:2] + _comments(size - len(best)) + best[2:]


def _comments(size: int) -> bytes:
    """Return comment segments of exactly `size` bytes in all (0, or at least 4)."""
    found = b""
    while size:
        length = min(size - _COMMENT_HEAD, _COMMENT_MOST)
        if 0 < size - _COMMENT_HEAD - length < _COMMENT_HEAD:
            length -= _COMMENT_HEAD
        found += b"\xff\xfe" + (length + 2).to_bytes(2, "big") + b"." * length
        size -= _COMMENT_HEAD + length
    return found
