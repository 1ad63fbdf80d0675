"""Depth of a MuJoCo scene: by its own rays anywhere, by OpenGL where that works and gives the same picture."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

import atexit
import importlib
import os
import threading
from typing import Literal

import mujoco
import numpy as np

from gfp_grasp.camera.cast import FARTHEST_M
from gfp_grasp.camera.lidar import HDL_64, LidarModel, scan_of_hits
from gfp_grasp.camera.opengl_probe import opengl_backend
from gfp_grasp.camera.pinhole import pixel_rays
from gfp_grasp.errors import InvalidOption
from gfp_grasp.transforms import FLIP_YZ
from gfp_grasp.types import RangeImage

VISIBLE_GROUPS = (0, 1, 2)  # MuJoCo's own default; our collision parts are in group 3

# OpenGL draws these as they are; it tessellates round primitives coarsely, which rays do not.
_EXACT_IN_OPENGL = (mujoco.mjtGeom.mjGEOM_BOX, mujoco.mjtGeom.mjGEOM_MESH)


def render_depth(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    K: np.ndarray,
    width: int,
    height: int,
    T_world_camera: np.ndarray,
    backend: Literal["auto", "opengl", "rays"] = "auto",
    farthest_m: float = FARTHEST_M,
) -> tuple[np.ndarray, np.ndarray]:
    """Ideal depth of the scene as `data` stands (after mj_forward or a step).

    Args:
        model: The compiled scene; geoms of groups 0 to 2 are seen.
        data: Its state.
        K: (3, 3) px; the principal point may lie anywhere, skew must be zero for OpenGL.
        width: Columns.
        height: Rows.
        T_world_camera: (4, 4), OpenCV camera.
        backend: "rays" casts mj_multiRay; "opengl" draws; "auto" draws where OpenGL works and every visible geom is a
            box or a closed mesh, for which both agree within 1e-5 m away from silhouettes. OpenGL does not see the
            back faces of an open mesh.
        farthest_m: Nothing farther along the optical axis is returned.

    Returns:
        depth (h, w) float32 m, 0 where nothing is seen, and geom id (h, w) int32, -1 where nothing is seen.

    Raises:
        InvalidOption: Unknown backend, or "opengl" where OpenGL does not work.
    """
    if backend not in ("auto", "opengl", "rays"):
        raise InvalidOption(f"backend is {backend!r}; auto, opengl or rays is expected")
    if backend == "opengl" and opengl_backend() == "none":
        raise InvalidOption("OpenGL does not draw on this machine: use backend='auto' or 'rays'")
    draw = backend == "opengl" or (backend == "auto" and opengl_backend() != "none" and _same_in_opengl(model, K))
    if draw:
        renderer = _opengl_depth(model)
        depth, geom = renderer.draw(model, data, K=K, width=width, height=height, T_world_camera=T_world_camera)
    else:
        depth, geom = _cast(model, data, K, width, height, T_world_camera, farthest_m)
    lost = (geom < 0) | (depth > farthest_m)
    return np.where(lost, 0.0, depth).astype(np.float32), np.where(lost, -1, geom).astype(np.int32)


def _cast(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    K: np.ndarray,
    width: int,
    height: int,
    T_world_camera: np.ndarray,
    farthest_m: float,
) -> tuple[np.ndarray, np.ndarray]:
    rays = pixel_rays(K, width, height).reshape(-1, 3) @ T_world_camera[:3, :3].T
    length = np.linalg.norm(rays, axis=1)
    distance, geom = cast_scene(
        model, data, T_world_camera[:3, 3], rays / length[:, None], cutoff_m=float(farthest_m * length.max())
    )
    depth = np.where(geom >= 0, distance / length, 0.0)
    return depth.reshape(height, width), geom.reshape(height, width)


def cast_scene(
    model: mujoco.MjModel, data: mujoco.MjData, origin: np.ndarray, directions: np.ndarray, *, cutoff_m: float
) -> tuple[np.ndarray, np.ndarray]:
    """Distance (r,) m to what unit directions (r, 3) from an origin (3,) m meet, -1 for nothing, and its geom id (r,).

    Geoms of the visible groups are met, up to cutoff_m.
    """
    num = len(directions)
    geom, distance = np.full(num, -1, dtype=np.int32), np.full(num, -1.0)
    groups = np.array([group in VISIBLE_GROUPS for group in range(mujoco.mjNGROUP)], dtype=np.uint8)
    flat, start = np.ascontiguousarray(directions).ravel(), np.ascontiguousarray(origin, dtype=np.float64)
    arguments = [model, data, start, flat, groups, 1, -1, geom, distance]
    if "normal" in (mujoco.mj_multiRay.__doc__ or ""):  # an argument more since MuJoCo 3.4
        arguments.append(None)
    mujoco.mj_multiRay(*arguments, num, cutoff_m)
    return distance, geom


def scan_scene(
    model: mujoco.MjModel,
    data: mujoco.MjData,
    *,
    T_world_sensor: np.ndarray,
    lidar: LidarModel = HDL_64,
    rng: np.random.Generator | None = None,
) -> tuple[RangeImage, np.ndarray]:
    """One turn in a MuJoCo scene as `data` stands (after mj_forward or a step).

    Args:
        model: The compiled scene; geoms of groups 0 to 2 are seen.
        data: Its state.
        T_world_sensor: (4, 4).
        lidar: Rings, shots and noise.
        rng: Draws noise and lost returns; None leaves both out.

    Returns:
        The scan, and the geom id (h, w) int32 that each shot met, -1 nothing.
    """
    directions = (lidar.rays() @ T_world_sensor[:3, :3].T).reshape(-1, 3)
    range_m, geom = cast_scene(model, data, T_world_sensor[:3, 3], directions, cutoff_m=lidar.farthest_m)
    return scan_of_hits(np.where(geom < 0, np.inf, range_m), geom, lidar, T_world_sensor, rng)


class OpenGLDepth:
    """One off-screen OpenGL context for one model. Belongs to the thread and process that made it."""

    def __init__(self, model: mujoco.MjModel, platform: str) -> None:
        self._gl = importlib.import_module(f"mujoco.{platform}").GLContext(
            model.vis.global_.offwidth, model.vis.global_.offheight
        )
        self._gl.make_current()
        self._scene = mujoco.MjvScene(model, maxgeom=2 * model.ngeom + 100)
        self._context = mujoco.MjrContext(model, mujoco.mjtFontScale.mjFONTSCALE_100)
        mujoco.mjr_setBuffer(mujoco.mjtFramebuffer.mjFB_OFFSCREEN, self._context)
        self._context.readDepthMap = mujoco.mjtDepthMap.mjDEPTH_ZEROFAR  # reversed z: precise at every distance
        self._option = mujoco.MjvOption()
        for groups in ("sitegroup", "jointgroup", "tendongroup", "actuatorgroup", "flexgroup", "skingroup"):
            getattr(self._option, groups)[:] = 0
        self._option.geomgroup[:] = [group in VISIBLE_GROUPS for group in range(mujoco.mjNGROUP)]

    def draw(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        *,
        K: np.ndarray,
        width: int,
        height: int,
        T_world_camera: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Depth (h, w) float64 m along the optical axis, and geom id (h, w), -1 where only background is seen."""
        self._gl.make_current()
        if width > self._context.offWidth or height > self._context.offHeight:
            mujoco.mjr_resizeOffscreen(width, height, self._context)
        scene, camera = self._scene, mujoco.MjvCamera()
        mujoco.mjv_updateScene(model, data, self._option, None, camera, mujoco.mjtCatBit.mjCAT_ALL, scene)
        near, far = (edge * model.stat.extent for edge in (model.vis.map.znear, model.vis.map.zfar))
        for eye in scene.camera:  # left and right eye; a picture of one is drawn with their mean
            _aim(eye, K, width, height, T_world_camera, near, far)
        scene.flags[mujoco.mjtRndFlag.mjRND_SEGMENT] = True
        scene.flags[mujoco.mjtRndFlag.mjRND_IDCOLOR] = True
        viewport, colour = mujoco.MjrRect(0, 0, width, height), np.empty((height, width, 3), dtype=np.uint8)
        z_buffer = np.empty((height, width), dtype=np.float32)
        mujoco.mjr_render(viewport, scene, self._context)
        mujoco.mjr_readPixels(colour, z_buffer, viewport, self._context)
        z = z_buffer[::-1].astype(np.float64)
        depth = near * far / (near + z * (far - near))  # reversed z: 0 is far, 1 is near
        return depth, _geom_ids(scene, colour[::-1])

    def close(self) -> None:
        """Free the context."""
        self._context.free()
        self._gl.free()


