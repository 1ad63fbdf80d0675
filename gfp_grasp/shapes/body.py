"""Bodies of vehicles: a skin lofted along x from cross-sections, and what stands on wheels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import trimesh
from numpy.typing import ArrayLike

from gfp_grasp.meshes import crossing_faces
from gfp_grasp.shapes.loft import rounded, skin, subtract, thinned, unite
from gfp_grasp.shapes.wheel import Wheel

Range = tuple[float, float]

_TOLERANCE_M = 0.004
_DECIMALS = 3  # sections stand on whole millimetres: none is too close to another
_SMOOTH_M = 0.06  # the creases of the front silhouette are blurred over twice this height
# The slender triangles along edges go, and what is left is split evenly, as a template cut from the member needs it.
# The first of these that leaves no faces that cross is taken.
_EVEN_M = (0.003, 0.002, 0.001, 1e-5)
_LONGEST_EDGE = 0.043  # share of a vehicle's length
_ARC = np.linspace(0, np.pi / 2, 5)
_FLANK = np.linspace(0, 1, 7)[1:]
_GLASS = np.linspace(0, 1, 6)[1:-1]
_FLOOR = np.array([0.0, 0.5])
_ROOF = np.array([0.88, 0.6, 0.3, 0.0])


@dataclass(frozen=True, eq=False)
class Body:
    """A closed body, symmetric about y = 0, given by its three silhouettes. All x rise.

    Attributes:
        upper: (n, 2) m, x and z of the upper edge as seen from the side, from the tail to the nose.
        lower: (m, 2) m, x and z of the lower edge, over the same x.
        plan: (k, 2) m, x and half-width as seen from above, over the same x.
        front: (l, 2), z (m) and half-width as a share of the plan's, as seen from the front.
        belt: Height m of an edge that runs along the side, as below the windows; lower where there is less room.
        round_top: Rounding between side and top, m; less where there is less room.
        round_bottom: Rounding between side and floor, m; less where there is less room.
        crown: How much lower the top's edges are than its middle, m.
        longest: Two sections are at most so far apart, m.
    """

    upper: np.ndarray
    lower: np.ndarray
    plan: np.ndarray
    front: np.ndarray
    belt: float
    round_top: float = 0.1
    round_bottom: float = 0.05
    crown: float = 0.04
    longest: float = 0.3

    def mesh(self) -> trimesh.Trimesh:
        """The skin."""
        x = self._stations()
        half = self._half_sections(x)
        ring = np.concatenate([half, half[:, -2:0:-1] * [-1, 1]], axis=1)
        along = np.broadcast_to(x[:, None, None], (*ring.shape[:2], 1))
        return skin(np.concatenate([along, ring], axis=2))

    def half_width(self, x: ArrayLike, z: ArrayLike) -> np.ndarray:
        """Half-width m of the side at a place x and height z, m, without the rounding of its edges."""
        blurred = [np.interp(np.asarray(z) + d, *self.front.T) for d in np.linspace(-_SMOOTH_M, _SMOOTH_M, 7)]
        return np.interp(np.asarray(x, dtype=np.float64), *self.plan.T) * np.mean(blurred, axis=0)

    def _stations(self) -> np.ndarray:
        """Places m of the sections: no curve between two of them is far from straight."""
        x = np.unique(np.concatenate([self.upper[:, 0], self.lower[:, 0], self.plan[:, 0]]))
        even = np.arange(x.min(), x.max(), self.longest / 2)
        x = np.unique(np.round(np.concatenate([x, (x[1:] + x[:-1]) / 2, even]), _DECIMALS))
        curves = [np.interp(x, *curve.T) for curve in (self.upper, self.lower, self.plan)]
        return x[thinned(np.column_stack([x, *curves]), tolerance=_TOLERANCE_M, longest=self.longest)]

    def _half_sections(self, x: np.ndarray) -> np.ndarray:
        """Sections (n, k, 2) m of y >= 0 and z, from the middle of the floor to the middle of the roof."""
        low, high, wide = (np.interp(x, *curve.T)[:, None] for curve in (self.lower, self.upper, self.plan))
        tall = high - low
        bottom = np.minimum(self.round_bottom, np.minimum(0.3 * tall, 0.4 * wide))
        top = np.minimum(self.round_top, np.minimum(0.45 * tall, 0.45 * wide))
        edge = high - np.minimum(self.crown, 0.2 * tall)
        sill, eaves = low + bottom, edge - top
        belt = np.clip(self.belt, sill + 0.3 * (eaves - sill), sill + 0.8 * (eaves - sill))
        heights = [
            low + bottom * (1 - np.cos(_ARC)),
            sill + _FLANK * (belt - sill),
            belt + _GLASS * (eaves - belt),
            edge - top * (1 - np.sin(_ARC)),
        ]
        z = np.concatenate(heights, axis=1)
        straight = np.zeros((len(x), len(_FLANK) + len(_GLASS)))
        cut = [bottom * (1 - np.sin(_ARC)), straight, top * (1 - np.cos(_ARC))]
        y = self.half_width(x[:, None], z) - np.concatenate(cut, axis=1)
        floor, roof = _FLOOR * y[:, :1], _ROOF * y[:, -1:]
        y = np.concatenate([floor, y, roof], axis=1)
        z = np.concatenate([np.broadcast_to(low, floor.shape), z, high - (high - edge) * _ROOF**2], axis=1)
        return np.stack([y, z], axis=2)


def straight_body(
    x: Range, half: float, z: Range, lean: Range = (0.01, 0.01), roof: float = 0.99, **rounding: float
) -> Body:
    """A long box, as what lorries carry.

    Args:
        x: Tail and nose, m.
        half: Half-width, m.
        z: Lower and upper edge, m.
        lean: How far the ends of the top lie within those of the floor, m.
        roof: Half-width of the top over that of the floor.
        rounding: Further fields of Body.
    """
    (tail, nose), (low, high), (back, front) = x, z, lean
    quarter = low + 0.25 * (high - low)
    return Body(
        np.array([[tail, quarter], [tail + back, high], [nose - front, high], [nose, quarter]]),
        np.array([[tail, low], [nose, low]]),
        np.array([[tail, half], [nose, half]]),
        np.array([[low, 1.0], [high, roof]]),
        **{
            "belt": (low + high) / 2,
            "longest": 0.8,
            "round_top": 0.03,
            "round_bottom": 0.02,
            "crown": 0.01,
            **rounding,
        },
    )


def on_wheels(
    bodies: Sequence[trimesh.Trimesh],
    wheels: Sequence[Wheel],
    *,
    gap: float,
    depth: float,
    free: Sequence[Wheel] = (),
    segments: int = 32,
) -> trimesh.Trimesh:
    """One closed solid of bodies that reach into each other and of wheels that stand in arches or free of them.

    Args:
        bodies: Closed.
        wheels: Those in arches; the inner face of each lies within a body.
        gap: Between the tyres and the arches, m.
        depth: How deep the arches are, m, less than the wheels are wide.
        free: Wheels without arches, as beside a frame; the inner face of each lies within a body.
        segments: Vertices of a wheel's rings.
    """
    shell = unite(bodies) if len(bodies) > 1 else bodies[0]
    shell = subtract(shell, unite([wheel.arch(gap=gap, depth=depth) for wheel in wheels]))
    longest = _LONGEST_EDGE * float(np.ptp(shell.vertices[:, 0]))
    parts = [shell, *(wheel.mesh(segments=segments) for wheel in (*wheels, *free))]
    mesh = parts[0]
    for tolerance in _EVEN_M:
        mesh = unite(parts, tolerance_m=tolerance, longest_m=longest)
        if not len(crossing_faces(mesh.vertices, mesh.faces)):
            break
    return mesh


def both_sides(x: float, y: float, radius: float, width: float, **features: float) -> list[Wheel]:
    """A left and a right wheel on one axle."""
    return [Wheel(x, side * y, radius, width, **features) for side in (1, -1)]


def plan_of(rng: np.random.Generator, length: float, wide: float, *, tail: Range, nose: Range) -> np.ndarray:
    """Half-width over x: a bow at each end whose depth is a share of the length, widest near the middle."""
    back, front = rng.uniform(*tail) * length, rng.uniform(*nose) * length
    rear_wide, front_wide = rng.uniform(0.93, 1.0) * wide, rng.uniform(0.93, 1.0) * wide
    corners = [
        [-length / 2, rear_wide * rng.uniform(0.72, 0.9)], [-length / 2 + back, rear_wide],
        [rng.uniform(-0.1, 0.1) * length, wide],
        [length / 2 - front, front_wide], [length / 2, front_wide * rng.uniform(0.6, 0.86)],
    ]  # fmt: skip
    return rounded(corners, [0, 0.8 * back, 0.2 * length, 0.8 * front, 0], steps=8)


def lower_edge(rng: np.random.Generator, length: float, clear: float, *, rise: Range, nose: float) -> np.ndarray:
    """Lower edge of the side: `clear` over the road, m; it rises by up to `rise` towards the bumpers.

    The nose, whose upper edge is at the height `nose`, keeps 0.18 m.
    """
    back, front = rng.uniform(0.08, 0.17) * length, rng.uniform(0.07, 0.15) * length
    behind, ahead = rng.uniform(*rise), rng.uniform(*rise)
    corners = [
        [-length / 2, min(clear + behind, nose - 0.18)], [-length / 2 + 0.25 * back, clear + 0.5 * behind],
        [-length / 2 + back, clear], [length / 2 - front, clear], [length / 2 - 0.25 * front, clear + 0.35 * ahead],
        [length / 2, min(clear + ahead, nose - 0.18)],
    ]  # fmt: skip
    return rounded(corners, [0, 0.08, 0.3, 0.3, 0.08, 0])
