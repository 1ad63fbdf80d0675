"""Known answers of what has a handle, a spout or flat sides: where things point, what is empty, how thick walls are."""

import numpy as np
import pytest
import trimesh

from gfp_grasp.shapes import Shape, make_shape
from gfp_grasp.shapes.blocks import block, lattice, patch_of
from gfp_grasp.shapes.grafts import PATCH_ROWS, SEGMENTS, with_long_handle
from gfp_grasp.shapes.handles import LongHandle, half_loop, long_handle
from gfp_grasp.shapes.lids import under_lid
from gfp_grasp.shapes.loft import rows
from gfp_grasp.shapes.matched import matched, space_discs
from gfp_grasp.shapes.patches import with_cap
from gfp_grasp.shapes.spouts import drawn_out
from gfp_grasp.shapes.vessel import Vessel

NUM_SEEDS = 8


def of_kinds(family: str, *kinds: str, count: int = NUM_SEEDS) -> list[Shape]:
    """The first members of a family that are of some kinds; of any kind where none is named."""
    found = (shape for seed in range(200) if (shape := make_shape(family, seed)).kind in kinds or not kinds)
    return [next(found) for _ in range(count)]


def half_width_y(mesh: trimesh.Trimesh) -> float:
    return float(mesh.extents[1]) / 2


@pytest.mark.parametrize(("family", "kind"), [("pitcher", "straight"), ("teapot", "beak"), ("kettle", "electric")])
def test_a_handle_stands_out_towards_plus_x_and_leaves_a_hole_for_the_fingers(family, kind):
    for shape in of_kinds(family, kind, count=4):
        handle = shape.mesh.vertices[shape.mesh.vertices[:, 0] > half_width_y(shape.mesh) + 0.012]
        assert shape.has_handle, shape.name
        assert len(handle) > 20, shape.name
        assert np.abs(handle[:, 1]).max() < 0.025, shape.name


@pytest.mark.parametrize(("family", "kind"), [("teapot", "round"), ("kettle", "stove"), ("pitcher", "lidded")])
def test_a_spout_or_lip_stands_out_towards_minus_x_in_the_upper_half(family, kind):
    for shape in of_kinds(family, kind, count=4):
        tip = shape.mesh.vertices[shape.mesh.vertices[:, 0].argmin()]
        assert -tip[0] > half_width_y(shape.mesh) - 0.003, shape.name
        assert abs(tip[1]) < 0.016, shape.name
        assert tip[2] > 0.4 * shape.mesh.bounds[1, 2], shape.name


def test_a_bail_leaves_room_for_a_hand_above_the_lid():
    for shape in of_kinds("kettle", "stove", count=5):
        hits, _, _ = shape.mesh.ray.intersects_location([[0, 0, 1.0]], [[0, 0, -1.0]])
        heights = np.unique(np.round(hits[:, 2], 6))[::-1]
        # From above: the top of the bail, its underside, and what is below it.
        assert heights[1] - heights[2] > 0.02, shape.name


@pytest.mark.parametrize(
    ("family", "kinds"),
    [("pitcher", ("straight", "bellied", "waisted")), ("pot", ("open", "saucepan")), ("pan", ()), ("box", ("open",))],
)
def test_open_vessels_are_empty_over_their_axis_and_have_a_floor(family, kinds):
    for shape in of_kinds(family, *kinds, count=5):
        assert 0.001 <= shape.wall_m <= 0.006, shape.name
        hits, _, _ = shape.mesh.ray.intersects_location([[0.0003, 0.0002, 1.0]], [[0, 0, -1.0]])
        floor = np.sort(np.round(hits[:, 2], 6))
        assert len(floor) == 2, shape.name
        assert 0.0008 < floor[1] - floor[0] < 0.017, shape.name
        assert floor[1] < 0.35 * shape.mesh.bounds[1, 2], shape.name


@pytest.mark.parametrize(("family", "kinds"), [("pitcher", ("straight",)), ("pot", ("open",)), ("pan", ("frying",))])
def test_walls_are_as_thick_as_they_say(family, kinds):
    for shape in of_kinds(family, *kinds, count=3):
        at = 0.75 * shape.mesh.bounds[1, 2] if family == "pitcher" else 0.6 * shape.mesh.bounds[1, 2]
        start, ahead = [[0.0, 0.0, at]], [[0.0, 1.0, 0.0]]
        if family == "pan":
            start = [[0.0, 0.0, 0.5 * min(0.03, shape.mesh.bounds[1, 2])]]
        hits, _, faces = shape.mesh.ray.intersects_location(start, ahead)
        near = np.argsort(hits[:, 1])[:2]
        normal = shape.mesh.face_normals[faces[near[1]]]
        # Along the normal of a leaning side, not along the ray.
        assert np.ptp(hits[near, 1]) * normal[1] == pytest.approx(shape.wall_m, rel=0.35), shape.name