def _aim(
    eye: mujoco.MjvGLCamera, K: np.ndarray, width: int, height: int, T_world_camera: np.ndarray, near: float, far: float
) -> None:
    """Give an OpenGL camera the pose and the frustum of K; the picture's edges are half a pixel off the centres."""
    T = T_world_camera @ FLIP_YZ
    eye.pos, eye.forward, eye.up = T[:3, 3], -T[:3, 2], T[:3, 1]
    left, right = (-0.5 - K[0, 2]) / K[0, 0], (width - 0.5 - K[0, 2]) / K[0, 0]
    top, bottom = (0.5 + K[1, 2]) / K[1, 1], (K[1, 2] + 0.5 - height) / K[1, 1]
    eye.frustum_center, eye.frustum_width = near * (left + right) / 2, near * (right - left) / 2
    eye.frustum_top, eye.frustum_bottom = near * top, near * bottom
    eye.frustum_near, eye.frustum_far = near, far


def _geom_ids(scene: mujoco.MjvScene, colour: np.ndarray) -> np.ndarray:
    code = colour.astype(np.int64) @ np.array([1, 2**8, 2**16])
    geom_of = np.full(scene.ngeom + 2, -1, dtype=np.int32)
    for geom in scene.geoms[: scene.ngeom]:
        if geom.segid >= 0 and geom.objtype == mujoco.mjtObj.mjOBJ_GEOM:
            geom_of[geom.segid + 1] = geom.objid
    return geom_of[np.clip(code, 0, len(geom_of) - 1)]


