"""MuJoCo's depth by rays and by OpenGL agree with each other and with Embree."""

import pickle
import subprocess
import sys

import numpy as np
import pytest
import trimesh
from scipy import ndimage

mujoco = pytest.importorskip("mujoco")

from gfp_grasp import camera  # noqa: E402
from gfp_grasp.camera import render_depth  # noqa: E402
from gfp_grasp.camera.opengl_probe import opengl_backend  # noqa: E402
from gfp_grasp.camera.render import _same_in_opengl  # noqa: E402
from gfp_grasp.errors import InvalidOption  # noqa: E402
from gfp_grasp.transforms import look_at  # noqa: E402

WIDTH, HEIGHT = 320, 240
K = camera.intrinsics(WIDTH, HEIGHT, 35.0) + np.array([[37.0, 0, 30.3], [0, 0, -20.7], [0, 0, 0]])  # off-centre
T = look_at((0.35, 0.25, 0.4), (0, 0, 0.04))


def hollow():
    outer = trimesh.creation.cylinder(radius=0.045, height=0.1, sections=48)
    inner = trimesh.creation.cylinder(radius=0.042, height=0.1, sections=48)
    inner.apply_translation([0, 0, 0.003])
    cup = trimesh.boolean.difference([outer, inner])
    cup.apply_translation([0, 0, 0.05])
    return cup


def scene(mesh, group=2):
    spec = mujoco.MjSpec()
    asset = spec.add_mesh(name="thing", uservert=np.ravel(mesh.vertices), userface=np.ravel(mesh.faces))
    asset.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_MESH, meshname="thing", group=group)
    spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=[0.4, 0.4, 0.02], pos=[0, 0, -0.02])
    model = spec.compile()
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def depth(model, data, backend):
    return render_depth(model, data, K=K, width=WIDTH, height=HEIGHT, T_world_camera=T, backend=backend)


def away_from_silhouettes(depth_m, geom):
    size = 3
    even = ndimage.maximum_filter(geom, size) == ndimage.minimum_filter(geom, size)
    flat = ndimage.maximum_filter(depth_m, size) - ndimage.minimum_filter(depth_m, size) < 0.006
    return even & flat & (geom >= 0)


def test_rays_agree_with_embree_on_a_hollow_cup():
    cup = hollow()
    seen, geom = depth(*scene(cup), "rays")
    image, index = camera.render_mesh_view([cup], T_world_camera=T, K=K, width=WIDTH, height=HEIGHT, table_height=0.0)
    assert (geom != index)[image.depth_m < 0.6].mean() < 1e-3  # the box table ends before the plane does
    inner = away_from_silhouettes(seen, geom) & (geom == index)
    assert inner.sum() > 20_000
    assert np.abs(seen - image.depth_m)[inner].max() < 2e-6


def test_opengl_agrees_with_rays_within_ten_micrometres():
    if opengl_backend() == "none":
        pytest.skip("OpenGL does not draw on this machine: no EGL or OSMesa driver that MuJoCo can use")
    scene_ = scene(hollow())
    seen, geom = depth(*scene_, "rays")
    drawn, drawn_geom = depth(*scene_, "opengl")
    assert (geom == drawn_geom).mean() > 0.999
    inner = away_from_silhouettes(seen, geom) & (geom == drawn_geom)
    assert inner.sum() > 20_000
    assert np.abs(seen - drawn)[inner].max() < 1e-5


def test_auto_gives_the_picture_of_the_rays():
    scene_ = scene(hollow())
    seen, geom = depth(*scene_, "rays")
    auto, _ = depth(*scene_, "auto")
    inner = away_from_silhouettes(seen, geom)
    assert np.abs(seen - auto)[inner].max() < 1e-5


def test_open_meshes_and_round_primitives_go_through_rays():
    cup = hollow()
    assert _same_in_opengl(scene(cup)[0], K)
    cup.update_faces(np.arange(len(cup.faces)) > 3)
    assert not _same_in_opengl(scene(cup)[0], K)
    ball = mujoco.MjModel.from_xml_string('<mujoco><worldbody><geom size="0.1"/></worldbody></mujoco>')
    assert not _same_in_opengl(ball, K)


def test_an_open_cup_is_seen_from_both_sides():
    sheet = trimesh.creation.cylinder(radius=0.045, height=0.1, sections=48)
    sheet.update_faces(np.abs(sheet.face_normals[:, 2]) < 0.5)  # a tube of no thickness
    sheet.apply_translation([0, 0, 0.05])
    seen, geom = depth(*scene(sheet), "auto")
    image, index = camera.render_mesh_view([sheet], T_world_camera=T, K=K, width=WIDTH, height=HEIGHT, table_height=0.0)
    assert ((geom == 0) == (index == 0)).mean() > 0.999
    assert np.median(np.abs(seen - image.depth_m)[index == 0]) < 1e-6


def test_collision_geoms_are_not_seen():
    _, geom = depth(*scene(hollow(), group=3), "auto")
    assert set(np.unique(geom)) <= {-1, 1}


def test_unknown_backends_are_refused():
    with pytest.raises(InvalidOption, match="auto, opengl or rays"):
        depth(*scene(hollow()), "metal")


def test_a_model_that_was_drawn_still_pickles():
    model, data = scene(hollow())
    depth(model, data, "auto")
    assert pickle.loads(pickle.dumps(model)).ngeom == model.ngeom


def test_the_camera_loads_neither_mujoco_nor_torch_until_it_renders_a_scene():
    code = "import sys, gfp_grasp.camera; assert not {'mujoco', 'torch', 'coacd'} & set(sys.modules), 'too much'"
    subprocess.run([sys.executable, "-c", code], check=True)
