"""Completed things in MuJoCo: what is hollow keeps a marble, hangs by its handle, and what stands stands."""

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.bench import bench_hollow
from gfp_grasp.bench.methods import view_object
from gfp_grasp.bench.vessels import Inside, drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.collision import DecomposeConfig, decompose, hull
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.completion import Completion
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes import load_mesh
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import ConvexPart

RADIUS_M, FLOOR_M = 0.006, 0.010


def as_part(mesh: trimesh.Trimesh) -> ConvexPart:
    return ConvexPart(mesh.vertices, mesh.faces)


def vessel(radius=0.035, wall=0.004, floor=0.006, height=0.09) -> trimesh.Trimesh:
    inner = radius - wall
    profile = [(0, 0), (radius, 0), (radius, height), (inner, height), (inner, floor), (0, floor)]
    return trimesh.creation.revolve(profile, sections=48)


def of_kind(category: str, kind: str) -> trimesh.Trimesh:
    return next(
        shape.mesh for shape in (make_shape(category, s) for s in split_seeds(category, "test")) if shape.kind == kind
    )


def completed(mesh: trimesh.Trimesh, seed: int = 0) -> tuple[Completion, trimesh.Trimesh]:
    """What one view of a mesh is completed to, and the mesh where it was seen."""
    sight = view_object(mesh, np.random.default_rng(seed))
    return complete_to_mesh(sight.cloud.points, viewpoint=sight.cloud.viewpoint), sight.mesh


def scan(name: str) -> trimesh.Trimesh:
    return load_mesh(real_data.folder() / "meshes" / f"{name}.ply")


def test_the_inside_of_a_vessel_is_found_and_a_closed_or_turned_one_has_none():
    inside = inside_of(vessel())
    assert inside is not None
    assert inside.floor_m == pytest.approx(0.006, abs=1e-6)
    assert inside.brim_m == pytest.approx(0.09, abs=1e-6)
    assert inside.rim_m == pytest.approx(0.09)
    assert inside.room_m == pytest.approx(0.031, abs=2e-3)
    np.testing.assert_allclose(inside.middle, [0, 0, 0.048], atol=2e-3)
    turned = vessel()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    assert inside_of(turned) is None
    assert inside_of(trimesh.creation.box([0.1, 0.1, 0.1])) is None


def test_a_goblet_is_open_above_its_stem_and_a_spout_lowers_the_brim():
    goblet = [(0, 0), (0.03, 0), (0.004, 0.005), (0.004, 0.08), (0.03, 0.1), (0.03, 0.15), (0.028, 0.15), (0, 0.09)]
    inside = inside_of(trimesh.creation.revolve(goblet, sections=48))
    assert inside is not None
    assert inside.floor_m == pytest.approx(0.09, abs=5e-3)
    assert np.linalg.norm(inside.middle[:2]) < 0.005
    notch = trimesh.creation.box(bounds=[[0.0, -0.01, 0.07], [0.05, 0.01, 0.2]])
    inside = inside_of(trimesh.boolean.difference([vessel(), notch]))
    assert inside is not None
    assert inside.brim_m == pytest.approx(0.07, abs=1e-6)
    assert inside.rim_m == pytest.approx(0.09)


def test_a_dish_is_no_inside_unless_shallow_ones_are_asked_for():
    dish = vessel(radius=0.05, height=0.016)
    assert inside_of(dish) is None
    assert inside_of(dish, least_depth_m=0.005) is not None


def test_a_marble_stays_in_boxes_that_are_open_and_not_in_their_hull():
    walls = [[[-0.04, -0.04, 0], [0.04, 0.04, 0.005]]]
    for x in (-0.04, 0.036):
        walls += [[[x, -0.04, 0], [x + 0.004, 0.04, 0.08]], [[-0.04, x, 0], [0.04, x + 0.004, 0.08]]]
    parts = [as_part(trimesh.creation.box(bounds=bounds)) for bounds in walls]
    solid = trimesh.boolean.union([part.to_trimesh() for part in parts])
    inside = inside_of(solid)
    assert inside is not None
    assert drop_marble(parts, inside, radius_m=RADIUS_M)[2] == pytest.approx(0.005 + RADIUS_M, abs=1e-3)
    assert abs(drop_marble(hull(solid).parts, inside, radius_m=RADIUS_M)[2] - 0.011) > FLOOR_M


