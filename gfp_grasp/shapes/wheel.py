"""Wheels: tyre, rim and hub as one solid of revolution about y."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import loft, rounded, rows
from gfp_grasp.transforms import make_T, rotation_about


@dataclass(frozen=True)
class Wheel:
    """A wheel that stands on z = 0.

    Attributes:
        x: Place of its axle, m.
        y: Its outer face, m; a negative y is a wheel of the right side.
        radius: m.
        width: m, from the outer face inward.
        rim: Radius of the rim over that of the tyre.
        dish: How deep, m, the rim lies within the outer face.
        hub: Radius of the hub over that of the tyre; the hub stands half of the dish out of the rim.
        shoulder: Rounding of the tyre's edges, m.
    """

    x: float
    y: float
    radius: float
    width: float
    rim: float = 0.65
    dish: float = 0.02
    hub: float = 0.15
    shoulder: float = 0.03

    def mesh(self, *, segments: int = 32) -> trimesh.Trimesh:
        """The wheel, closed."""
        tyre, rim, hub, deep = self.radius, self.rim * self.radius, self.hub * self.radius, self.width - self.dish
        profile = rounded(
            [
                [1e-6, 0], [tyre, 0], [tyre, self.width], [rim, self.width], [0.95 * rim, deep],
                [1.1 * hub, deep], [hub, deep + 0.5 * self.dish], [1e-6, deep + 0.5 * self.dish],
            ],
            [0, self.shoulder, self.shoulder, 0, 0, 0, 0, 0],
            steps=4,
        )  # fmt: skip
        mesh = loft(rows(profile[:, 0], profile[:, 1]), segments=segments, longest_m=1.0)
        side = float(np.sign(self.y))
        turn = rotation_about((1, 0, 0), -side * np.pi / 2)
        mesh.apply_transform(make_T(turn, (self.x, self.y - side * self.width, self.radius)))
        return mesh

    def arch(self, *, gap: float, depth: float) -> trimesh.Trimesh:
        """What a wheel arch takes off the body: a cylinder wider than the tyre, `depth` deep from the outer face."""
        beyond = 0.3
        mesh = trimesh.creation.cylinder(radius=self.radius + gap, height=depth + beyond, sections=36)
        middle = self.y + float(np.sign(self.y)) * (beyond - depth) / 2
        mesh.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2), (self.x, middle, self.radius)))
        return mesh
