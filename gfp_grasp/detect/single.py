"""A cloud that should hold one object, perhaps with some of its table, and seldom as clean as that."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from scipy.spatial import KDTree

from gfp_grasp.camera import project
from gfp_grasp.detect.clusters import cluster_points, label_points, voxel_grid
from gfp_grasp.detect.detector import UP, DetectConfig, make_detection, picture_support
from gfp_grasp.detect.support import find_support
from gfp_grasp.detect.validate import MAX_OBJECT_M, MIN_POINTS, robust_extents
from gfp_grasp.errors import InvalidCloud, InvalidView, NothingDetected
from gfp_grasp.types import DepthImage, Detection, SupportPlane

# Angles of a camera above the horizon that are tried where neither up nor a table is known.
_CAMERA_ELEVATIONS_DEG = (30.0, 15.0, 45.0, 0.0, 60.0)
_SECOND_SHARE = 0.1  # a second cluster of this share of the first's surface is worth a warning
_NEAR_M = 0.06  # clusters this near may be one object behind an occluder
_VOXEL_M = 0.003


def detect_single(
    points: np.ndarray,
    *,
    viewpoint: np.ndarray | None = None,
    up: np.ndarray | None = UP,
    support_height: float | None = None,
    view: DepthImage | None = None,
    mask: np.ndarray | None = None,
    category: str | None = None,
    config: DetectConfig = DetectConfig(),
) -> Detection:
    """The one object of a cloud.

    Args:
        points: (n, 3) m, finite (see clean_cloud); table and flying pixels are taken off.
        viewpoint: (3,) m, where the camera stood; the view's camera where that is given.
        up: (3,) the support's normal; None takes a plane under the object, or the camera's axes: of several
            elevations the one under which the object looks most like a known class. `Detection.up` says which.
        support_height: Of the table along up, m; None looks for it, and leaves support None where there is none.
        view: The whole depth picture.
        mask: (h, w) bool, the object's pixels in it; None marks the pixels that the points fall on.
        category: Given class.
        config: Switches.

    Raises:
        NothingDetected: Nothing stands above the support.
        InvalidCloud: Several clusters, wider apart than one object can be, or an object that is too large.
        InvalidView: A mask without a view.
    """
    if mask is not None and view is None:
        raise InvalidView("a mask came without its view: give both, or neither")
    if view is not None and viewpoint is None:
        viewpoint = view.T_world_camera[:3, 3]
    points = points[:: -(-len(points) // config.max_points)]
    support = _support(points, viewpoint, up, support_height, view, config)
    if support is not None:
        up = support.normal
    mine = _object_points(points, support, config)
    if up is None:
        up = _likely_up(mine, view)
    if view is not None and mask is None:
        mask = _pixels_of(mine, view)
    return make_detection(
        mine,
        viewpoint=viewpoint,
        up=up / np.linalg.norm(up),
        support=support,
        view=view,
        mask=mask,
        category=category,
        config=config,
    )


def _support(
    points: np.ndarray,
    viewpoint: np.ndarray | None,
    up: np.ndarray | None,
    support_height: float | None,
    view: DepthImage | None,
    config: DetectConfig,
) -> SupportPlane | None:
    if support_height is not None:
        if up is None:
            found = _support(points, viewpoint, None, None, view, config)
            up = _likely_up(points, view) if found is None else found.normal
        return SupportPlane(up, support_height)
    if view is not None:
        found = picture_support(view, up, config)
        if found is not None:
            return found
    return find_support(points, up, viewpoint=viewpoint, config=config.support)


def _object_points(points: np.ndarray, support: SupportPlane | None, config: DetectConfig) -> np.ndarray:
    """Points of the object alone: above the support, in one cluster or in several near ones, no flying pixels."""
    if support is None:
        centres, cell_of = voxel_grid(points, _VOXEL_M)
        labels = cluster_points(centres, config.clusters.gap_m)[cell_of]
    else:
        labels = label_points(points, support, config=replace(config.clusters, max_object_m=np.inf, min_area_m2=1e-6))
    sizes = np.bincount(labels)[1:]
    if not sizes.size or sizes.max() < MIN_POINTS:
        height = "" if support is None else f" above the support at {support.height_m:.4g} m along up"
        raise NothingDetected(
            f"no {MIN_POINTS} points hang together{height}: is that height right, and is this the object?"
        )
    return _without_flying(points[np.isin(labels, _chosen_clusters(points, labels, config))])


def _chosen_clusters(points: np.ndarray, labels: np.ndarray, config: DetectConfig) -> list[int]:
    """The biggest cluster, and those so near that an occluder may part them; warns of every other one that counts."""
    surface = [len(voxel_grid(points[labels == k], 2 * _VOXEL_M)[0]) for k in range(1, int(labels.max()) + 1)]
    first = int(np.argmax(surface)) + 1
    others = [
        k for k in range(1, len(surface) + 1) if k != first and surface[k - 1] > _SECOND_SHARE * surface[first - 1]
    ]
    if not others:
        _refuse_too_large(points[labels == first])
        return [first]
    everything = points[np.isin(labels, [first, *others])]
    width_m = float(robust_extents(everything).max())
    if width_m > config.max_width_m:
        raise InvalidCloud(
            f"the cloud holds {1 + len(others)} clusters, {width_m:.2f} m across together, and an object of a known "
            f"class is at most {config.max_width_m} m: pass one object's points, or the depth picture to complete_scene"
        )
    tree = KDTree(points[labels == first])
    near = [k for k in others if tree.query(_few(points[labels == k]))[0].min() < _NEAR_M]
    fate = "taken for one object behind an occluder" if near else "only the biggest is used"
    warnings.warn(f"the cloud holds {1 + len(others)} clusters; {len(near) + 1} of them: {fate}", stacklevel=4)
    return [first, *near]


def _refuse_too_large(points: np.ndarray) -> None:
    extent_m = float(robust_extents(points).max())
    if extent_m > MAX_OBJECT_M:
        raise InvalidCloud(
            f"the object is {extent_m:.4g} m across, at most {MAX_OBJECT_M} is expected: if the cloud is in "
            "millimetres, divide it by 1000; if it holds more than one object, crop it"
        )


def _without_flying(points: np.ndarray) -> np.ndarray:
    """Points whose surroundings are not much emptier than the object's: flying pixels hang in the air by themselves."""
    centres, cell_of = voxel_grid(points, _VOXEL_M)
    crowd = KDTree(centres).query_ball_point(centres, 4 * _VOXEL_M, return_length=True)
    dense = (crowd >= 0.2 * np.median(crowd))[cell_of]
    return points[dense] if dense.sum() >= MIN_POINTS else points


