"""What marbles, pegs and planes are in the simulator, and insides and holes of known measures."""

from types import SimpleNamespace

import mujoco  # pyright: ignore[reportMissingTypeStubs]
import numpy as np
import pytest
import trimesh
from bodies import box_part, trough

from gfp_grasp.bench import vessels
from gfp_grasp.bench.vessels import Inside, drop_marble, handle_hole, hangs, inside_of, tilt_deg
from gfp_grasp.transforms import make_T, rotation_about

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

TROUGH, BOXES = trough()
MOVE = make_T(rotation_about((0, 0, 1), 0.7), (0.3, -0.2, 0.5))


@pytest.fixture
def scenes(monkeypatch) -> list:
    """Scenes that were to run, and for how many seconds; time stands still in them."""
    scenes = []

    def still(spec, seconds):
        model = spec.compile()
        data = mujoco.MjData(model)
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        scenes.append((model, seconds))
        return data

    monkeypatch.setattr(vessels, "_run", still)
    return scenes


def test_the_inside_of_a_trough_is_where_it_was_cut_out():
    inside = inside_of(TROUGH)
    assert inside is not None
    assert (inside.floor_m, inside.brim_m, inside.rim_m) == pytest.approx((0.0, 0.05, 0.05), abs=1e-7)
    assert inside.room_m == pytest.approx(0.02, abs=1e-3)
    np.testing.assert_allclose(inside.middle[1:], [0.02, 0.025], atol=1e-3)
    assert 0.019 < inside.middle[0] < 0.041


def test_of_two_insides_the_one_that_holds_more_water_is_meant():
    """A block with a narrow deep hole beside a wide shallow one, which holds more."""
    block = trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.06, 0.06]])
    deep = trimesh.creation.box(bounds=[[0.01, 0.02, 0.01], [0.02, 0.04, 0.1]])
    wide = trimesh.creation.box(bounds=[[0.04, 0.01, 0.04], [0.09, 0.05, 0.1]])
    inside = inside_of(trimesh.boolean.difference([block, deep, wide]))
    assert inside is not None
    assert inside.floor_m == pytest.approx(0.04, abs=1e-7)
    deeper = inside_of(trimesh.boolean.difference([block, deep, wide]), least_depth_m=0.03)
    assert deeper is not None
    assert deeper.floor_m == pytest.approx(0.01, abs=1e-7)
    assert deeper.room_m == pytest.approx(0.005, abs=1e-3)


@pytest.mark.parametrize(("depth_m", "found"), [(0.0145, False), (0.0155, True)])
def test_a_dent_of_less_than_fifteen_millimetres_is_no_inside(depth_m, found):
    block = trimesh.creation.box(bounds=[[0, 0, 0], [0.08, 0.06, 0.05]])
    dent = trimesh.creation.box(bounds=[[0.01, 0.01, 0.05 - depth_m], [0.07, 0.05, 0.1]])
    assert (inside_of(trimesh.boolean.difference([block, dent])) is not None) == found


@pytest.mark.parametrize(("scale", "cells"), [(1.0, 72), (10.0, 260)])
def test_the_map_has_cells_of_a_millimetre_or_256_across(monkeypatch, scale, cells):
    rained = []
    rays = vessels._rays
    monkeypatch.setattr(vessels, "_rays", lambda mesh, *r: (rained.append(r[0]), rays(mesh, *r))[1])
    inside = inside_of(TROUGH.copy().apply_scale(scale))
    assert inside is not None
    assert inside.room_m == pytest.approx(0.02 * scale, rel=0.06)
    (places,) = rained
    assert abs(len(np.unique(places[:, 0].round(9))) - cells) <= 1
    assert places[:, 2].tolist() == pytest.approx([0.05 * scale + 0.02] * len(places))
    margin = places[:, :2].min(axis=0) - (-0.004 * scale)
    np.testing.assert_allclose(margin, -2 * max(0.001, 0.068 * scale / 256), rtol=1e-6)


def test_a_marble_of_glass_falls_from_above_the_rim_without_sinking(scenes):
    inside = Inside(np.array([0.01, 0.02, 0.03]), 0.0, 0.05, 0.07, 0.02)
    place = drop_marble(BOXES, inside)
    np.testing.assert_allclose(place, [0.01, 0.02, 0.07 + 0.006 + 0.02])
    drop_marble(BOXES, inside, radius_m=0.004, seconds=0.5)
    (model, seconds), (small, short) = scenes
    assert (seconds, short) == (2.0, 0.5)
    assert model.body("marble").mass[0] == pytest.approx(2500 * 4 / 3 * np.pi * 0.006**3)
    assert small.geom_size[small.geom_bodyid == small.body("marble").id][0, 0] == 0.004
    assert model.opt.timestep == 0.0005
    assert model.opt.integrator == mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    assert model.opt.cone == mujoco.mjtCone.mjCONE_ELLIPTIC
    np.testing.assert_allclose(model.geom_solref, [[0.002, 1.0]] * 6)
    assert model.ngeom == len(BOXES) + 1