def _same_in_opengl(model: mujoco.MjModel, K: np.ndarray) -> bool:
    visible = np.isin(model.geom_group, VISIBLE_GROUPS) & ((model.geom_rgba[:, 3] > 0) | (model.geom_matid >= 0))
    kinds, meshes = model.geom_type[visible], model.geom_dataid[visible]
    if K[0, 1] != 0 or not np.isin(kinds, _EXACT_IN_OPENGL).all():
        return False
    return all(_is_closed(model, mesh) for mesh in np.unique(meshes[kinds == mujoco.mjtGeom.mjGEOM_MESH]))


def _is_closed(model: mujoco.MjModel, mesh: int) -> bool:
    """Every directed edge of the mesh has its opposite."""
    start, count = model.mesh_faceadr[mesh], model.mesh_facenum[mesh]
    faces = model.mesh_face[start : start + count].astype(np.int64)
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    forward, backward = edges[:, 0] << 32 | edges[:, 1], edges[:, 1] << 32 | edges[:, 0]
    return np.array_equal(np.sort(forward), np.sort(backward))


# Making a context takes tens of milliseconds and drivers leak: the last one of each thread is kept, with its model.
_kept = threading.local()


def _opengl_depth(model: mujoco.MjModel) -> OpenGLDepth:
    held = getattr(_kept, "renderer", None)
    if held is None or held[0] is not model or held[1] != os.getpid():
        _close_kept()
        _kept.renderer = (model, os.getpid(), OpenGLDepth(model, opengl_backend()))
        # Registered after the platform's own exit hook, so that it runs before it: a context outlives no display.
        atexit.unregister(_close_kept)
        atexit.register(_close_kept)
    return _kept.renderer[2]


def _close_kept() -> None:
    held = getattr(_kept, "renderer", None)
    if held is not None and held[1] == os.getpid():  # a forked child must not free its parent's context
        held[2].close()
    _kept.renderer = None