def test_a_block_stands_and_a_leaning_one_falls():
    block = trimesh.creation.box([0.04, 0.04, 0.1])
    assert tilt_deg(block, [as_part(block)]) < 1
    block.apply_transform(trimesh.transformations.rotation_matrix(np.radians(35), [1, 0, 0]))
    assert tilt_deg(block, [as_part(block)]) > 20


def test_a_mug_hangs_by_its_handle_and_its_hull_does_not():
    mug = PrimitiveLibrary.shipped().primitive("mug")
    mesh = trimesh.Trimesh(mug.vertices, mug.faces, process=False)
    hole = handle_hole(mesh, mug.on_region("handle"))
    assert hole is not None
    middle, through, room = hole
    assert abs(through[1]) == pytest.approx(1, abs=0.05)
    assert room > 0.005
    assert hangs(mesh, mug.parts, middle, through, 0.5 * room)
    assert not hangs(mesh, hull(mesh).parts, middle, through, 0.5 * room)


def test_a_mesh_without_a_handle_has_no_hole_to_ask_for():
    with pytest.raises(InvalidMesh, match="no vertices of a handle"):
        handle_hole(vessel(), np.zeros(len(vessel().vertices), dtype=bool))


def assert_holds(completion: Completion, truth: trimesh.Trimesh, radius_m: float) -> None:
    """The marble lies on the completed floor and on the true one, and not on either where the hull is asked."""
    inside, true_inside = inside_of(completion.mesh), inside_of(truth)
    assert inside is not None
    assert true_inside is not None
    assert min(inside.room_m, true_inside.room_m) > radius_m
    bottom = drop_marble(completion.collision.parts, inside, radius_m=radius_m)[2] - radius_m
    assert abs(bottom - inside.floor_m) < FLOOR_M
    assert abs(bottom - true_inside.floor_m) < FLOOR_M
    x, y, height = drop_marble(hull(completion.mesh).parts, inside, radius_m=radius_m)
    outside = height - radius_m
    if np.hypot(x - inside.middle[0], y - inside.middle[1]) < inside.room_m:  # it has not rolled off the hull
        assert abs(outside - inside.floor_m) > FLOOR_M
        assert abs(outside - true_inside.floor_m) > FLOOR_M


def assert_hangs(completion: Completion) -> None:
    """On a peg through the completed handle, and its hull does not."""
    assert completion.fit is not None
    hole = handle_hole(completion.mesh, completion.fit.primitive.on_region("handle"))
    assert hole is not None
    middle, through, room = hole
    radius = min(0.005, 0.6 * room)
    assert hangs(completion.mesh, completion.collision.parts, middle, through, radius)
    assert not hangs(completion.mesh, hull(completion.mesh).parts, middle, through, radius)


def assert_stands(completion: Completion) -> None:
    """Upright, and not where it is put down leaning by 50 degrees."""
    mesh, parts = completion.mesh, completion.collision.parts
    assert tilt_deg(mesh, parts) < 5
    lean = rotation_about((1, 0, 0), np.radians(50))
    leaning = trimesh.Trimesh(mesh.vertices @ lean.T, mesh.faces, process=False)
    assert tilt_deg(leaning, [ConvexPart(part.vertices @ lean.T, part.faces) for part in parts]) > 20


@pytest.mark.slow
@pytest.mark.parametrize("radius_m", [0.006, 0.008])
@pytest.mark.parametrize("kind", ["straight", "tapered", "square", "bulged", "stemmed"])
def test_a_completed_glass_keeps_a_marble_on_its_true_floor_and_its_hull_does_not(kind, radius_m):
    seed = 2 if kind == "straight" else 0  # a view that shows the floor: else how deep it is is a guess
    assert_holds(*completed(of_kind("cup", kind), seed), radius_m)