def test_a_thing_is_put_on_a_plane_just_below_it_with_the_mass_of_a_solid(scenes):
    lying = trimesh.creation.box(bounds=[[0, 0, 0.1], [0.1, 0.04, 0.12]])
    part = box_part([0, 0, 0.1], [0.1, 0.04, 0.12])
    assert tilt_deg(lying, [part]) == pytest.approx(0.0, abs=1e-5)
    (model, seconds) = scenes[0]
    assert seconds == 2.0
    plane = model.geom_type == mujoco.mjtGeom.mjGEOM_PLANE
    np.testing.assert_allclose(model.geom_pos[plane], [[0, 0, 0.1 - 1e-4]])
    np.testing.assert_allclose(model.geom_size[plane], [[1, 1, 0.1]])
    thing = model.body("thing")
    assert thing.mass[0] == pytest.approx(0.08)
    np.testing.assert_allclose(thing.ipos, [0.05, 0.02, 0.11], atol=1e-9)
    about = 0.08 / 12 * np.array([0.04**2 + 0.02**2, 0.1**2 + 0.02**2, 0.1**2 + 0.04**2])
    np.testing.assert_allclose(sorted(thing.inertia), sorted(about), rtol=1e-6)


@pytest.mark.parametrize(("turned_deg", "tilt"), [(30.0, 30.0), (140.0, 140.0)])
def test_the_tilt_is_the_angle_from_upright(monkeypatch, turned_deg, tilt):
    R = rotation_about((1, 2, 0), np.radians(turned_deg))
    thing = SimpleNamespace(xmat=R.ravel())
    monkeypatch.setattr(vessels, "_run", lambda spec, seconds: SimpleNamespace(body=lambda name: thing))
    block = box_part([0, 0, 0], [0.1, 0.04, 0.12])
    assert tilt_deg(block.to_trimesh(), [block]) == pytest.approx(tilt)


def test_a_peg_reaches_three_times_the_size_of_the_thing_to_both_sides(scenes):
    part = box_part([0, 0, 0], [0.1, 0.04, 0.02])
    middle, through = np.array([0.05, 0.02, 0.03]), np.array([0.0, 1.0, 0.0])
    assert hangs(part.to_trimesh(), [part], middle, through, 0.004)
    assert not hangs(part.to_trimesh(), [part], middle + np.array([0, 0, 0.4]), through, 0.004)
    model, seconds = scenes[0]
    assert seconds == 3.0
    peg = model.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE
    np.testing.assert_allclose(model.geom_size[peg][0, :2], [0.004, 0.3])
    np.testing.assert_allclose(model.geom_pos[peg], [middle], atol=1e-9)


@pytest.mark.parametrize(("below_m", "hung"), [(0.29, True), (0.31, False)])
def test_what_has_fallen_farther_than_the_peg_reaches_hangs_no_more(monkeypatch, below_m, hung):
    thing = SimpleNamespace(xipos=np.array([0.0, 0.0, 0.5 - below_m]))
    monkeypatch.setattr(vessels, "_run", lambda spec, seconds: SimpleNamespace(body=lambda name: thing))
    part = box_part([0, 0, 0], [0.1, 0.04, 0.02])
    assert hangs(part.to_trimesh(), [part], np.array([0, 0, 0.5]), np.array([0, 1.0, 0]), 0.004) == hung


def test_a_scene_runs_for_the_time_that_is_asked_for():
    spec = vessels._spec()
    body = spec.worldbody.add_body(name="ball", pos=[0, 0, 1])
    body.add_freejoint()
    body.add_geom(type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[0.01, 0, 0])
    data = vessels._run(spec, 0.2)
    assert data.time == pytest.approx(0.2)
    assert data.body("ball").xpos[2] == pytest.approx(1 - 9.81 * 0.2**2 / 2, abs=1e-3)


def handled() -> tuple[trimesh.Trimesh, np.ndarray]:
    """A block with a handle whose hole is 20 mm wide and 40 mm high, turned and moved; and which vertices are of it."""
    bounds = (
        [[-0.03, -0.03, 0], [0.03, 0.03, 0.1]],
        [[0.03, -0.005, 0.07], [0.06, 0.005, 0.08]],
        [[0.03, -0.005, 0.02], [0.06, 0.005, 0.03]],
        [[0.05, -0.005, 0.02], [0.06, 0.005, 0.08]],
    )
    mesh = trimesh.boolean.union([trimesh.creation.box(bounds=b) for b in bounds])
    handle = np.asarray(mesh.vertices[:, 0] > 0.031)
    mesh.apply_transform(MOVE)
    return mesh, handle


def test_the_hole_of_a_handle_is_found_where_it_is():
    mesh, handle = handled()
    found = handle_hole(mesh, handle)
    assert found is not None
    middle, through, room = found
    local = np.linalg.inv(MOVE) @ [*middle, 1.0]
    assert local[0] == pytest.approx(0.04, abs=1.2e-3)
    assert abs(local[1]) < 0.005  # within the thickness of the handle
    assert 0.039 < local[2] < 0.061
    np.testing.assert_allclose(np.abs(MOVE[:3, :3].T @ through), [0, 1, 0], atol=0.03)
    assert room == pytest.approx(0.01, abs=1e-3)


def test_a_handle_without_a_hole_has_none():
    mesh = handled()[0]
    plug = trimesh.creation.box(bounds=[[0.02, -0.004, 0.025], [0.055, 0.004, 0.075]])
    plug.apply_transform(MOVE)
    filled = trimesh.boolean.union([mesh, plug])
    local = np.asarray(filled.vertices) @ MOVE[:3, :3] - MOVE[:3, 3] @ MOVE[:3, :3]
    assert handle_hole(filled, local[:, 0] > 0.031) is None
