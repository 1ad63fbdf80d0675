"""What a hand takes hold of: loop handles and bails, as tubes whose ends reach into the body, and long handles."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import arc_length, rounded, smoothstep, sweep

# Handles begin and end well within the body: at this share of its smaller radius where they meet it.
_ROOT = 0.55
# Sections of a long handle and of its rounded end, and how those of the first crowd towards the body.
_SHAFT, _TIP = 20, 6
_CROWDED = 1.3


def even_path(plane: np.ndarray, count: int) -> np.ndarray:
    """The curve (n, 2) of x and z at even steps of its length, (count, 3) m in y = 0."""
    length = arc_length(plane)
    at = np.linspace(0, length[-1], count)
    x, z = (np.interp(at, length, plane[:, i]) for i in (0, 1))
    return np.stack([x, np.zeros(count), z], axis=1)


def half_loop(power: float, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Half a superellipse: places (count,) from -1 to 1 along its base, and heights (count,) of 0 .. 1 above the base.

    Args:
        power: How square it is: 2 is half a circle.
        count: Number of points.
    """
    phi = np.linspace(0, np.pi, count)
    along = -np.sign(np.cos(phi)) * np.abs(np.cos(phi)) ** (2 / power)
    return along, np.abs(np.sin(phi)) ** (2 / power)


def loop_handle(
    rng: np.random.Generator,
    kind: str,
    profile: tuple[np.ndarray, np.ndarray],
    heights: np.ndarray,
    *,
    reach: float,
    along: float,
    across: float,
) -> trimesh.Trimesh:
    """A handle of two ends towards +x, thicker where it meets the body.

    Args:
        rng: Draws the bend, the flare and the section.
        kind: "round", "d", "ear" or "square".
        profile: Heights (n,) m, rising, and radius (n,) m of the body there.
        heights: (2,) m, where the ends meet the body.
        reach: How far the centre line stands out from the body, m.
        along: Half-thickness of the handle in its plane, m.
        across: Half-width of the handle along y, m.
    """
    path = _handle_path(rng, kind, profile, heights, reach, along)
    t = np.linspace(-1, 1, len(path))
    flare = 1 + rng.uniform(0.0, 0.6) * smoothstep((np.abs(t) - 0.55) / 0.4)
    return sweep(path, across * flare, along * (1 + 0.4 * (flare - 1)), power=rng.choice([2.0, 2.6, 4.0]), segments=24)


def bail(
    rng: np.random.Generator, half: float, low: float, high: float, *, along: float, across: float
) -> trimesh.Trimesh:
    """An arch in the plane y = 0 over the body, from x = -half to x = half.

    Args:
        rng: Draws how square the arch is.
        half: Half its span, m.
        low: Height of its ends, m.
        high: Height of the centre line in the middle, m.
        along: Half-thickness in the plane of the arch, m.
        across: Half-width along y of its grip, m.
    """
    aside, up = half_loop(rng.uniform(2.0, 4.5), 81)
    path = even_path(np.stack([half * aside, low + (high - low) * up], axis=1), 60)
    grip = smoothstep((0.75 - np.abs(path[:, 0]) / half) / 0.25) * (path[:, 2] > low + 0.5 * (high - low))
    thin = rng.uniform(0.45, 1.0)
    return sweep(path, across * (thin + (1 - thin) * grip), along * (0.8 + 0.2 * grip), power=2.4, segments=20)


@dataclass(frozen=True, eq=False)
class LongHandle:
    """A handle of one end, whose n-th section has its place on every other one as well.

    Attributes:
        path: Centre line (n, 3) m towards +x in y = 0, from the side of the body, which is the origin, to the end.
        across: (n,) m, half-width along y.
        along: (n,) m, half-thickness in the plane of the path.
        power: Exponent of the superellipse section.
    """

    path: np.ndarray
    across: np.ndarray
    along: np.ndarray
    power: float


def long_handle(rng: np.random.Generator, *, length: float, along: float, across: float) -> LongHandle:
    """One long handle with a rounded end.

    Args:
        rng: Draws the bend, the rise and the course of the width.
        length: From the side of the body to the end, m.
        along: Half-thickness, m.
        across: Half-width, m.
    """
    tip = across / length
    shaft, end = np.linspace(0, 1, _SHAFT) ** _CROWDED, np.sin(np.linspace(0, np.pi / 2, _TIP + 1)[1:])
    t = np.concatenate([(1 - tip) * shaft, 1 - tip + tip * end])
    rise, bend = np.tan(rng.uniform(0.0, 0.35)) * length, rng.uniform(-0.08, 0.08) * length
    steep = rng.uniform(0.0, 1.0)
    z = rise * ((1 - steep) * t + steep * smoothstep(t * 1.3)) + bend * np.sin(np.pi * t) ** 2
    neck, swell = rng.uniform(0.5, 1.0), rng.uniform(0.0, 0.25)
    width = neck + (1 - neck) * smoothstep(t / rng.uniform(0.2, 0.5)) + swell * np.sin(np.pi * t**2)
    narrow = np.concatenate([np.ones(_SHAFT), np.sqrt(np.maximum(1 - end**2, 0.06))])
    flat = np.interp(t, [0, 0.3, 1], [rng.uniform(0.7, 1.0), 1.0, rng.uniform(0.7, 1.1)])
    path = np.stack([length * t, 0 * t, z], axis=1)
    return LongHandle(path, across * width * narrow, along * flat * np.maximum(narrow, 0.5), rng.choice([2.0, 2.8]))


def _handle_path(
    rng: np.random.Generator,
    kind: str,
    profile: tuple[np.ndarray, np.ndarray],
    heights: np.ndarray,
    reach: float,
    along: float,
) -> np.ndarray:
    """Centre line (44, 3) m of a handle towards +x, from its lower to its upper end."""
    if kind == "square":
        corner = along + rng.uniform(0.003, 0.008)
        drop = rng.uniform(0, 0.12) * (heights[1] - heights[0])
        plane = rounded(
            [[0, heights[0]], [reach, heights[0] + drop], [reach, heights[1]], [0, heights[1]]],
            [0, corner, corner, 0],
            steps=9,
        )
    else:
        power = {"round": rng.uniform(1.9, 2.3), "d": rng.uniform(2.7, 4.0), "ear": rng.uniform(2.0, 2.6)}[kind]
        up, out = half_loop(power, 61)
        if kind == "ear":
            out = out * (1 + rng.uniform(0.12, 0.38) * up) / 1.1
        plane = np.stack([reach * out, heights.mean() + up * (heights[1] - heights[0]) / 2], axis=1)
    height, radius = profile
    chord = np.interp(plane[:, 1], heights, np.interp(heights, height, radius))
    # A body that bulges between the ends must leave the fingers their room.
    between = radius[(height > heights[0]) & (height < heights[1])]
    bulge = max(float((between - chord.min()).max()), 0.0) * 0.7
    x = chord + plane[:, 0] * (1 + bulge / reach)
    plane = np.stack([x, plane[:, 1]], axis=1)
    inward = np.array([[_ROOT * chord.min(), 0.0]])
    plane = np.concatenate([plane[:1] * [0, 1] + inward, plane, plane[-1:] * [0, 1] + inward])
    return even_path(plane, 44)
