"""Open bodies with a wall, a floor and a rim: what cups, glasses, bowls and vases are made of."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import inset, loft, rows
from gfp_grasp.shapes.matched import matched


@dataclass(frozen=True, eq=False)
class Vessel:
    """An open body on z = 0.

    Attributes:
        height: (n,) m, rising from 0, dense.
        radius: (n,) m, outer half-width along x; the wall is measured from it.
        wall: Thickness, m.
        floor: Height of the inner bottom, m; where a stem is narrower than two walls, the inside begins above it.
        extra: (n,) m added outside of the wall: a lip, a foot, rings.
        aspect: Half-width along y over that along x.
        power: (n,) or number, superellipse power of the section.
        dent: Depth m of the underside within its standing ring.
        flutes: Number of waves around and their relative depth, of both surfaces.
        segments: Vertices of a ring.
    """

    height: np.ndarray
    radius: np.ndarray
    wall: float
    floor: float
    extra: np.ndarray | float = 0.0
    aspect: float = 1.0
    power: np.ndarray | float = 2.0
    dent: float = 0.0
    flutes: tuple[int, float] = (0, 0.0)
    segments: int = 48

    def mesh(self) -> trimesh.Trimesh:
        """The open body, closed surface around its wall."""
        return loft(np.concatenate(self._pieces()), flutes=self.flutes, segments=self.segments)

    def matched_mesh(self, counts: Sequence[int], *, breaks_m: Sequence[float] = ()) -> trimesh.Trimesh:
        """`mesh` with as many rings as are asked for: vessels of equal counts correspond vertex by vertex.

        Args:
            counts: Rings of the underside, of each stretch of the outer side, of the rim, the inner side and the floor.
            breaks_m: Rising heights where one stretch of the outer side ends and the next begins.
        """
        under, outside, rim, inside, axis = self._pieces()
        at = [0, *np.searchsorted(self.height, breaks_m), len(outside) - 1]
        stretches = [outside[low : high + 1] for low, high in pairwise(at)]
        floor = np.concatenate([inside[-1:], axis])
        under, rim = np.concatenate([under, outside[:1]]), np.concatenate([outside[-1:], rim, inside[:1]])
        return matched([under, *stretches, rim, inside, floor], counts, segments=self.segments, flutes=self.flutes)

    def _pieces(self) -> tuple[np.ndarray, ...]:
        """Rings of the underside, the outer side, the rim, the inner side going down, and the axis."""
        outside, inside = self.outside(), self._inside(self.wall)[::-1]
        axis = rows([1e-6], inside[-1:, 2])
        return self._underside(outside[0]), outside, self._rim(outside[-1], inside[0]), inside, axis

    def core(self, share: float) -> trimesh.Trimesh:
        """Closed solid whose side runs within the wall, `share` of it deep; a little higher than the rim."""
        inside = self._inside(self.wall * share)
        top = inside[-1:] + np.array([0, 0, 0.01, 0])
        bottom, cover = rows([1e-6], inside[:1, 2]), rows([1e-6], top[:, 2])
        return loft(np.concatenate([bottom, inside, top, cover]), flutes=self.flutes, segments=self.segments)

    def outside(self) -> np.ndarray:
        """Rings (n, 4) of the outer surface, rising."""
        extra = np.broadcast_to(self.extra, self.radius.shape)
        power = np.broadcast_to(self.power, self.radius.shape)
        return np.stack([self.radius + extra, self.radius * self.aspect + extra, self.height, power], axis=1)

    def _inside(self, depth: float) -> np.ndarray:
        """Rings of the surface `depth` inside, rising from the inner bottom."""
        floor = self.floor * depth / self.wall
        fillet = min(max(1.5 * self.wall, 0.003), 0.4 * float(self.radius.min()))
        missing = np.clip(fillet - (self.height - floor), 0, fillet)
        cut = fillet - np.sqrt(np.maximum(fillet**2 - missing**2, 0))
        x = inset(self.radius, self.height, depth) - cut
        y = inset(self.radius * self.aspect, self.height, depth) - cut
        closed = np.flatnonzero((self.height < floor) | (x < 1e-3) | (y < 1e-3))
        start = closed[-1] + 1 if len(closed) else 0
        return np.stack([x, y, self.height, np.broadcast_to(self.power, x.shape)], axis=1)[start:]

    def _underside(self, first: np.ndarray) -> np.ndarray:
        axis = np.array([[1e-6, 1e-6, first[2] + self.dent, 2.0]])
        if self.dent <= 0:
            return axis
        ring = np.repeat(first[None], 3, axis=0)
        ring[:, :2] *= np.array([0.70, 0.82, 0.88])[:, None]
        ring[:, 2] += np.array([1.0, 0.9, 0.0]) * self.dent
        return np.concatenate([axis, ring])

    def _rim(self, outer: np.ndarray, inner: np.ndarray) -> np.ndarray:
        """Half an ellipse over the top edge."""
        turn = np.linspace(0, np.pi, 8)[1:-1, None]
        arc = (outer + inner) / 2 + (outer - inner) / 2 * np.cos(turn)
        arc[:, 2] = outer[2] + np.sin(turn[:, 0]) * min(0.5 * (outer[0] - inner[0]), 0.002)
        return arc
