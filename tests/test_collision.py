"""Convex decomposition: known answers, what stays hollow, what MuJoCo takes."""

# MuJoCo's Python stubs leave out what its C module defines.
# pyright: reportAttributeAccessIssue=false

from dataclasses import replace

import mujoco
import numpy as np
import pytest
import trimesh

from gfp_grasp.bench.hostile_meshes import hostile_mesh
from gfp_grasp.collision import (
    MIN_THICKNESS_M,
    DecomposeConfig,
    convex_part,
    decompose,
    hull,
    union_error_m,
    within_parts,
)
from gfp_grasp.collision.convex import convex_parts, needed_corners
from gfp_grasp.collision.fidelity import volume_ratios
from gfp_grasp.collision.parts import PartFaces, volume_m3
from gfp_grasp.errors import DecompositionFailed, InvalidMesh, InvalidOption
from gfp_grasp.types import ConvexPart

QUICK = DecomposeConfig(mcts_iterations=60, mcts_nodes=10, resolution=1000, cache=False)


def box(low: list[float], high: list[float]) -> ConvexPart:
    solid = trimesh.creation.box(bounds=[low, high])
    return ConvexPart(solid.vertices, solid.faces)


def cup(sections: int = 16) -> trimesh.Trimesh:
    """80 mm across, 100 mm high, wall and floor 4 mm."""
    profile = [[0, 0], [0.04, 0], [0.04, 0.1], [0.036, 0.1], [0.036, 0.004], [0, 0.004]]
    return trimesh.creation.revolve(np.array(profile), sections=sections)


@pytest.fixture(scope="module")
def cup_parts() -> tuple[ConvexPart, ...]:
    return decompose(cup(), config=QUICK).parts


def corner() -> trimesh.Trimesh:
    """Two bars of 100 x 20 x 20 mm that meet in an L."""
    bounds = [[[0, 0, 0], [0.1, 0.02, 0.02]], [[0, 0, 0], [0.02, 0.1, 0.02]]]
    return trimesh.boolean.union([trimesh.creation.box(bounds=bound) for bound in bounds])


def test_an_l_shaped_solid_falls_into_two_boxes_of_its_own_volume():
    found = decompose(corner(), config=QUICK)
    assert found.made_by == "coacd"
    assert len(found.parts) == 2
    assert found.notes["volume_ratio"] == pytest.approx(1, abs=0.02)
    assert found.notes["attempts"] == 1
    assert max(found.error_m) < 2e-3


def test_a_convex_mesh_is_its_own_hull():
    sphere = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    for found in (hull(sphere), decompose(sphere, config=QUICK)):
        assert len(found.parts) == 1
        assert volume_m3(found.parts[0]) == pytest.approx(sphere.volume, rel=2e-3)
        assert found.error_m[0] < 1e-4


def test_parts_follow_the_mesh_where_it_stands_and_however_it_is_turned():
    pose = trimesh.transformations.random_rotation_matrix(np.array([0.3, 0.6, 0.1]))
    pose[:3, 3] = [10.0, -4.0, 2.0]
    turned = corner().apply_transform(pose)
    found = decompose(turned, config=QUICK)
    reach = np.concatenate([part.vertices for part in found.parts])
    np.testing.assert_allclose([reach.min(0), reach.max(0)], turned.bounds, atol=1e-6)
    assert found.notes["volume_ratio"] == pytest.approx(1, abs=0.05)


def test_a_ball_of_10_mm_fits_between_the_parts_of_a_cup(cup_parts):
    sphere = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    for height in (0.016, 0.05, 0.09):
        assert not within_parts(np.add(sphere.vertices, [0, 0, height]), cup_parts).any()
    assert within_parts(np.array([[0.038, 0, 0.05], [0, 0, 0.002]]), cup_parts, margin_m=1e-6).any(axis=1).all()


def test_parts_are_closed_outward_and_cover_the_walls(cup_parts):
    for part in cup_parts:
        assert part.to_trimesh().is_volume
        assert part.to_trimesh().is_convex
    assert 0.98 < volume_ratios(cup_parts, cup(), rng=np.random.default_rng(0))[1] < 1.4