def test_ears_of_a_pot_are_at_both_sides_along_x_and_alike():
    for shape in of_kinds("pot", "open", count=5):
        low, high = shape.mesh.bounds
        assert shape.mesh.euler_number == -2, shape.name
        assert high[0] == pytest.approx(-low[0], abs=1e-4), shape.name
        assert high[0] - high[1] > 0.02, shape.name


@pytest.mark.parametrize("family", ["pan", "pot"])
def test_a_long_handle_reaches_further_than_a_hand_is_wide(family):
    for shape in of_kinds(family, *(("saucepan",) if family == "pot" else ()), count=5):
        assert shape.mesh.bounds[1, 0] + shape.mesh.bounds[0, 0] > 0.11, shape.name
        assert not shape.has_handle, shape.name


@pytest.mark.parametrize("seed", [3, 445])  # the second one's handle hangs down farthest
def test_a_pan_stands_on_its_floor_and_not_on_its_handle(seed):
    vertices = make_shape("pan", seed).mesh.vertices
    grip = vertices[:, 0] > -vertices[:, 0].min() + 0.01
    assert vertices[~grip, 2].min() == pytest.approx(0.0, abs=1e-12)
    assert vertices[grip, 2].min() > 0.0005


def test_a_gable_ends_in_a_thin_fin_along_x_in_the_middle():
    for shape in of_kinds("carton", "gable", count=5):
        top = shape.mesh.vertices[shape.mesh.vertices[:, 2] > shape.mesh.bounds[1, 2] - 0.001]
        assert np.ptp(top[:, 0]) > 0.9 * shape.mesh.extents[0], shape.name
        assert 0.002 < np.ptp(top[:, 1]) < 0.005, shape.name
        assert top[:, 1].mean() == pytest.approx(0.0, abs=1e-3), shape.name


@pytest.mark.parametrize(("seed", "least", "most"), [(0, 0.009, 0.03), (14, 0.009, 0.03), (1, 0.0003, 0.0008)])
def test_a_gable_is_the_same_on_both_sides_but_for_its_cap_or_seal_towards_plus_y(seed, least, most):
    mesh = make_shape("carton", seed).mesh
    height = np.linspace(0.02, 0.98, 200)[:, None] * mesh.bounds[1, 2]
    reach = []
    for side in (-1.0, 1.0):
        start = np.hstack([np.full_like(height, 2e-4), np.full_like(height, side), height])
        hits, ray, _ = mesh.ray.intersects_location(start, start * [0, -1, 0], multiple_hits=False)
        reach.append(np.abs(hits[np.argsort(ray), 1]))
    assert (reach[1] - reach[0]).min() > -1e-6
    assert least < (reach[1] - reach[0]).max() < most


def test_the_cap_or_seal_of_a_brick_is_on_its_top_towards_minus_x():
    for shape in of_kinds("carton", "brick"):
        top = shape.mesh.vertices[shape.mesh.vertices[:, 2] > shape.mesh.bounds[1, 2] - 1e-4]
        assert -0.5 * shape.mesh.extents[0] < top[:, 0].mean() < 0, shape.name
        assert top[:, 1].mean() == pytest.approx(0.0, abs=1e-4), shape.name


def test_a_patch_of_a_lattice_goes_to_the_right_and_up_as_seen_from_outside():
    mesh = lattice(np.array([0.0, 1, 3, 4]), np.array([0.0, 2, 5]), np.array([0.0, 1, 2, 7, 9]))
    patch = mesh.vertices[patch_of(mesh, (1, 5, 1), (4, 5, 7))]
    assert patch.shape == (3, 3, 3)
    np.testing.assert_array_equal(patch[0], [[1, 5, 1], [1, 5, 2], [1, 5, 7]])
    np.testing.assert_array_equal(patch[:, 2], [[1, 5, 7], [3, 5, 7], [4, 5, 7]])


