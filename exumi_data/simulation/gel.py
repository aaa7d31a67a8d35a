"""A visuo-tactile gel pad: membrane deformation and three-colour shading.

The pad is flat and soft, watched from inside by a camera, and lit by a red, a green and a blue
light from three sides at low elevation (GelSight: Johnson and Adelson 2009; Yuan, Dong and
Adelson 2017). A rigid height map pressed in by some depth makes the membrane follow the object
where they touch and fall off smoothly around it (the pyramid of Gaussians of Si and Yuan, *Taxim*,
2022). The shading is Lambert's law for each light on the membrane's normals.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np

from exumi_data.simulation.gel_look import COLOUR_MIX, LIGHT_DIRECTIONS, NOISE_MARGIN
from exumi_data.simulation.pixels import Float32Array, UInt8Array, as_float32, as_uint8

__all__ = ["Contact", "GelPad"]

_HALO_SIGMAS_MM = (2.6, 1.2, 0.5)
_HALO_SHRINK = 4
_SKIN_SIGMA_MM = 0.17
_SHARPNESS_SIGMA_MM = 0.05
_AMBIENT = 0.14
_HIGHLIGHT = 0.35
_DOT_SHRINK = 8
_DOT_SPREAD_MM = 0.35


@dataclass(frozen=True, slots=True)
class Contact:
    """How an object touches a pad at one moment.

    Attributes
    ----------
    depth_m : float
        Indentation of the object's outermost point, metres; no contact at or below zero.
    u_m, v_m : float
        Where the object's origin lies on the pad, metres right and down from the pad's centre.
    angle_rad : float
        The object's turn on the pad, from u towards v (clockwise as displayed).
    shear : tuple of float
        How the contact drags the gel's skin along: right (m), down (m), turn (rad). Only the
        dots of a dotted pad show it.
    """

    depth_m: float
    u_m: float
    v_m: float
    angle_rad: float
    shear: tuple[float, float, float] = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class GelPad:
    """One pad's fixed look (see `gel_look.make_pad`). It has no state: threads may share it.

    Attributes
    ----------
    m_per_px : float
        Metres per pixel, the same along both axes.
    lights : ndarray of float32, shape (H, W, 3)
        Brightness of the red, green and blue light on the flat gel, in digital numbers.
    dots : ndarray of float32, shape (H, W), or None
        Transmission of the printed dots (1 between them); None on a plain pad.
    noise : ndarray of float32, shape (H + NOISE_MARGIN, W + NOISE_MARGIN, 3)
        Sensor noise in digital numbers, from which every frame takes a window.
    """

    m_per_px: float
    lights: Float32Array
    dots: Float32Array | None
    noise: Float32Array

    def reference(self) -> UInt8Array:
        """Return the RGB image without contact and without noise, (H, W, 3) uint8."""
        flat = self._colours(self.lights)
        if self.dots is not None:
            flat = flat * self.dots[..., None]
        return np.clip(np.round(flat), 0, 255).astype(np.uint8)

    def render(self, height_m: Float32Array, contact: Contact, noise_seed: int) -> UInt8Array:
        """Return the RGB image of an object pressed into the pad.

        Parameters
        ----------
        height_m : ndarray of float32, shape (S, S)
            The object's height map at this pad's resolution, metres (`objects.height_map`).
        contact : Contact
            Where and how deep it is pressed.
        noise_seed : int
            Chooses the noise, not negative; the same number gives the same image.

        Returns
        -------
        ndarray of uint8, shape (H, W, 3)
            RGB image.
        """
        if contact.depth_m > 0:
            skin_mm = self.indentation_mm(height_m, contact)
            image = self._colours(self._shade(skin_mm))
            dots = None if self.dots is None else self._moved_dots(self.dots, skin_mm, contact)
        else:
            image, dots = self._colours(self.lights), self.dots
        if dots is not None:
            image = image * dots[..., None]
        return self._with_noise(image, noise_seed)

    def indentation_mm(self, height_m: Float32Array, contact: Contact) -> Float32Array:
        """Return the membrane's displacement towards the camera, millimetres.

        Parameters
        ----------
        height_m : ndarray of float32, shape (S, S)
            The object's height map at this pad's resolution, metres.
        contact : Contact
            Where and how deep it is pressed.

        Returns
        -------
        ndarray of float32, shape (H, W)
            The largest of the rigid surface and the smooth membrane around it.
        """
        mm_per_px = self.m_per_px * 1e3
        rigid = self._object_on_pad(height_m, contact)
        rows, columns = rigid.shape
        # The wide Gaussians are done small: they carry no detail, and cost the most.
        size = (max(columns // _HALO_SHRINK, 1), max(rows // _HALO_SHRINK, 1))
        small = as_float32(cv2.resize(np.maximum(rigid, 0.0), size, interpolation=cv2.INTER_AREA))
        halo = small
        for sigma_mm in _HALO_SIGMAS_MM:
            halo = np.maximum(small, _blur(halo, sigma_mm / (mm_per_px * _HALO_SHRINK)))
        skin = as_float32(cv2.resize(halo, (columns, rows), interpolation=cv2.INTER_LINEAR))
        skin = _blur(np.maximum(skin, rigid), _SKIN_SIGMA_MM / mm_per_px)
        return _blur(np.maximum(skin, rigid), _SHARPNESS_SIGMA_MM / mm_per_px)

    def _object_on_pad(self, height_m: Float32Array, contact: Contact) -> Float32Array:
        """Return how far the object would reach into the undeformed gel, mm, (H, W)."""
        rows, columns = self.lights.shape[:2]
        cos, sin = math.cos(contact.angle_rad), math.sin(contact.angle_rad)
        middle = (height_m.shape[0] - 1) / 2
        shift_u = (columns - 1) / 2 + contact.u_m / self.m_per_px
        shift_v = (rows - 1) / 2 + contact.v_m / self.m_per_px
        matrix = np.array(
            [
                [cos, -sin, shift_u - (cos - sin) * middle],
                [sin, cos, shift_v - (sin + cos) * middle],
            ]
        )
        moved = cv2.warpAffine(height_m, matrix, (columns, rows), borderValue=(-1.0,))
        return as_float32(cv2.addWeighted(moved, 1e3, moved, 0.0, contact.depth_m * 1e3))

    def _shade(self, skin_mm: Float32Array) -> Float32Array:
        """Return each light's brightness on the deformed gel, (H, W, 3)."""
        scale = 1.0 / (8.0 * self.m_per_px * 1e3)
        slope_u = cv2.Sobel(skin_mm, cv2.CV_32F, 1, 0, ksize=3, scale=scale)
        slope_v = cv2.Sobel(skin_mm, cv2.CV_32F, 0, 1, ksize=3, scale=scale)
        planes = cv2.merge([slope_u, slope_v, np.ones_like(skin_mm)])
        length = as_float32(cv2.sqrt(slope_u * slope_u + slope_v * slope_v + 1.0))
        facing = as_float32(cv2.transform(planes, LIGHT_DIRECTIONS)) / length[..., None]
        bright = np.maximum(facing, 0.0) * (1.0 - _AMBIENT) + _AMBIENT
        # Highlights roll off as on a camera, and the flat gel keeps its brightness.
        rolled = bright * (1.0 + _HIGHLIGHT) / (1.0 + _HIGHLIGHT * bright)
        return as_float32(self.lights * rolled)

    def _colours(self, lights: Float32Array) -> Float32Array:
        return as_float32(cv2.transform(lights, COLOUR_MIX))

    def _moved_dots(
        self, dots: Float32Array, skin_mm: Float32Array, contact: Contact
    ) -> Float32Array:
        """Return the dots after the contact has dragged and spread the skin, (H, W)."""
        rows, columns = skin_mm.shape
        mm_per_px = self.m_per_px * 1e3
        size = (max(columns // _DOT_SHRINK, 2), max(rows // _DOT_SHRINK, 2))
        small = as_float32(cv2.resize(skin_mm, size, interpolation=cv2.INTER_AREA))
        small = _blur(small, 1.0 / (mm_per_px * _DOT_SHRINK))
        grip = np.minimum(small / (0.5 * contact.depth_m * 1e3), 1.0)
        x, y = np.meshgrid(
            np.linspace(0, columns - 1, size[0], dtype=np.float32),
            np.linspace(0, rows - 1, size[1], dtype=np.float32),
        )
        right, down, turn = contact.shear
        around_x = x - (columns - 1) / 2 - contact.u_m / self.m_per_px
        around_y = y - (rows - 1) / 2 - contact.v_m / self.m_per_px
        spread = _DOT_SPREAD_MM / (8.0 * mm_per_px * mm_per_px * _DOT_SHRINK)
        move_x = grip * (right / self.m_per_px - turn * around_y)
        move_y = grip * (down / self.m_per_px + turn * around_x)
        move_x -= cv2.Sobel(small, cv2.CV_32F, 1, 0, ksize=3, scale=spread)
        move_y -= cv2.Sobel(small, cv2.CV_32F, 0, 1, ksize=3, scale=spread)
        map_x = cv2.resize(x - move_x, (columns, rows), interpolation=cv2.INTER_LINEAR)
        map_y = cv2.resize(y - move_y, (columns, rows), interpolation=cv2.INTER_LINEAR)
        moved = cv2.remap(dots, map_x, map_y, cv2.INTER_LINEAR, borderValue=(1.0,))
        return as_float32(moved)

    def _with_noise(self, image: Float32Array, noise_seed: int) -> UInt8Array:
        rows, columns = image.shape[:2]
        top, left = np.random.default_rng(noise_seed).integers(0, NOISE_MARGIN, 2)
        window = self.noise[top : top + rows, left : left + columns]
        return as_uint8(cv2.add(image, window, dtype=cv2.CV_8U))


def _blur(image: Float32Array, sigma_px: float) -> Float32Array:
    """Return `image` blurred; three sigmas of support are enough here and cheaper than four."""
    if sigma_px < 0.2:
        return image
    side = 2 * math.ceil(3.0 * sigma_px) + 1
    return as_float32(
        cv2.GaussianBlur(image, (side, side), sigma_px, borderType=cv2.BORDER_REPLICATE)
    )
