"""Completed things in MuJoCo: what is hollow keeps a marble, hangs by its handle, and what stands stands."""

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.bench.hollow import bench_hollow
from gfp_grasp.bench.views import see
from gfp_grasp.collision import DecomposeConfig, decompose, hull
from gfp_grasp.complete import complete_to_mesh
from gfp_grasp.envs.hollow import drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes import load_mesh
from gfp_grasp.primitives import load_primitive
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.types import HANDLE, ConvexPart

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


def completed(mesh: trimesh.Trimesh, seed: int = 0):
    sight = see(mesh, np.random.default_rng(seed))
    return complete_to_mesh(sight.cloud.points, viewpoint=sight.cloud.viewpoint), sight.mesh


def test_the_inside_of_a_vessel_is_found_and_a_closed_or_turned_one_has_none():
    inside = inside_of(vessel())
    assert inside is not None
    assert inside.floor_m == pytest.approx(0.006, abs=1e-6)
    assert inside.rim_m == pytest.approx(0.09)
    turned = vessel()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.pi, [1, 0, 0]))
    assert inside_of(turned) is None
    assert inside_of(trimesh.creation.box([0.1, 0.1, 0.1])) is None


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
    mug = load_primitive("mug")
    mesh = trimesh.Trimesh(mug.vertices, mug.faces, process=False)
    hole = handle_hole(mesh, mug.regions == HANDLE)
    assert hole is not None
    middle, through, room = hole
    assert abs(through[1]) == pytest.approx(1, abs=0.05)
    assert room > 0.005
    assert hangs(mesh, mug.parts, middle, through, 0.5 * room)
    assert not hangs(mesh, hull(mesh).parts, middle, through, 0.5 * room)


def test_a_mesh_without_a_handle_has_no_hole_to_ask_for():
    with pytest.raises(InvalidMesh, match="no vertices of a handle"):
        handle_hole(vessel(), np.zeros(len(vessel().vertices), dtype=bool))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["tapered", "stemmed"])
def test_a_completed_glass_keeps_a_marble_on_its_true_floor(kind):
    completion, truth = completed(of_kind("cup", kind))
    inside, true_inside = inside_of(completion.mesh), inside_of(truth)
    assert inside is not None
    assert true_inside is not None
    rest = drop_marble(completion.collision.parts, inside, radius_m=RADIUS_M)
    assert abs(rest[2] - RADIUS_M - inside.floor_m) < FLOOR_M
    assert abs(rest[2] - RADIUS_M - true_inside.floor_m) < FLOOR_M


@pytest.mark.slow
@pytest.mark.timeout(600)
def test_of_completed_cups_mugs_and_bottles_nearly_all_hold_hang_and_stand():
    rows = bench_hollow("cup,mug,bottle", limit=18)["rows"]
    for category in ("cup", "mug"):
        marble = rows[category]["marble"]
        assert marble["tried"] >= 4
        assert marble["kept"] >= marble["tried"] - 1
        assert marble["hull_kept"] == 0
    assert rows["mug"]["peg"]["hung"] >= rows["mug"]["peg"]["tried"] - 1
    assert rows["mug"]["peg"]["tried"] >= 1
    assert rows["mug"]["peg"]["hull_hung"] == 0
    assert rows["bottle"]["stand"]["stood"] >= rows["bottle"]["stand"]["tried"] - 1
    assert rows["bottle"]["stand"]["tried"] >= 4


@pytest.mark.slow
@pytest.mark.parametrize("name", ["cup__gso_red_cup", "cup__plastic_glass", "mug__ycb_025_mug"])
def test_completed_scans_keep_a_marble_on_their_true_floor(name):
    completion, truth = completed(load_mesh(real_data.folder() / "meshes" / f"{name}.ply"))
    inside, true_inside = inside_of(completion.mesh), inside_of(truth)
    assert inside is not None
    assert true_inside is not None
    rest = drop_marble(completion.collision.parts, inside, radius_m=RADIUS_M)
    assert abs(rest[2] - RADIUS_M - true_inside.floor_m) < FLOOR_M


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bottle__ycb_006_mustard_bottle", "bottle__fuze_bottle", "bottle__schauma_shampoo"])
def test_completed_scans_of_bottles_stand(name):
    completion, _ = completed(load_mesh(real_data.folder() / "meshes" / f"{name}.ply"))
    assert tilt_deg(completion.mesh, completion.collision.parts) < 5


@pytest.mark.slow
@pytest.mark.timeout(600)
@pytest.mark.parametrize("name", ["bowl__ycb_024_bowl", "pitcher__ycb_019_pitcher"])
def test_true_vessels_keep_a_marble_in_the_parts_of_coacd(name):
    mesh = load_mesh(real_data.folder() / "meshes" / f"{name}.ply")
    inside = inside_of(mesh)
    assert inside is not None
    parts = decompose(mesh, config=DecomposeConfig(threshold=0.05, mcts_iterations=60, mcts_nodes=10)).parts
    rest = drop_marble(parts, inside, radius_m=RADIUS_M)
    assert inside.floor_m - FLOOR_M < rest[2] - RADIUS_M < inside.floor_m + FLOOR_M
