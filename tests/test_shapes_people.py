"""Pedestrians, cyclists, motorcycles and bicycles: members of one mesh, where they face, what touches the ground."""

import numpy as np
import pytest

from gfp_grasp.shapes import make_shape
from gfp_grasp.shapes.bones import Bone, Ring, pipe
from gfp_grasp.shapes.grown import grown
from gfp_grasp.shapes.skeleton import Skeleton
from gfp_grasp.transforms import rotation_about

FAMILIES = ("pedestrian", "cyclist", "motorcycle", "bicycle")
SEEDS = range(4)
LENGTHS_M = {"cyclist": (0.9, 2.0), "motorcycle": (1.5, 2.5), "bicycle": (0.8, 2.0)}


@pytest.fixture(scope="module")
def members():
    return {family: [make_shape(family, seed) for seed in SEEDS] for family in FAMILIES}


@pytest.mark.parametrize("family", FAMILIES)
def test_members_are_one_mesh_in_several_poses(family, members):
    for shape in members[family][1:]:
        np.testing.assert_array_equal(shape.mesh.faces, members[family][0].mesh.faces)


def test_people_are_as_tall_as_people_and_their_feet_point_ahead(members):
    for shape in members["pedestrian"]:
        tall = shape.mesh.extents[2]
        assert 0.95 < tall < 2.05
        # Toes reach farther ahead of the shins than heels reach behind them.
        vertices = shape.mesh.vertices
        for side in (1, -1):
            leg = vertices[side * vertices[:, 1] > 0]
            lowest = leg[:, 2].min()
            foot = leg[leg[:, 2] < lowest + 0.045 * tall]
            shin = leg[(leg[:, 2] > lowest + 0.09 * tall) & (leg[:, 2] < lowest + 0.13 * tall)]
            assert foot[:, 0].max() - shin[:, 0].mean() > shin[:, 0].mean() - foot[:, 0].min()


@pytest.mark.parametrize("family", LENGTHS_M)
def test_what_rides_stands_on_two_wheels_in_line_and_has_its_bar_ahead(family, members):
    for shape in members[family]:
        vertices = shape.mesh.vertices
        low, high = LENGTHS_M[family]
        assert low < shape.mesh.extents[0] < high
        ground = vertices[vertices[:, 2] < 0.02]
        for side in (1, -1):
            tyre = ground[side * ground[:, 0] > 0.2]
            assert len(tyre) > 0
            assert np.abs(tyre[:, 1]).max() < 0.12
        if family != "cyclist":
            widest = vertices[np.abs(vertices[:, 1]) > 0.9 * shape.mesh.extents[1] / 2]
            assert widest[:, 0].min() > 0


def test_a_bicycle_is_seen_through_between_hub_and_tyre_and_a_motorcycle_is_not(members):
    for family, open_wheel in (("bicycle", True), ("motorcycle", False)):
        mesh = members[family][0].mesh
        lowest = mesh.vertices[(mesh.vertices[:, 2] < 0.02) & (mesh.vertices[:, 0] > 0.2)]
        point = np.array([lowest[:, 0].mean(), 0.0, 0.12])
        assert mesh.contains([point])[0] != open_wheel


def test_a_cyclist_has_the_head_on_top_and_in_the_middle(members):
    for shape in members["cyclist"]:
        vertices = shape.mesh.vertices
        head = vertices[vertices[:, 2] > 0.93 * shape.mesh.extents[2]]
        assert np.ptp(head[:, 1]) < 0.25
        assert np.abs(head[:, 1].mean()) < 0.02


def test_a_bone_takes_its_ends_where_it_is_told_without_a_twist():
    bone = Bone(np.zeros(3), np.array([0.0, 0.0, 2.0]), (0.1, 0.1))
    move = bone.between(np.array([1.0, 0, 0]), np.array([1.0, 0, 3.0]), (2.0, 0.5))
    places = np.array([[0, 0, 0], [0, 0, 2.0], [0, 0.1, 1.0], [0.1, 0, 1.0]]) @ move[:, :3].T + move[:, 3]
    np.testing.assert_allclose(places, [[1, 0, 0], [1, 0, 3], [1, 0.2, 1.5], [1.05, 0, 1.5]], atol=1e-12)


def test_a_ring_becomes_a_ring_of_other_measures():
    ring = Ring(np.array([1.0, 0, 0.3]), 0.25, 0.05)
    points = ring.mesh().vertices
    turn = rotation_about((0, 0, 1), 0.4)
    maps = ring.moved(points, turn, np.array([5.0, 1.0, 0.5]), radius_m=0.4, tyre_m=0.02)
    places = np.einsum("nij,nj->ni", maps[:, :, :3], points) + maps[:, :, 3]
    local = (places - [5.0, 1.0, 0.5]) @ turn
    apart = np.hypot(np.hypot(local[:, 0], local[:, 2]) - 0.4, local[:, 1])
    np.testing.assert_allclose(apart, 0.02, atol=1e-9)


def test_a_pipe_around_a_corner_has_the_volume_of_its_parts():
    corner = np.array([1.0, 0.0, 0.0])
    bones = [Bone(np.zeros(3), corner, (0.05, 0.05)), Bone(corner, np.array([1.0, 0.0, 1.0]), (0.05, 0.05))]
    tube = pipe(bones, segments=64)
    assert tube.is_volume
    assert tube.volume == pytest.approx(2 * np.pi * 0.05**2, rel=0.01)


def test_a_grown_rod_is_a_capsule_and_bends_at_its_joint():
    bones = {
        "low": Bone(np.zeros(3), np.array([0.0, 0.0, 0.5]), (0.08, 0.08)),
        "high": Bone(np.array([0.0, 0.0, 0.5]), np.array([0.0, 0.0, 1.0]), (0.08, 0.08)),
    }
    mesh = grown(bones, edge_m=0.03, fillet_m=0.001)
    assert mesh.is_volume
    assert mesh.volume == pytest.approx(np.pi * 0.08**2 + 4 / 3 * np.pi * 0.08**3, rel=0.03)
    still = bones["low"].between(bones["low"].start, bones["low"].end)
    bent = bones["high"].between(np.array([0.0, 0.0, 0.5]), np.array([0.5, 0.0, 0.5]))
    elbow = Skeleton.of(mesh, bones).bent({"low": still, "high": bent})
    np.testing.assert_allclose(elbow.bounds, [[-0.09, -0.08, -0.08], [0.58, 0.08, 0.6]], atol=0.02)
