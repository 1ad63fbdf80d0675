"""Procedural cars, vans, lorries, buses, cones and signs: what is in front, what stands on what, and bodies by hand."""

import numpy as np
import pytest
import trimesh

from gfp_grasp.shapes import make_shape
from gfp_grasp.shapes.body import Body, both_sides, on_wheels, straight_body
from gfp_grasp.shapes.wheel import Wheel

LENGTHS_M = {"car": (2.5, 5.65), "van": (4.1, 7.6), "truck": (5.4, 17.1), "bus": (6.9, 13.1)}
SEEDS = range(6)


@pytest.fixture(scope="module")
def vehicles() -> dict[str, list[trimesh.Trimesh]]:
    return {family: [make_shape(family, seed).mesh for seed in SEEDS] for family in LENGTHS_M}


@pytest.mark.parametrize("family", LENGTHS_M)
def test_a_vehicle_has_no_hole_is_longer_than_wide_and_the_same_on_both_sides(family, vehicles) -> None:
    for mesh in vehicles[family]:
        assert mesh.euler_number == 2
        low, high = LENGTHS_M[family]
        assert low < mesh.extents[0] < high
        assert mesh.extents[0] > 1.3 * mesh.extents[1]
        np.testing.assert_allclose(mesh.bounds[:, 1].sum(), 0.0, atol=0.006)
        assert abs(mesh.center_mass[1]) < 2e-3


@pytest.mark.parametrize("family", LENGTHS_M)
def test_only_wheels_touch_the_ground_and_they_do_so_on_both_sides_in_front_and_behind(family, vehicles) -> None:
    for mesh in vehicles[family]:
        low = np.asarray(mesh.vertices)[mesh.vertices[:, 2] < 0.02]
        assert np.abs(low[:, 1]).min() > 0.15 * mesh.extents[1]
        for x in (-1, 1):
            for y in (-1, 1):
                assert ((np.sign(low[:, 0]) == x) & (np.sign(low[:, 1]) == y)).any()
        # From below the middle of the vehicle there is air, then its floor.
        up = mesh.ray.intersects_location([[0.01, 0.013, -0.1]], [[0, 0, 1]], multiple_hits=False)[0]
        assert up[0, 2] > 0.08


def test_the_front_of_cars_and_vans_is_lower_than_their_rear() -> None:
    for family, kinds in (("car", ("hatchback", "city", "suv", "estate")), ("van", ("panel", "delivery", "box"))):
        shapes = [shape for shape in (make_shape(family, seed) for seed in range(12)) if shape.kind in kinds]
        assert len(shapes) >= 4
        for shape in shapes:
            ahead, behind = (_roof(shape.mesh, share) for share in (0.42, -0.42))
            assert ahead < behind - 0.1, shape.name


def test_a_lorry_has_its_cab_and_its_windscreen_in_front_of_the_load() -> None:
    shape = next(shape for shape in (make_shape("truck", seed) for seed in range(12)) if shape.kind == "flatbed")
    assert _roof(shape.mesh, 0.3) > _roof(shape.mesh, -0.3) + 0.3


def test_a_cone_narrows_upwards_from_a_wide_base_and_is_centred() -> None:
    for seed in SEEDS:
        mesh = make_shape("traffic_cone", seed).mesh
        assert 0.29 < mesh.extents[2] < 1.05
        np.testing.assert_allclose(mesh.bounds[:, :2].sum(axis=0), 0.0, atol=1e-6)
        widths = [_width(mesh, share) for share in (0.02, 0.3, 0.6, 0.9)]
        assert widths[0] > 1.2 * widths[1]
        assert widths[1] > widths[2] > widths[3]


def test_a_sign_is_a_thin_plate_across_x_high_up_on_a_pole_that_stands_on_the_axis() -> None:
    for seed in SEEDS:
        mesh = make_shape("traffic_sign", seed).mesh
        assert 1.75 < mesh.extents[2] < 3.7
        wide = np.asarray(mesh.vertices)[np.abs(mesh.vertices[:, 1]) > 0.12]
        assert 0.015 < np.ptp(wide[:, 0]) < 0.04
        assert wide[:, 0].max() > 0.0
        assert wide[:, 2].min() > 0.25 * mesh.extents[2]
        foot = np.asarray(mesh.vertices)[mesh.vertices[:, 2] < 1e-3]
        assert np.linalg.norm(foot[:, :2], axis=1).max() < 0.08
        np.testing.assert_allclose(foot[:, :2].mean(axis=0), 0.0, atol=1e-6)


