"""Pictures of the demonstration: depth as colour, and short clips."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image

# Near to far. Light grows evenly from one stop to the next, so that the order survives in grey.
_STOPS = np.array([(253, 231, 160), (246, 177, 97), (214, 98, 92), (140, 49, 111), (62, 26, 90), (16, 14, 42)], float)
_NOTHING = (205, 209, 214)


def write_depth(path: Path, depth_m: np.ndarray) -> None:
    """Write depth (h, w) m as a PNG: light is near, dark is far, grey came back with nothing."""
    seen = depth_m > 0
    low, high = np.quantile(depth_m[seen], [0.005, 0.995]) if seen.any() else (0.0, 1.0)
    share = np.clip((depth_m - low) / max(high - low, 1e-6), 0.0, 1.0) * (len(_STOPS) - 1)
    stops = np.arange(len(_STOPS))
    colour = np.stack([np.interp(share, stops, _STOPS[:, c]) for c in range(3)], axis=-1)
    colour[~seen] = _NOTHING
    Image.fromarray(colour.astype(np.uint8)).save(path, optimize=True)


def write_clip(path: Path, frames: Sequence[np.ndarray], *, frame_ms: int = 80) -> None:
    """Write frames (h, w, 3) uint8 as a GIF that repeats; all frames share one palette, so nothing flickers."""
    palette = Image.fromarray(np.concatenate(frames[:: max(1, len(frames) // 6)])).quantize(128)
    pictures = [Image.fromarray(frame).quantize(palette=palette, dither=Image.Dither.NONE) for frame in frames]
    durations = [frame_ms] * (len(pictures) - 1) + [1200]
    pictures[0].save(path, save_all=True, append_images=pictures[1:], duration=durations, loop=0, optimize=True)