def _likely_up(points: np.ndarray, view: DepthImage | None) -> np.ndarray:
    """The direction under which the classifier is surest, of the frame's z and a level camera's likely elevations."""
    from gfp_grasp.detect.classifier import classify  # torch, only where it is asked for

    R = np.eye(3) if view is None else view.T_world_camera[:3, :3]
    elevations = np.radians(_CAMERA_ELEVATIONS_DEG)
    ups = [R @ np.array([0.0, -np.cos(e), -np.sin(e)]) for e in elevations]
    if view is not None:
        ups.append(UP)
    return max(ups, key=lambda up: max(classify(points, up).values()))


def _pixels_of(points: np.ndarray, view: DepthImage) -> np.ndarray:
    """(h, w) bool, pixels of the view in which the points lie, at the depth that it saw."""
    height, width = view.depth_m.shape
    mask = np.zeros((height, width), dtype=bool)
    pixels, depth = project(points, view.K, view.T_world_camera)
    seen = depth > 0
    columns, rows = np.round(pixels[seen]).astype(int).T
    inside = (rows >= 0) & (rows < height) & (columns >= 0) & (columns < width)
    rows, columns, depth = rows[inside], columns[inside], depth[seen][inside]
    agrees = np.abs(view.depth_m[rows, columns] - depth) < 0.01
    mask[rows[agrees], columns[agrees]] = True
    return mask


def _few(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // 2000)]