def test_a_marble_stays_in_a_cup_made_of_its_parts(cup_parts):
    spec = mujoco.MjSpec()
    for index, part in enumerate(cup_parts):
        spec.add_mesh(name=f"hull_{index}", uservert=part.vertices.ravel(), userface=part.faces.ravel())
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{index}")
    marble = spec.worldbody.add_body(name="marble", pos=[0.005, 0, 0.08])
    marble.add_freejoint()
    marble.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.008, 0, 0], density=2500)
    model = spec.compile()
    data = mujoco.MjData(model)
    for _ in range(750):
        mujoco.mj_step(model, data)
    assert data.body("marble").xpos[2] == pytest.approx(0.004 + 0.008, abs=2e-3)


def test_the_same_seed_gives_the_same_parts():
    runs = [decompose(corner(), config=QUICK) for _ in range(2)]
    assert runs[0].error_m == runs[1].error_m
    for one, other in zip(runs[0].parts, runs[1].parts, strict=True):
        np.testing.assert_array_equal(one.vertices, other.vertices)


def test_options_reach_coacd():
    assert len(decompose(corner(), config=replace(QUICK, max_convex_hull=1)).parts) == 1
    boxes = decompose(corner(), config=replace(QUICK, apx_mode="box")).parts
    assert all(len(part.vertices) == 8 for part in boxes)
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.05)
    small = decompose(ball, config=replace(QUICK, decimate=True, max_ch_vertex=20))
    assert len(small.parts[0].vertices) <= 20


@pytest.mark.parametrize(
    "options",
    [
        {"threshold": 0.0},
        {"threshold": float("nan")},
        {"threshold": True},
        {"max_convex_hull": 0},
        {"preprocess_mode": "maybe"},
        {"preprocess_resolution": 10},
        {"mcts_nodes": 5},
        {"mcts_iterations": 150.0},
        {"pca": 1},
        {"max_ch_vertex": 3},
        {"apx_mode": "sphere"},
        {"seed": -1},
        {"time_limit_s": 0},
        {"time_limit_s": float("inf")},
        {"memory_limit_mb": 1},
        {"attempts": 0},
        {"engine": "hacd"},
        {"vhacd_resolution": 9999},
        {"cache": "yes"},
    ],
)
def test_nonsense_options_are_refused_by_name(options):
    with pytest.raises(InvalidOption, match=next(iter(options))):
        DecomposeConfig(**options)


def test_a_threshold_in_metres_may_be_small():
    assert DecomposeConfig(threshold=0.002, real_metric=True).coacd_options()["real_metric"] is True


def test_flat_and_tiny_point_sets_are_no_parts():
    rng = np.random.default_rng(0)
    cloud = rng.random((50, 3)) * 0.05
    assert convex_part(cloud) is not None
    assert convex_part(cloud * [1, 1, 0]) is None
    assert convex_part(cloud * [1, 1, 0.5 * MIN_THICKNESS_M / 0.05]) is None
    assert convex_part(cloud * 1e-3) is None
    assert convex_part(cloud[:3]) is None
    parts, dropped = convex_parts([cloud, cloud * [1, 1, 0]])
    assert (len(parts), dropped) == (1, 1)


def test_the_smallest_parts_that_are_kept_compile_in_mujoco():
    for extents in ([0.0005, 0.0005, 0.0005], [0.02, 0.02, 1.1 * MIN_THICKNESS_M], [0.03, 0.0003, 0.0003]):
        solid = trimesh.creation.box(extents)
        part = convex_part(solid.vertices)
        assert part is not None
        spec = mujoco.MjSpec()
        spec.add_mesh(name="hull", uservert=part.vertices.ravel(), userface=part.faces.ravel())
        body = spec.worldbody.add_body()
        body.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="hull", density=1000)
        spec.compile()


