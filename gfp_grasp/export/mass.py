"""Mass, centre and inertia of solids and of shells."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidMesh, InvalidOption

_DENSITIES = (0.1, 30_000.0)  # kg/m3: from the lightest aerogel to beyond osmium


@dataclass(frozen=True, eq=False)
class MassProperties:
    """How a rigid body moves under forces, in the frame of its mesh.

    Attributes:
        mass_kg: Mass.
        centre: (3,) m, centre of mass.
        inertia: (3, 3) kg m2, about the centre of mass.
    """

    mass_kg: float
    centre: np.ndarray
    inertia: np.ndarray


def mass_properties(
    mesh: trimesh.Trimesh, *, density: float = 1000.0, shell_thickness_m: float | None = None
) -> MassProperties:
    """Mass, centre and inertia of a solid, or of a shell of even thickness.

    Args:
        mesh: Metres; watertight and outward unless it is a shell.
        density: kg/m3, 0.1 to 30 000.
        shell_thickness_m: Thickness of the shell, spread over the whole surface; None for a solid.

    Raises:
        InvalidOption: No material has this density, or the thickness is not a finite positive number.
        InvalidMesh: A solid is asked for and the mesh encloses no volume.
    """
    if not _DENSITIES[0] <= density <= _DENSITIES[1]:
        raise InvalidOption(f"density is {density!r}; kg/m3 are expected, 0.1 to 30000 (water has 1000)")
    if shell_thickness_m is not None:
        if not np.isfinite(shell_thickness_m) or shell_thickness_m <= 0:
            raise InvalidOption(f"shell_thickness_m is {shell_thickness_m!r}; a finite positive number is expected")
        return _shell_properties(np.asarray(mesh.triangles), density * shell_thickness_m)
    if not mesh.is_volume:
        raise InvalidMesh("mesh is not watertight and outward, so that it has no volume: give shell_thickness_m")
    solid = mesh.copy()
    solid.density = density
    found = solid.mass_properties
    return MassProperties(float(found.mass), np.array(found.center_mass), np.array(found.inertia))


def _shell_properties(triangles: np.ndarray, density_kg_m2: float) -> MassProperties:
    """Properties of triangles (f, 3, 3) m with a mass on their surface."""
    # The midpoints of the edges, weighted alike, integrate quadratics over a triangle exactly.
    across = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    mass = np.repeat(np.linalg.norm(across, axis=1) / 2 * density_kg_m2 / 3, 3)
    points = ((triangles + np.roll(triangles, 1, axis=1)) / 2).reshape(-1, 3)
    centre = mass @ points / mass.sum()
    arms = points - centre
    second = np.einsum("n,ni,nj->ij", mass, arms, arms)
    return MassProperties(float(mass.sum()), centre, np.trace(second) * np.eye(3) - second)