def test_a_cap_on_a_box_is_a_cone_of_the_radii_and_height_of_its_profile():
    mesh = lattice(np.linspace(0, 0.1, 11), np.linspace(0, 0.2, 9), np.linspace(0, 0.06, 7))
    at, profile = (0.03, 0.2, 0.04), np.array([[0.015, 0.0], [0.01, 0.03], [0.0, 0.03]])
    capped = with_cap(mesh, patch_of(mesh, (0, 0.2, 0), (0.1, 0.2, 0.06)), at, profile)
    assert capped.is_volume
    assert capped.euler_number == 2
    np.testing.assert_allclose(capped.bounds, [[0, 0, 0], [0.1, 0.23, 0.06]], atol=1e-12)
    out = capped.vertices[:, 1] > 0.2 + 1e-9
    np.testing.assert_allclose(capped.vertices[out][-1], [0.03, 0.23, 0.04], atol=1e-12)
    np.testing.assert_allclose(np.hypot(*(capped.vertices[out][:-1] - at)[:, [0, 2]].T), 0.01, atol=1e-12)
    foot = capped.vertices[~out][-32:]
    np.testing.assert_allclose(np.linalg.norm(foot - at, axis=1), 0.015, atol=1e-12)
    cone = np.pi * 0.03 / 3 * (0.015**2 + 0.015 * 0.01 + 0.01**2)
    assert capped.volume - mesh.volume == pytest.approx(cone, rel=0.01)


def test_a_sprayer_points_towards_plus_x_at_its_top_and_its_trigger_hangs_free():
    for shape in of_kinds("spray_bottle", count=NUM_SEEDS):
        tip = shape.mesh.vertices[shape.mesh.vertices[:, 0].argmax()]
        assert tip[2] > 0.75 * shape.mesh.bounds[1, 2], shape.name
        assert shape.mesh.euler_number == 2, shape.name


def test_a_box_has_its_wider_side_along_x_and_fills_its_bounds():
    for shape in of_kinds("box", "packet", "shipping", "book"):
        assert shape.mesh.extents[0] > 0.94 * shape.mesh.extents[1], shape.name
        assert shape.mesh.volume / np.prod(shape.mesh.extents) > 0.88, shape.name


def test_a_block_has_the_volume_of_a_rounded_box():
    size, r = np.array([0.2, 0.1, 0.06]), 0.01
    a, b, c = size - 2 * r
    rounded = a * b * c + 2 * r * (a * b + b * c + a * c) + np.pi * r**2 * (a + b + c) + 4 / 3 * np.pi * r**3
    mesh = block(size, r)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(rounded, rel=0.002)
    np.testing.assert_allclose(mesh.bounds, [[-0.1, -0.05, 0.0], [0.1, 0.05, 0.06]], atol=1e-12)


def test_half_a_superellipse_of_power_two_is_half_a_circle_and_more_power_is_squarer():
    along, up = half_loop(2.0, 41)
    np.testing.assert_allclose(along**2 + up**2, 1.0, atol=1e-12)
    np.testing.assert_allclose([along[0], along[20], along[-1]], [-1.0, 0.0, 1.0], atol=1e-12)
    square_along, square_up = half_loop(4.0, 41)
    assert (np.hypot(square_along, square_up)[1:20] > 1.01).all()


def test_a_cylinder_under_a_conical_lid_has_the_volume_of_both():
    height = np.linspace(0.0, 0.1, 50)
    cover = np.array([[0.04, 0.1], [1e-6, 0.13]])
    mesh = under_lid(height, np.full(50, 0.04), cover, segments=128)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(np.pi * 0.04**2 * (0.1 + 0.03 / 3), rel=0.002)


def test_a_drawn_out_rim_moves_at_minus_x_only_and_leaves_what_is_within():
    points = np.array([[-0.05, 0, 0.1], [0.05, 0, 0.1], [-0.05, 0, 0.05], [-0.02, 0, 0.1]])
    moved = drawn_out(points, top=0.1, below=0.03, out=0.01, rise=0.004, width=0.4, within=0.03)
    np.testing.assert_allclose(moved[0], [-0.06, 0, 0.104], atol=1e-9)
    np.testing.assert_allclose(moved[1:], points[1:], atol=1e-9)


@pytest.mark.parametrize(
    ("family", "kinds"),
    [
        ("pot", ["open"] * 4),
        ("pot", ["lidded"] * 4),
        ("pot", ["saucepan"] * 4),
        ("pan", ["frying", "skillet", "wok", "grill"]),
        ("carton", ["gable"] * 4),
        ("carton", ["brick"] * 4),
    ],
)
def test_members_are_one_mesh_whose_vertices_correspond(family, kinds):
    first, *others = [of_kinds(family, kind, count=4)[number] for number, kind in enumerate(kinds)]
    tip = int(first.mesh.vertices[:, 0].argmax())
    for other in others:
        np.testing.assert_array_equal(other.mesh.faces, first.mesh.faces)
        # The outermost vertex of one ear, handle or side is at the outer edge of it on all of them.
        assert other.mesh.vertices[tip, 0] > 0.97 * other.mesh.bounds[1, 0], other.name


