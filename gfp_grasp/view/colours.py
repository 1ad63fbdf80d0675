"""Colours of the viewer: what was seen, how sure the rest is, parts apart from each other, grasps by rank."""

import colorsys
from collections.abc import Sequence

import numpy as np

SEEN, GUESSED = (58, 118, 201), (236, 157, 56)
TABLE, SURROUNDINGS, LINES, OBSERVED = (176, 176, 170), (120, 120, 126), (222, 222, 218), (24, 40, 70)
TRUTH, PRIMITIVE = (70, 160, 110), (120, 60, 150)
BEST_GRASP, OTHER_GRASP, GRIPPER = (40, 160, 70), (110, 116, 124), (92, 98, 108)
# The least of these that covers so much of what is shown ends the scale.
_ENDS_MM = (1.0, 2.0, 3.0, 4.0, 6.0, 8.0, 10.0, 15.0, 20.0, 30.0, 50.0, 100.0)
_COVERED = 0.95
# Five colours of viridis, which also those see apart who do not see red and green apart.
_SCALE = np.array([(68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (253, 231, 37)], dtype=np.float64)
_FIRST_HUE, _GOLDEN_TURN = 0.8, (5**0.5 - 1) / 2  # the first is unlike SEEN and GUESSED
_BEST, _SECOND, _FADE, _FAINTEST = 0.85, 0.45, 0.8, 0.12  # opacities


def seen_colours(observed: np.ndarray) -> np.ndarray:
    """(v, 3) uint8 of vertices (v,) bool: SEEN or GUESSED."""
    return np.where(observed[:, None], np.array(SEEN, np.uint8), np.array(GUESSED, np.uint8))


def scale_end_mm(sigmas_m: Sequence[np.ndarray]) -> float:
    """End of the scale, mm: a round number that covers 95 % of the vertices of all that is shown."""
    if not any(len(sigma) for sigma in sigmas_m):
        return _ENDS_MM[0]
    high_mm = 1000 * float(np.quantile(np.concatenate(sigmas_m), _COVERED))
    return next((end for end in _ENDS_MM if end >= high_mm), _ENDS_MM[-1])


def scale_colours(sigma_m: np.ndarray, end_mm: float) -> np.ndarray:
    """(v, 3) uint8 of standard deviations (v,) m: dark violet at 0, yellow from the end of the scale on."""
    at = np.clip(1000 * np.asarray(sigma_m) / end_mm, 0.0, 1.0)
    stops = np.linspace(0.0, 1.0, len(_SCALE))
    return np.column_stack([np.interp(at, stops, channel) for channel in _SCALE.T]).round().astype(np.uint8)


def scale_stops() -> tuple[str, ...]:
    """Colours of the scale from its beginning to its end, as CSS has them."""
    return tuple("#" + bytes(stop).hex() for stop in _SCALE.astype(int).tolist())


def apart(num: int) -> np.ndarray:
    """(num, 3) uint8, neighbours in the list far apart from each other: hues turn by the golden ratio."""
    rows = [
        colorsys.hsv_to_rgb((_FIRST_HUE + i * _GOLDEN_TURN) % 1.0, 0.55 + 0.2 * (i % 2), 0.9 - 0.15 * (i % 3))
        for i in range(num)
    ]
    return (255 * np.array(rows).reshape(num, 3)).round().astype(np.uint8)


def grasp_colour(rank: int) -> tuple[tuple[int, int, int], float]:
    """Colour and opacity of the grasp of a rank: the best, 0, is green; the further down, the fainter."""
    if rank == 0:
        return BEST_GRASP, _BEST
    return OTHER_GRASP, max(_FAINTEST, _SECOND * _FADE ** (rank - 1))
