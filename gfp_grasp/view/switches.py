"""Which nodes of the scene are visible; names say what a node is.

| name | node |
|---|---|
| /scene/points, /scene/grid | what belongs to no object; the support |
| /objects/NUMBER/LAYER | of an object: cluster, observed, mesh, sigma, parts, primitive, name |
| /grasps/NUMBER/RANK | of an object, 0 is the best |
| /truth/NUMBER | true mesh |
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Switches:
    """What of a sight is visible.

    Attributes:
        scene: Points of the whole scene.
        observed: Points of each object.
        mesh: Completed mesh.
        sigma: The mesh in the colours of its uncertainty, not in those of what was seen.
        parts: Convex parts, in place of the mesh.
        primitive: Wire mesh of the primitive as it was registered.
        truth: True mesh, translucent.
        num_grasps: So many of the best of each object.
        hidden: Numbers of objects that are not shown at all.
    """

    scene: bool = True
    observed: bool = True
    mesh: bool = True
    sigma: bool = False
    parts: bool = False
    primitive: bool = False
    truth: bool = False
    num_grasps: int = 4
    hidden: frozenset[int] = frozenset()

    def shows(self, name: str) -> bool:
        """Whether a node is visible; a node without a switch of its own is, so that its children can be."""
        room, number, layer = (*name.strip("/").split("/"), "")[:3]
        if room == "scene":
            return self.scene if number == "points" else True
        if room == "truth":
            return self.truth
        if int(number) in self.hidden:
            return False
        if room == "grasps":
            return not layer or int(layer) < self.num_grasps
        surface = self.mesh and not self.parts
        layers = {
            "cluster": self.scene,
            "observed": self.observed,
            "mesh": surface and not self.sigma,
            "sigma": surface and self.sigma,
            "parts": self.parts,
            "primitive": self.primitive,
        }
        return layers.get(layer, True)
