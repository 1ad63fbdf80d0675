"""Mass, centre and inertia of solids and of shells, whose answers are known."""

import numpy as np
import pytest
import trimesh
from exported_bodies import askew

from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.export import mass_properties


def test_mass_of_a_solid_box_is_known():
    box = trimesh.creation.box((0.1, 0.2, 0.3))
    box.apply_translation((1, 2, 3))
    found = mass_properties(box, density=500.0)
    assert found.mass_kg == pytest.approx(3.0)
    np.testing.assert_allclose(found.centre, [1, 2, 3])
    np.testing.assert_allclose(found.inertia, np.diag([0.04 + 0.09, 0.01 + 0.09, 0.01 + 0.04]) * 3 / 12, atol=1e-12)


def test_mass_of_a_spherical_shell_is_known():
    sphere = trimesh.creation.icosphere(subdivisions=4, radius=0.1)
    found = mass_properties(sphere, density=2000.0, shell_thickness_m=0.002)
    mass = 4 * np.pi * 0.1**2 * 0.002 * 2000
    assert found.mass_kg == pytest.approx(mass, rel=5e-3)
    np.testing.assert_allclose(found.inertia, np.eye(3) * 2 / 3 * mass * 0.1**2, rtol=1e-2, atol=1e-7)


def test_inertia_of_a_solid_is_that_about_its_centre_in_the_axes_of_the_mesh():
    mesh, _ = askew()
    found = mass_properties(mesh, density=500.0)
    points = trimesh.sample.volume_mesh(mesh, 400_000) - mesh.center_mass
    second = points.T @ points / len(points) * found.mass_kg
    np.testing.assert_allclose(found.inertia, np.trace(second) * np.eye(3) - second, atol=0.03 * np.abs(second).max())


def test_inertia_of_a_shell_is_that_about_its_centre_wherever_it_is():
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.1)
    here = mass_properties(sphere, density=2000.0, shell_thickness_m=0.002)
    there = mass_properties(sphere.copy().apply_translation((1, 2, 3)), density=2000.0, shell_thickness_m=0.002)
    assert there.mass_kg == pytest.approx(here.mass_kg)
    np.testing.assert_allclose(there.centre, (1, 2, 3), atol=1e-6)
    np.testing.assert_allclose(there.inertia, here.inertia, rtol=1e-6, atol=1e-9)


def test_inertia_of_an_uneven_shell_is_known():
    """A square of side a, 2 m off: m a2/12 about the axes in its plane, m a2/6 about its normal."""
    square = trimesh.Trimesh([[2.0, 0, 0], [2.3, 0, 0], [2.3, 0.3, 0], [2, 0.3, 0]], [[0, 1, 2], [0, 2, 3]])
    found = mass_properties(square, density=100.0, shell_thickness_m=0.01)
    assert found.mass_kg == pytest.approx(0.09)
    np.testing.assert_allclose(found.centre, (2.15, 0.15, 0))
    np.testing.assert_allclose(found.inertia, np.diag([1, 1, 2]) * 0.09 * 0.09 / 12, atol=1e-12)


@pytest.mark.parametrize(
    ("density", "thickness", "message"),
    [(0.09, None, "density"), (30_001.0, None, "density"), (500.0, 0.0, "thickness"), (500.0, np.inf, "thickness")],
)
def test_mass_of_no_material_is_refused(density, thickness, message):
    mesh, _ = askew()
    with pytest.raises(InvalidOption, match=message):
        mass_properties(mesh, density=density, shell_thickness_m=thickness)
    assert mass_properties(mesh, density=0.1).mass_kg == pytest.approx(0.1 * mesh.volume)
    assert mass_properties(mesh, density=30_000.0).mass_kg == pytest.approx(30_000 * mesh.volume)


def test_a_mesh_turned_inside_out_has_no_mass():
    mesh, _ = askew()
    mesh.invert()
    with pytest.raises(InvalidMesh):
        mass_properties(trimesh.Trimesh(mesh.vertices, mesh.faces, process=False))