@pytest.mark.slow
def test_a_completed_cup_under_a_lid_keeps_the_marble_out():
    completion, truth = completed(of_kind("cup", "lidded"))
    assert inside_of(truth) is None
    assert inside_of(completion.mesh) is None
    low, high = completion.mesh.bounds[:, 2]
    above = Inside(np.array([*completion.mesh.bounds[:, :2].mean(axis=0), low]), low, high, high, RADIUS_M)
    rest = drop_marble(completion.collision.parts, above, radius_m=RADIUS_M)[2]
    assert rest < low or rest > high - 0.03  # rolled off, or lies on the lid


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["d", "round", "square", "ear"])
def test_a_completed_mug_keeps_a_marble_and_hangs_and_its_hull_does_neither(kind):
    completion, truth = completed(of_kind("mug", kind))
    assert_holds(completion, truth, RADIUS_M)
    assert_hangs(completion)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["screw", "open", "flip_top", "pump", "jug", "spray"])
def test_a_completed_bottle_stands_and_falls_where_it_leans(kind):
    assert_stands(completed(of_kind("bottle", kind))[0])


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_of_completed_cups_mugs_and_bottles_nearly_all_hold_hang_and_stand():
    report = bench_hollow("cup,mug,bottle", limit=18)
    rows = report["rows"]
    assert sum(row["objects"] for row in rows.values()) == len(report["trials"]) == 18
    assert sum(row["failed"] for row in rows.values()) == 0
    for category in ("cup", "mug"):
        marble = rows[category]["marble"]
        assert marble["tried"] >= 4
        assert marble["kept"] >= marble["tried"] - 2  # of two no view shows the floor: how deep it is is a guess
        assert marble["kept_on_own"] == marble["tried"]
        assert marble["hull_kept"] == 0
    assert rows["mug"]["peg"]["hung"] >= rows["mug"]["peg"]["tried"] - 1
    assert rows["mug"]["peg"]["tried"] >= 1
    assert rows["mug"]["peg"]["hull_hung"] == 0
    assert rows["bottle"]["stand"]["stood"] >= rows["bottle"]["stand"]["tried"] - 1
    assert rows["bottle"]["stand"]["tried"] >= 4


@pytest.mark.slow
@pytest.mark.parametrize("radius_m", [0.006, 0.008])
@pytest.mark.parametrize("name", ["cup__gso_red_cup", "cup__plastic_glass", "mug__ycb_025_mug"])
def test_completed_scans_keep_a_marble_on_their_true_floor_and_their_hulls_do_not(name, radius_m):
    assert_holds(*completed(scan(name)), radius_m)


@pytest.mark.slow
def test_a_completed_scan_of_a_mug_hangs_by_its_handle_and_its_hull_does_not():
    assert_hangs(completed(scan("mug__ycb_025_mug"))[0])


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bottle__ycb_006_mustard_bottle", "bottle__fuze_bottle", "bottle__schauma_shampoo"])
def test_completed_scans_of_bottles_stand_and_fall_where_they_lean(name):
    assert_stands(completed(scan(name))[0])


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["bowl__ycb_024_bowl", "pitcher__ycb_019_pitcher"])
def test_true_vessels_keep_a_marble_in_the_parts_of_coacd_and_not_in_their_hull(name):
    """The pitcher was scanned with its lid on: what is open is the dent beside its spout, 16 mm deep."""
    mesh = scan(name)
    inside = inside_of(mesh)
    assert inside is not None
    found = decompose(mesh, config=DecomposeConfig(threshold=0.03, mcts_iterations=60, mcts_nodes=10))
    rest = drop_marble(found.parts, inside, radius_m=RADIUS_M)
    assert abs(rest[2] - RADIUS_M - inside.floor_m) < FLOOR_M
    outside = drop_marble(hull(mesh).parts, inside, radius_m=RADIUS_M)
    assert abs(outside[2] - RADIUS_M - inside.floor_m) > FLOOR_M
