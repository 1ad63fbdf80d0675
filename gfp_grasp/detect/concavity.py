"""Sharp concave creases in a depth picture: where one body stands on, or leans against, another."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

ARM = 10.0  # half a chord, in multiples of the noise: well above it, and below the radius of what is to stay whole
_SMOOTH_PX = 5


def concavity(
    points: np.ndarray,
    chosen: np.ndarray,
    depth: np.ndarray,
    eye: np.ndarray,
    focal_px: float,
    *,
    jump: np.ndarray,
    arm_m: float,
) -> np.ndarray:
    """How far the surface dips under chords across each pixel.

    For the ends l, r of a chord of two arms in the picture and its middle m, the concavity is
    ((l + r) / 2 - m) towards the eye, over |l - r|; of four directions the largest counts. Arms a that meet in a
    right angle give 0.5; the inside of a cylinder of radius R gives a / (4 R), 0.1 for a cup.

    Args:
        points: (h, w, 3) m.
        chosen: (h, w) bool, where all three points must lie.
        depth: (h, w) m, distance from the eye.
        eye: (3,) m.
        focal_px: Focal length.
        jump: (h, w) m; a depth step beyond it breaks a chord.
        arm_m: Half a chord.

    Returns:
        (h, w) float64, 0 where no unbroken chord lies across.
    """
    rays = points - eye
    rays /= np.maximum(depth, 1e-9)[:, :, None]
    smooth = eye + rays * ndimage.median_filter(depth, _SMOOTH_PX)[:, :, None]
    arm_px = max(3, round(focal_px * arm_m / float(np.median(depth[chosen]))))
    largest = np.zeros(chosen.shape)
    for dy, dx in ((0, 1), (1, 0), (1, 1), (1, -1)):
        k = arm_px if dy * dx == 0 else max(2, round(arm_px / np.sqrt(2)))
        middle, left, right = _windows(chosen.shape, k * dy, k * dx)
        if middle is None:
            continue
        chord = smooth[left] - smooth[right]
        dip = (smooth[left] + smooth[right]) / 2 - smooth[middle]
        value = -np.einsum("hwi,hwi->hw", dip, rays[middle]) / np.maximum(np.linalg.norm(chord, axis=2), 1e-6)
        whole = chosen[middle] & chosen[left] & chosen[right] & ~_broken(depth, jump, dy, dx, k)[middle]
        largest[middle] = np.maximum(largest[middle], np.where(whole, value, 0.0))
    return largest


def _windows(shape: tuple[int, ...], dy: int, dx: int) -> tuple:
    """Slices of the picture's middle, and of the same pixels moved by minus and plus (dy, dx)."""
    h, w = shape
    a, b = abs(dy), abs(dx)
    if h <= 2 * a or w <= 2 * b:
        return None, None, None

    def window(y: int, x: int) -> tuple[slice, slice]:
        return slice(a + y, h - a + y), slice(b + x, w - b + x)

    return window(0, 0), window(-dy, -dx), window(dy, dx)


def _broken(depth: np.ndarray, jump: np.ndarray, dy: int, dx: int, arm_px: int) -> np.ndarray:
    """Whether a chord of two arms along (dy, dx) crosses a depth step."""
    step = np.zeros(depth.shape, dtype=np.uint8)
    middle, left, _ = _windows(depth.shape, dy, dx)
    if middle is not None:
        step[middle] = np.abs(depth[middle] - depth[left]) > jump[middle]
    footprint = np.zeros((2 * arm_px * abs(dy) + 1, 2 * arm_px * abs(dx) + 1), dtype=bool)
    along = np.arange(2 * arm_px + 1)
    footprint[along * abs(dy), (along if dx >= 0 else along[::-1]) * abs(dx)] = True
    return ndimage.maximum_filter(step, footprint=footprint) > 0
