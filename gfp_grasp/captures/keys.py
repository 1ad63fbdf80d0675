"""A recording as arrays by key, as an .npz holds it: what the keys mean, and whether they fit each other."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import trimesh

from gfp_grasp.arguments import checked_pose
from gfp_grasp.camera import cloud_of, sensor_frame, view_from_points
from gfp_grasp.captures.capture import Capture
from gfp_grasp.errors import GfpGraspError, InvalidCloud, InvalidView, UnreadableFile
from gfp_grasp.transforms import apply_T, make_T
from gfp_grasp.types import DepthImage

KEYS = "points | object_points_cam | depth_m and K | points_cam"
_PICTURE_PX = 15  # an array with more rows and more columns is no list of points
_Z_UP = np.array([0.0, 0.0, 1.0])


def capture_of_keys(name: str, arrays: Mapping[str, np.ndarray]) -> Capture:
    """A recording of arrays whose keys `read_capture` explains.

    Raises:
        UnreadableFile: None of the keys that are understood, or one that does not hold what it should.
        InvalidCloud: Points of the wrong shape, or none.
        InvalidView: Picture, intrinsics, pose or mask do not fit each other.
    """
    try:
        return _capture(name, arrays)
    except GfpGraspError:
        raise
    except (TypeError, ValueError, LookupError, AttributeError) as error:  # text where numbers should be, and the like
        raise UnreadableFile(f"{name}: a key does not hold what it should: {error}") from error


def _capture(name: str, arrays: Mapping[str, np.ndarray]) -> Capture:
    T = _T_world_camera(name, arrays)
    view = _view(arrays, T)
    points = None
    if "points" in arrays:
        points = _points(name, "points", arrays["points"], columns=(3, 4))
    elif "object_points_cam" in arrays:
        points = apply_T(T, _points(name, "object_points_cam", arrays["object_points_cam"]))
    mask = arrays.get("mask")
    if mask is not None and mask.dtype.kind not in "bfiu":
        raise InvalidView(f"{name}: the mask is of {mask.dtype}; (h, w) true or false is expected")
    mask = None if mask is None else np.nan_to_num(mask).astype(bool)
    if mask is not None and view is None:
        raise InvalidView(f"{name} has a mask but no picture: add depth_m and K, or points_cam")
    if points is None and view is None:
        raise UnreadableFile(f"{name} holds {', '.join(sorted(arrays)) or 'nothing'}; expected {KEYS}")
    if mask is not None and points is None:
        assert view is not None
        points = _masked_points(name, view, mask)
    assumed = "up" not in arrays and ("T_world_camera" in arrays or "points" in arrays)
    up = _vector(name, "up", arrays) if "up" in arrays else (_Z_UP if assumed else None)
    from_camera = view is not None or "object_points_cam" in arrays
    viewpoint = _vector(name, "viewpoint", arrays) if "viewpoint" in arrays else (T[:3, 3] if from_camera else None)
    height = float(arrays["support_height"]) if "support_height" in arrays else None
    notes = _notes(arrays)
    return Capture(name, points, view, mask, viewpoint, up, height, _truth(arrays, T), assumed, notes)


def _notes(arrays: Mapping[str, np.ndarray]) -> tuple[str, ...]:
    """What the points of a camera say about its axes."""
    for key in ("points_cam", "object_points_cam"):
        frame = sensor_frame(arrays[key]) if key in arrays else None
        if frame is not None:
            return (f"the frame of {key} is taken for {frame.name}: that is where its points lie",)
    return ()


def _T_world_camera(name: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    T = np.asarray(arrays.get("T_world_camera", np.eye(4)), dtype=np.float64)
    if T.shape != (4, 4):
        raise InvalidView(f"{name}: T_world_camera has shape {T.shape}; a rigid (4, 4) transform is expected")
    if not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-4):
        raise InvalidView(
            f"{name}: the upper left 3 x 3 of T_world_camera is no rotation, and the pose not rigid:\n{T[:3, :3]}"
        )
    return checked_pose(T) if "T_world_camera" in arrays else T


def _view(arrays: Mapping[str, np.ndarray], T: np.ndarray) -> DepthImage | None:
    if "points_cam" in arrays:
        points = np.asarray(arrays["points_cam"], dtype=np.float64)
        frame = sensor_frame(points) if points.ndim == 3 and points.shape[2] == 3 else None
        R = np.eye(3) if frame is None else frame.R_frame_opencv
        return view_from_points(points @ R if points.ndim == 3 else points, T_world_camera=T @ make_T(R))
    if "depth_m" in arrays and "K" in arrays:
        return DepthImage(arrays["depth_m"], arrays["K"], T)
    if "depth_m" in arrays:
        raise InvalidView("depth_m came without its intrinsics: add K, (3, 3) px")
    return None


def _masked_points(name: str, view: DepthImage, mask: np.ndarray) -> np.ndarray:
    points = np.asarray(cloud_of(view, mask).points)
    if len(points) == 0:
        raise InvalidCloud(f"{name}: no pixel of the mask came back with a depth")
    return points


def _truth(arrays: Mapping[str, np.ndarray], T: np.ndarray) -> trimesh.Trimesh | None:
    if "mesh_vertices_cam" not in arrays or "mesh_faces" not in arrays:
        return None
    return trimesh.Trimesh(apply_T(T, arrays["mesh_vertices_cam"]), arrays["mesh_faces"].astype(int), process=False)


def _points(name: str, key: str, array: np.ndarray, *, columns: tuple[int, ...] = (3,)) -> np.ndarray:
    """Points (n, 3) m; what the columns behind the third hold is left out."""
    if array.ndim != 2 or array.shape[1] not in columns or array.dtype.kind not in "fiu":
        picture = (
            "; a depth picture goes by read_depth, --depth with --intrinsics"
            if min(array.shape, default=0) > _PICTURE_PX
            else ""
        )
        raise InvalidCloud(
            f"{name}: {key} has shape {array.shape} of {array.dtype}; (n, {' or '.join(map(str, columns))}) numbers in "
            f"metres are expected{picture}"
        )
    return array[:, :3].astype(np.float64)


def _vector(name: str, key: str, arrays: Mapping[str, np.ndarray]) -> np.ndarray:
    vector = np.asarray(arrays[key], dtype=np.float64)
    if vector.shape != (3,) or not np.isfinite(vector).all():
        raise InvalidView(f"{name}: {key} must be three finite numbers, got shape {vector.shape}")
    return vector
