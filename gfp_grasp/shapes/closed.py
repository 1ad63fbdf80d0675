"""Closed containers as solids: a body, a shoulder, a lid or cup cap, and a knob: what jars and flasks are made of."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import rounded, rounded_off, rows, smoothstep
from gfp_grasp.shapes.matched import cut, matched

# Rings of the underside, the body, the shoulder, the groove, the lid's side, its top, the knob's side and its top.
_COUNTS = (8, 24, 10, 4, 12, 8, 8, 5)


@dataclass(frozen=True, eq=False)
class Closed:
    """A closed container on z = 0; lengths in m.

    Attributes:
        side: (n, 2) half-width and height of the body, rising from 0.
        edge: Rounding of the bottom edge.
        neck: Half-width at the top of the shoulder.
        shoulder: Height of the shoulder, measured from the body's top.
        bend: How full the shoulder is: 1 is a cone, more is rounder.
        groove: Height of the gap below the lid.
        lid: Half-width of the lid at its bottom and at its top.
        lid_tall: Height of the lid.
        lid_edge: Rounding of its upper edge.
        dome: Rise of its top from the edge to the knob.
        knob: Half-width and height of the knob; a lid without a knob has one of almost no size.
        aspect: Half-width of the body along y over that along x.
        lid_aspect: Half-width of the lid along y over that along x.
        power: Superellipse power of the body's section.
        lid_power: Superellipse power of the lid's section.
        dent: Depth of the underside.
        segments: Vertices of a ring.
    """

    side: np.ndarray
    edge: float
    neck: float
    shoulder: float
    bend: float
    groove: float
    lid: tuple[float, float]
    lid_tall: float
    lid_edge: float
    dome: float
    knob: tuple[float, float]
    aspect: float = 1.0
    lid_aspect: float = 1.0
    power: float = 2.0
    lid_power: float = 2.0
    dent: float = 0.0
    segments: int = 56

    def mesh(self) -> trimesh.Trimesh:
        """The container as one solid; those of equal segments correspond vertex by vertex."""
        return matched([*self._body(), *self._top()], _COUNTS, segments=self.segments)

    def _body(self) -> list[np.ndarray]:
        """Rings of the underside, the side and the shoulder."""
        radius, height = self.side.T
        edge = min(self.edge, 0.4 * float(radius.min()) * self.aspect)
        radius = radius - rounded_off(height, edge, edge)
        side = rows(radius, height, aspect=self.aspect, power=self.power)
        stand = side[0, :2]
        under = [[1e-6, 1e-6, self.dent, 2.0], [*(0.8 * stand), 0.8 * self.dent, self.power]]
        under += [[*(0.88 * stand), 0.0, self.power], side[0]]
        t = np.linspace(0, 1, 40)[:, None]
        drop = 1 - (1 - t**self.bend) ** (1 / self.bend)
        last, neck = side[-1], np.array([self.neck, self.neck * self.lid_aspect, 0.0, self.lid_power])
        neck[2] = last[2] + self.shoulder
        shoulder = last + (neck - last) * (0.1 * t + 0.9 * drop)
        shoulder[:, 2] = last[2] + self.shoulder * t[:, 0]
        shoulder[:, 3] = last[3] + (neck[3] - last[3]) * smoothstep(drop[:, 0])
        return [np.array(under), side, shoulder]

    def _top(self) -> list[np.ndarray]:
        """Rings of the groove, the lid and the knob."""
        start = float(self.side[-1, 1]) + self.shoulder
        low, high = start + self.groove, start + self.groove + self.lid_tall
        crown = high + self.dome
        wide, tall = self.knob
        corners = np.array([
            [self.neck, start], [self.neck, low], [self.lid[0], low + 0.0004], [self.lid[1], high], [wide, crown],
            [wide, crown + tall], [1e-6, crown + 1.02 * tall],
        ])  # fmt: skip
        radii = [0, 0, 0.0008, self.lid_edge, 0.001, 0.4 * min(wide, tall), 0]
        curve = rounded(corners, radii, steps=12)
        return [rows(p[:, 0], p[:, 1], aspect=self.lid_aspect, power=self.lid_power) for p in cut(curve, corners[2:6])]


def even_side(tall: float, half: float, curve: np.ndarray) -> np.ndarray:
    """Side (n, 2) m of a body from its relative radius at even heights, `half` where it is widest."""
    return np.column_stack([half * curve / curve.max(), np.linspace(0, tall, len(curve))])