def test_a_corner_that_is_almost_on_an_edge_folds_no_face():
    _, mesh = hostile_mesh(6570)
    part = hull(mesh).parts[0]
    faces = PartFaces.of([part])
    heights = faces.planes @ np.vstack([part.vertices.T, np.ones(len(part.vertices))])
    assert heights.max() < 1e-12
    assert volume_m3(part) == pytest.approx(mesh.convex_hull.volume)
    cloud = np.asarray(mesh.vertices[np.unique(mesh.faces)])
    assert len(needed_corners(cloud, 1e-4)) <= len(cloud)


def test_of_a_dense_ball_few_corners_are_needed():
    ball = trimesh.creation.icosphere(subdivisions=4, radius=0.03)
    points = np.asarray(ball.vertices)
    kept = needed_corners(points, 2e-4)
    assert len(kept) < len(points) / 3
    part = convex_part(points[kept])
    assert part is not None
    faces = PartFaces.of([part])
    beyond = faces.planes @ np.vstack([points.T, np.ones(len(points))])
    assert beyond.max() <= 2e-4 + 1e-9
    flat = points * [1, 1, 0]
    assert len(needed_corners(flat, 1e-4)) == len(flat)


def test_error_of_a_box_against_a_shifted_copy_is_known():
    mesh = trimesh.creation.box((0.1, 0.1, 0.1))
    grown = box([-0.052] * 3, [0.052] * 3)
    mean, p95, largest = union_error_m([grown], mesh, rng=np.random.default_rng(0))
    assert mean == pytest.approx(0.002, abs=1e-4)
    assert p95 == pytest.approx(0.002, abs=5e-4)
    assert largest <= np.sqrt(3) * 0.002 + 1e-9


def test_inner_faces_between_parts_count_neither_as_surface_nor_twice_as_volume():
    whole = trimesh.creation.box(bounds=[[0, 0, 0], [0.2, 0.1, 0.1]])
    touching = [box([0, 0, 0], [0.1, 0.1, 0.1]), box([0.1, 0, 0], [0.2, 0.1, 0.1])]
    overlapping = [box([0, 0, 0], [0.15, 0.1, 0.1]), box([0.05, 0, 0], [0.2, 0.1, 0.1])]
    for parts in (touching, overlapping):
        assert union_error_m(parts, whole, rng=np.random.default_rng(0))[0] < 2e-4
        summed, union = volume_ratios(parts, whole, rng=np.random.default_rng(0))
        assert summed == pytest.approx(sum(map(volume_m3, parts)) / whole.volume)
        assert union == pytest.approx(1, rel=0.03)


def test_a_filled_cup_has_a_large_error():
    filled = hull(cup())
    assert filled.error_m[0] > 0.001
    assert filled.error_m[1] > 0.01
    assert filled.notes["volume_ratio"] == pytest.approx(filled.parts[0].to_trimesh().volume / cup().volume)


def test_an_empty_mesh_is_refused_before_coacd():
    with pytest.raises(InvalidMesh):
        decompose(trimesh.Trimesh())


def test_a_mesh_in_no_known_unit_is_refused_as_too_small():
    with pytest.raises(InvalidMesh, match="metres"):
        decompose(trimesh.creation.box((1e-4, 1e-4, 1e-4)))
    with pytest.raises(InvalidMesh):
        hull(trimesh.creation.box((0.1, 0.1, 1e-6)))


@pytest.mark.parametrize("offset_m", [300.0, 5e4, 1e7])
def test_parts_far_from_the_origin_are_what_float32_leaves_of_them_or_refused(offset_m):
    far = corner().apply_translation([offset_m, 0, 0])
    if offset_m > 1e5:  # nothing but one point is left
        with pytest.raises(InvalidMesh, match="from the origin"):
            hull(far)
        return
    spec = mujoco.MjSpec()
    for index, part in enumerate(hull(far).parts):
        np.testing.assert_array_equal(part.vertices, part.vertices.astype(np.float32))
        spec.add_mesh(name=f"hull_{index}", uservert=part.vertices.ravel(), userface=part.faces.ravel())
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname=f"hull_{index}")
    spec.compile()


def test_what_does_not_fit_into_the_time_limit_is_named():
    with pytest.raises(DecompositionFailed, match="time_limit_s"):
        decompose(cup(64), config=DecomposeConfig(time_limit_s=0.05, cache=False))