def test_the_corners_of_grill_pans_are_at_the_same_vertices():
    first, *others = of_kinds("pan", "grill", count=3)
    corner = int((first.mesh.vertices @ [-1, 1, 0]).argmax())
    for other in others:
        reach = other.mesh.vertices @ [-1, 1, 0]
        assert reach[corner] > 0.99 * reach.max(), other.name


def test_long_handles_are_as_long_as_asked_and_their_sections_are_at_the_same_shares():
    rng = np.random.default_rng(0)
    first, second = (long_handle(rng, length=length, along=0.006, across=0.08 * length) for length in (0.15, 0.2))
    np.testing.assert_allclose(first.path[:, 0] / 0.15, second.path[:, 0] / 0.2, atol=1e-12)
    for handle, length in ((first, 0.15), (second, 0.2)):
        np.testing.assert_allclose(handle.path[[0, -1], 0], [0, length], atol=1e-12)
        assert handle.across.max() < 1.25 * 0.08 * length
        assert handle.along.max() < 1.1 * 0.006
        assert handle.across[-1] < 0.3 * handle.across.max()


RINGS = (12, 14, PATCH_ROWS, 5, 4, 16, 12)


def straight_pan(power: float) -> trimesh.Trimesh:
    """A vessel of half-width 0.1 m and wall 4 mm with a straight handle, 0.2 m long, at a height of 30 mm."""
    height = np.linspace(0.0, 0.05, 401)
    vessel = Vessel(height, np.full(401, 0.1), wall=0.004, floor=0.004, power=power, segments=SEGMENTS)
    t = np.linspace(0, 1, 21)
    handle = LongHandle(0.2 * t[:, None] * [1, 0, 0], np.full(21, 0.012), np.full(21, 0.006), 2.0)
    return with_long_handle(vessel.matched_mesh(RINGS, breaks_m=(0.024, 0.036)), RINGS, handle, power=power)


def test_a_straight_long_handle_is_an_elliptic_bar_that_stands_on_a_rectangle_of_the_side():
    mesh = straight_pan(power=2.0)
    assert mesh.is_volume
    assert mesh.euler_number == 2
    assert mesh.bounds[1, 0] == pytest.approx(0.3, abs=1e-12)
    bar = mesh.vertices[(mesh.vertices[:, 0] > 0.131) & (mesh.vertices[:, 0] < 0.299)]
    assert len(bar) == 16 * 18
    np.testing.assert_allclose(np.hypot(bar[:, 1] / 0.012, (bar[:, 2] - 0.03) / 0.006), 1.0, atol=1e-9)
    for y, z in ((-0.012, 0.024), (-0.012, 0.036), (0.012, 0.024), (0.012, 0.036)):
        corner = [np.sqrt(0.1**2 - y**2), y, z]
        assert np.linalg.norm(mesh.vertices - corner, axis=1).min() < 1e-9


@pytest.mark.parametrize("power", [2.0, 6.0])
def test_a_long_handle_leaves_the_side_of_a_round_or_square_body_where_it_is(power):
    vertices = straight_pan(power).vertices
    side = vertices[(vertices[:, 2] > 0.015) & (vertices[:, 2] < 0.049) & (vertices[:, 0] < 0.0999)]
    half = (np.abs(side[:, :2]) ** power).sum(axis=1) ** (1 / power)
    np.testing.assert_allclose(np.minimum(np.abs(half - 0.1), np.abs(half - 0.096)), 0.0, atol=1e-12)


def test_rings_of_a_spaced_disc_are_each_smaller_by_the_same_share():
    pieces = [
        rows(radius, height)
        for radius, height in (([1e-6, 0.05], [0, 0]), ([0.05] * 2, [0, 0.1]), ([0.05, 1e-6], [0.1, 0.1]))
    ]
    body = matched(pieces, (8, 4, 8), segments=24)
    space_discs(body, 8, segments=24, floor=True)
    radius = body.vertices[1:-1].reshape(-1, 24, 3)[:, 0, 0]
    np.testing.assert_allclose(radius[1:8] / radius[:7], radius[7] / radius[6])
    np.testing.assert_allclose(radius[::-1], radius)
    assert body.is_volume
