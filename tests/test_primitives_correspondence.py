"""Members come into one pose, and the template is bent onto each of them."""

import numpy as np
import pytest
import trimesh
from revolved import QUICK, cup, mug, wall_thickness

from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import bring_into_one_pose
from gfp_grasp.primitives.correspondence import CorrespondenceConfig, TemplateFitter
from gfp_grasp.primitives.pose import stand_up
from gfp_grasp.primitives.procrustes import choose_template
from gfp_grasp.primitives.remesh import refine, remesh
from gfp_grasp.primitives.surface import surface_distance_m
from gfp_grasp.transforms import random_rotation


@pytest.fixture(scope="module")
def template():
    return remesh(cup(wall=0.003), np.random.default_rng(0), config=QUICK.remesh)


@pytest.fixture(scope="module")
def fitter(template):
    return TemplateFitter(template)


def test_template_is_the_member_of_the_commonest_topology():
    members = [mug(), cup(), cup(top=0.05), cup(bottom=0.035)]
    assert choose_template(members, np.random.default_rng(0)) in (1, 2, 3)


def test_bent_template_lies_on_the_member_and_walls_go_to_walls(template, fitter):
    member = cup(height=0.13, bottom=0.024, top=0.046, wall=0.0015)
    found = fitter.fit(member)
    bent = trimesh.Trimesh(found.vertices, template.faces, process=False)
    assert found.residual_m < 0.0003
    assert found.covered > 0.99
    assert bent.is_volume
    assert surface_distance_m(member, bent) < 0.0003
    assert bent.volume == pytest.approx(member.volume, rel=0.05)
    thickness = wall_thickness(found.vertices, template.faces, low=0.02, high=0.12)
    assert abs(np.median(thickness) - 0.0015) < 0.0002
    # Upper ends stay upper ends: heights correspond in order.
    assert np.corrcoef(found.vertices[:, 2], template.vertices[:, 2])[0, 1] > 0.99


def test_template_fits_itself_without_moving(template, fitter):
    found = fitter.fit(template)
    assert found.residual_m < 0.0001
    assert np.linalg.norm(found.vertices - template.vertices, axis=1).mean() < 0.0015  # it may slide a little


def test_stiffness_that_grows_is_refused():
    with pytest.raises(InvalidOption):
        CorrespondenceConfig(stiff=0.01, soft=0.1)


@pytest.mark.parametrize("make", [cup, mug])
def test_turned_class_is_stood_upright(make):
    mesh = refine(make(), 0.02)
    vertices = np.array(mesh.vertices)
    turned = vertices @ random_rotation(np.random.default_rng(4)).T + 0.3
    stood = stand_up(turned[None], turned, np.array(mesh.faces), upright=False)[0]
    assert stood[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    assert np.abs(stood[:, 2] - vertices[:, 2]).max() < 0.002
    if make is mug:
        assert np.abs(stood - vertices).max() < 0.004


def test_turned_and_scaled_members_come_into_one_pose():
    rng = np.random.default_rng(5)
    members, turns = [], []
    for reach in (0.026, 0.028, 0.03):
        mesh, R = mug(reach=reach), random_rotation(rng)
        mesh.vertices = rng.uniform(0.5, 3.0) * mesh.vertices @ R.T + rng.normal(size=3)
        members.append(mesh)
        turns.append(R)
    posed = bring_into_one_pose(members, "any", rng)
    for before, after, R in zip(members, posed, turns, strict=True):
        turn = trimesh.registration.procrustes(before.vertices, after.vertices, scale=False)[0][:3, :3] @ R
        assert np.degrees(np.arccos((np.trace(turn) - 1) / 2)) < 4.0
        np.testing.assert_allclose(np.sort(before.edges_unique_length), np.sort(after.edges_unique_length))
