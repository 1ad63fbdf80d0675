"""What a vessel pours from, towards -x: a spout, or a rim that is drawn out to a lip or a beak."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import smoothstep, sweep


def spout(
    rng: np.random.Generator, root: tuple[float, float], tip: tuple[float, float], *, thick: float, thin: float
) -> trimesh.Trimesh:
    """A tube that narrows from its root within the body to its tip.

    Args:
        rng: Draws the bend, from straight to the curve of an S.
        root: Distance from the axis towards -x and height of its beginning, m.
        tip: Distance from the axis towards -x and height of its end, m.
        thick: Radius at the root, m.
        thin: Radius at the tip, m.
    """
    t = np.linspace(0, 1, 40)
    s_shape, late = rng.choice([0.0, rng.uniform(0.3, 0.9)]), rng.uniform(1.0, 1.7)
    up = (1 - s_shape) * t**late + s_shape * smoothstep(t)
    path = np.stack([-(root[0] + (tip[0] - root[0]) * t), 0 * t, root[1] + (tip[1] - root[1]) * up], axis=1)
    radius = thin + (thick - thin) * (1 - t) ** rng.uniform(0.7, 1.6)
    return sweep(path, radius * rng.uniform(0.8, 1.0), radius, segments=24)


@dataclass(frozen=True)
class Beak:
    """Ranges of the beaks or lips of one kind of vessel.

    Attributes:
        out: How far the rim moves out, over the radius of the rim.
        below: How far below the rim the beak begins, over the height of the rim.
        rise: How far the rim moves up, over how far it moves out.
        width: Angle about the axis at which the beak has 1/e of its height, rad.
        within: What is nearer to the axis than this, such as a lid, stays; over the radius of the rim.
    """

    out: tuple[float, float]
    below: tuple[float, float]
    rise: tuple[float, float]
    width: tuple[float, float]
    within: float = 0.0


def beaked(rng: np.random.Generator, vertices: np.ndarray, top: float, rim: float, beak: Beak) -> np.ndarray:
    """Vertices (v, 3) m of a vessel with a beak towards -x, drawn from the ranges of its kind.

    Args:
        rng: Draws the sizes of the beak.
        vertices: (v, 3) m of a body about the axis x = y = 0.
        top: Height of the rim, m.
        rim: Radius of the rim, m.
        beak: Ranges of the sizes.
    """
    out = rim * rng.uniform(*beak.out)
    return drawn_out(
        vertices,
        top=top,
        below=top * rng.uniform(*beak.below),
        out=out,
        rise=out * rng.uniform(*beak.rise),
        width=rng.uniform(*beak.width),
        within=beak.within * rim,
    )


def drawn_out(
    vertices: np.ndarray, *, top: float, below: float, out: float, rise: float, width: float, within: float
) -> np.ndarray:
    """Vertices (v, 3) m of a vessel whose rim is drawn out towards -x.

    Args:
        vertices: (v, 3) m of a body about the axis x = y = 0.
        top: Height of the rim, m.
        below: How far below the rim the lip begins, m.
        out: How far the rim moves out, m.
        rise: How far it moves up, m.
        width: Angle about the axis at which the lip has 1/e of its height, rad.
        within: What is nearer to the axis than this, such as a lid, stays, m.
    """
    reach = np.hypot(vertices[:, 0], vertices[:, 1])
    turn = np.arctan2(vertices[:, 1], -vertices[:, 0]) / width
    share = np.exp(-(np.abs(turn) ** 1.5)) * smoothstep((vertices[:, 2] - top + below) / below)
    if within > 0:
        rim = reach[vertices[:, 2] > top - 0.1 * below].max()
        share = share * np.clip((reach - within) / (rim - within), 0, 1)
    moved = np.array(vertices)
    moved[:, 0] -= out * share
    moved[:, 2] += rise * share
    return moved
