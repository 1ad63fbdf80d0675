"""Lids and their knobs, as profiles of revolution that go on where the body's profile ends; vessels under a lid."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import loft, rounded, rows

_KNOBS = ("ball", "disc", "post")


def lid(
    rng: np.random.Generator, radius: float, height: float, *, dome: float, knob: float, over: float = 0.0
) -> np.ndarray:
    """Profile (n, 2) of radius and height, m, from the body's rim to the axis.

    Args:
        rng: Draws edges, the bend of the dome and the knob.
        radius: Radius of the body at its rim, m.
        height: Height of the rim, m.
        dome: How much higher than its edge the lid's middle is, m.
        knob: Radius of the knob, m; 0 for none.
        over: How much wider than the body the lid is, m; negative where it is let into the mouth.
    """
    cover = _domed(rng, radius, height, dome, over)
    if knob <= 0:
        return np.concatenate([cover[:-1], [[1e-6, cover[-1, 1]]]])
    return np.concatenate(_with_knob(rng, cover, knob))


def knobbed(
    rng: np.random.Generator, radius: float, height: float, *, dome: float, knob: float, over: float
) -> tuple[np.ndarray, np.ndarray]:
    """`lid` in two pieces, of which the second is the knob and begins where the first ends."""
    cover, top = _with_knob(rng, _domed(rng, radius, height, dome, over), knob)
    return np.concatenate([cover, top[:1]]), top


def sunk_lid(rng: np.random.Generator, radius: float, height: float) -> np.ndarray:
    """Profile (n, 2) of a flat lid with a raised edge and a sunk middle, as on plastic jugs and storage boxes."""
    band, ring = rng.uniform(0.003, 0.012), radius * rng.uniform(0.75, 0.93)
    sunk = rng.uniform(0.0, 0.8) * band
    middle = ring * rng.uniform(0.3, 0.6)
    crest = rng.choice([0.0, rng.uniform(0.0, 0.02)])
    low = height + band - sunk
    corners = [
        [radius, height], [radius + rng.uniform(0.0, 0.002), height + 0.001], [radius, height + band],
        [ring, height + band], [0.97 * ring, low], [middle, low], [0.9 * middle, low + crest], [1e-6, low + crest],
    ]  # fmt: skip
    return rounded(corners, [0, 0, 0.002, 0.002, 0.002, 0.003, 0.003, 0])


def under_lid(height: np.ndarray, radius: np.ndarray, cover: np.ndarray, *, segments: int) -> trimesh.Trimesh:
    """A vessel and its lid as one solid.

    Args:
        height: (n,) m, rising from 0.
        radius: (n,) m, that of the vessel at these heights.
        cover: Profile (m, 2) of the lid, from the vessel's rim to the axis, m.
        segments: Vertices of a ring.
    """
    rings = [rows([1e-6], [0.0]), rows(radius, height), rows(cover[:, 0], cover[:, 1])]
    return loft(np.concatenate(rings), segments=segments)


def _domed(rng: np.random.Generator, radius: float, height: float, dome: float, over: float) -> np.ndarray:
    """Profile of a lid from the body's rim to the axis."""
    edge = rng.uniform(0.0015, 0.006)
    wide = radius + over
    turn = np.linspace(0, np.pi / 2, 16)
    bend = rng.uniform(0.7, 1.3)
    low = height + (edge if over >= 0 else 0.3 * edge)
    arc = np.stack([wide * np.cos(turn), low + dome * np.sin(turn) ** bend], axis=1)
    start = [[radius, height], [wide, height + 0.0004]] if over > 1e-4 else [[radius, height]]
    if over < -1e-4:
        start.append([wide, height])
    return np.concatenate([start, arc])


def _with_knob(rng: np.random.Generator, cover: np.ndarray, knob: float) -> tuple[np.ndarray, np.ndarray]:
    """The profile of a lid up to its knob, and that of the knob."""
    foot = knob * rng.uniform(0.35, 0.75)
    base = float(np.interp(foot, cover[::-1, 0], cover[::-1, 1]))
    cover = cover[cover[:, 0] > 1.15 * foot]
    return cover, _knob(rng, foot, knob, max(base, float(cover[-1, 1])))


def _knob(rng: np.random.Generator, foot: float, head: float, height: float) -> np.ndarray:
    """Profile of a knob of radius `head` on a foot of radius `foot`, m, that stands at a height, m."""
    kind = str(rng.choice(_KNOBS))
    neck = rng.uniform(0.002, 0.01)
    tall = head * {"ball": rng.uniform(1.5, 2.1), "disc": rng.uniform(0.4, 0.9), "post": rng.uniform(1.2, 2.6)}[kind]
    if kind == "ball":
        turn = np.linspace(-1.1, np.pi / 2, 16)[:-1]
        ball = np.stack([head * np.cos(turn), height + neck + 0.5 * tall * (1 + np.sin(turn))], axis=1)
        return np.concatenate([[[foot, height]], ball, [[1e-6, height + neck + tall]]])
    wide = head if kind == "disc" else max(head, foot * 1.05)
    corners = [
        [foot, height], [foot, height + neck], [wide, height + 1.4 * neck], [wide * rng.uniform(0.85, 1.0),
        height + 1.4 * neck + tall], [1e-6, height + 1.4 * neck + 1.1 * tall],
    ]  # fmt: skip
    return rounded(corners, [0, 0.001, 0.35 * tall, 0.4 * tall, 0])