def test_signs_are_one_mesh_in_several_shapes() -> None:
    first, *others = (make_shape("traffic_sign", seed) for seed in range(8))
    assert len({first.kind, *(shape.kind for shape in others)}) >= 4
    for shape in others:
        np.testing.assert_array_equal(shape.mesh.faces, first.mesh.faces)


def test_a_wheel_is_a_disc_about_y_whose_dished_face_looks_outward() -> None:
    wheel = Wheel(1.0, -0.8, 0.3, 0.2, rim=0.6, dish=0.05, hub=0.1, shoulder=0.02)
    mesh = wheel.mesh()
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.bounds, [[0.7, -0.8, 0.0], [1.3, -0.6, 0.6]], atol=1e-3)
    ray = np.array([[1.0 + 0.4 * 0.3, -2.0, 0.3]])
    assert mesh.ray.intersects_location(ray, [[0, 1, 0]], multiple_hits=False)[0][0, 1] == pytest.approx(
        -0.75, abs=1e-3
    )


def test_a_straight_body_of_sharp_edges_is_a_box() -> None:
    mesh = straight_body(
        (-2.0, 1.0), 0.8, (0.5, 2.5), lean=(0.004, 0.004), roof=1.0, round_top=0.0, round_bottom=0.0, crown=0.0
    ).mesh()
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(3.0 * 1.6 * 2.0, rel=0.005)
    np.testing.assert_allclose(mesh.bounds, [[-2.0, -0.8, 0.5], [1.0, 0.8, 2.5]], atol=1e-6)


def test_a_body_keeps_its_three_silhouettes() -> None:
    body = Body(
        upper=np.array([[-2.0, 0.5], [-1.9, 1.4], [0.5, 1.4], [1.0, 0.9], [2.0, 0.7]]),
        lower=np.array([[-2.0, 0.3], [-1.5, 0.2], [2.0, 0.2]]),
        plan=np.array([[-2.0, 0.7], [0.0, 0.85], [2.0, 0.6]]),
        front=np.array([[0.2, 0.9], [0.8, 1.0], [1.4, 0.7]]),
        belt=0.9,
        round_top=0.05,
        crown=0.03,
    )
    mesh = body.mesh()
    assert mesh.is_volume
    np.testing.assert_allclose(mesh.bounds[:, [0, 2]], [[-2.0, 0.2], [2.0, 1.4]], atol=0.005)
    down = mesh.ray.intersects_location([[0.75, 1e-4, 3.0]], [[0, 0, -1]], multiple_hits=False)[0]
    assert down[0, 2] == pytest.approx(1.15, abs=0.01)
    across = mesh.ray.intersects_location([[0.0, 3.0, 1.1]], [[0, -1, 0]], multiple_hits=False)[0]
    assert across[0, 1] == pytest.approx(0.85 * 0.85, abs=0.01)


def test_wheels_in_arches_leave_a_groove_around_the_tyre_and_no_hole() -> None:
    body = straight_body((-2.0, 2.0), 0.9, (0.3, 1.5), roof=1.0)
    wheels = [wheel for x in (-1.2, 1.2) for wheel in both_sides(x, 0.88, 0.35, 0.25)]
    mesh = on_wheels([body.mesh()], wheels, gap=0.05, depth=0.1)
    assert mesh.is_volume
    assert mesh.euler_number == 2
    assert mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-5)
    between, beyond = ([[1.2, 2.0, 0.7 + up]] for up in (0.025, 0.08))
    for start, found in ((between, 0.78), (beyond, 0.9)):
        hit = mesh.ray.intersects_location(start, [[0, -1, 0]], multiple_hits=False)[0]
        assert hit[0, 1] == pytest.approx(found, abs=0.01)


def _roof(mesh: trimesh.Trimesh, share: float) -> float:
    """Height m of the roof's middle at a share of the length from the middle."""
    x = mesh.bounds[:, 0].mean() + share * mesh.extents[0]
    return float(mesh.ray.intersects_location([[x, 0.011, 10.0]], [[0, 0, -1]], multiple_hits=False)[0][0, 2])


def _width(mesh: trimesh.Trimesh, share: float) -> float:
    """Way m through the mesh along x at a share of its height."""
    start = [[-5.0, 1e-4, share * mesh.extents[2]]]
    hits = mesh.ray.intersects_location(start, [[1, 0, 0]])[0][:, 0]
    return float(np.ptp(hits))
