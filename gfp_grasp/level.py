"""From a detection to the level view that all later stages take, and which of a completed surface was observed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import trimesh
from scipy import ndimage
from scipy.spatial import ConvexHull, Delaunay, KDTree

from gfp_grasp.camera import visible_points
from gfp_grasp.clouds import estimate_normals, order_points, thin, thin_index
from gfp_grasp.errors import TooFewPoints
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import apply_T, invert_T, look_at, make_T
from gfp_grasp.types import (
    CompletedShape,
    DepthImage,
    Detection,
    LevelView,
    OrientedBox,
    PointCloud,
    SensorProfile,
    Silhouette,
    SupportPlane,
    View,
)

MIN_POINTS = 20
_NUM_NEIGHBOURHOOD = 4000  # points that normals are estimated from,
_NUM_DENSE = 1000  # points that have normals,
_NUM_POINTS = 400  # and points among these that a fit looks at

# Multiples of the sensor's noise:
_FEW_AT_LIMIT = 5  # points within a step of the highest ring from which on an object is taken to go on above it
_FREE_MARGIN = 4.0  # a surface may lie this far in front of a return
_FLOOR_SEEN = 4 / 3  # standard deviation of a support that was seen,
_FLOOR_GUESSED = (1.0, 2.0)  # and of one that is guessed from the lowest points, above and below it
# Median depth of unseen foot of cups, mugs and bottles (seeds of the validation split), by the sine of the elevation.
_FOOT = 8 / 3

_PADDING_PX = 60  # round a silhouette that is guessed from points
_MOST_PX = 250.0  # that it is wide


def make_level_view(detection: Detection, *, seed: int = 0) -> LevelView:
    """Order and thin a detection's points, estimate normals and read its view, in the level frame of the object.

    Args:
        detection: One object, n >= MIN_POINTS, in any frame ("world").
        seed: Chooses the points that are kept where there are very many.

    Raises:
        TooFewPoints: Fewer than MIN_POINTS points.
    """
    count = len(detection.cloud.points)
    if count < MIN_POINTS:
        raise TooFewPoints(f"cloud has {count} points, {MIN_POINTS} are needed: is the object in view?")
    points = order_points(detection.cloud.points, seed=seed)
    T = level_frame(points, detection.up, detection.cloud.viewpoint)
    if detection.support is not None:
        T[:3, 3] -= float(detection.support.distances(T[:3, 3])) * T[:3, 2]
    T_level_world = invert_T(T)
    points = order_points(apply_T(T_level_world, points))
    viewpoint = None if detection.cloud.viewpoint is None else apply_T(T_level_world, detection.cloud.viewpoint)
    neighbourhood = thin(points, _NUM_NEIGHBOURHOOD)
    dense = thin(neighbourhood, _NUM_DENSE)
    normals = estimate_normals(neighbourhood, dense, viewpoint)
    some = thin_index(dense, _NUM_POINTS)
    sensor = detection.sensor
    if detection.support is not None:
        floor_m, floor_sigma = 0.0, (_FLOOR_SEEN, _FLOOR_SEEN)
    else:
        floor_m, floor_sigma = _lowest_m(points, viewpoint, sensor), _FLOOR_GUESSED
    silhouette = None
    if detection.view is not None and detection.mask is not None:
        silhouette = _silhouette_of_view(detection.view.moved(T_level_world), detection.mask, sensor)
    elif viewpoint is not None:
        silhouette = guessed_silhouette(neighbourhood, viewpoint, sensor)
    cut = None
    if viewpoint is not None and sensor.highest_rad is not None:
        silhouette, cut = _below_highest(silhouette, points, viewpoint, sensor)
    return LevelView(
        T_world_level=T,
        cloud=PointCloud(points, viewpoint),
        dense_points=dense,
        dense_normals=normals,
        points=dense[some],
        normals=normals[some],
        floor_m=floor_m,
        floor_sigma_m=(floor_sigma[0] * sensor.sigma_m, floor_sigma[1] * sensor.sigma_m),
        floor_seen=detection.support is not None,
        silhouette=silhouette,
        sensor=sensor,
        sigma_m=detection.sensor_sigma_m,
        cut=cut,
        proposal=None if detection.proposal is None else detection.proposal.moved(T_level_world),
    )


def level_frame(points: np.ndarray, up: np.ndarray, viewpoint: np.ndarray | None) -> np.ndarray:
    """T_world_level (4, 4): z up, origin at the points' centre, x towards the viewer.

    Without a viewpoint x is the horizontal direction in which the points are spread least.
    """
    up = up / np.linalg.norm(up)
    origin = points.mean(axis=0)
    x = _horizontal(points - origin, None if viewpoint is None else viewpoint - origin, up)
    return make_T(np.column_stack([x, np.cross(up, x), up]), origin)


def move_detection(detection: Detection, T: np.ndarray) -> Detection:
    """The detection in another frame, T_new_old (4, 4); its points keep their order."""
    viewpoint, view = detection.cloud.viewpoint, detection.view
    return replace(
        detection,
        cloud=PointCloud(apply_T(T, detection.cloud.points), None if viewpoint is None else apply_T(T, viewpoint)),
        up=T[:3, :3] @ detection.up,
        support=None if detection.support is None else move_support(detection.support, T),
        box=OrientedBox(T @ detection.box.T_world_box, detection.box.extents),
        view=None if view is None else view.moved(T),
        proposal=None if detection.proposal is None else detection.proposal.moved(T),
    )


def move_support(support: SupportPlane, T: np.ndarray) -> SupportPlane:
    """The plane in another frame, T_new_old (4, 4)."""
    normal = T[:3, :3] @ support.normal
    return SupportPlane(normal, support.height_m + float(normal @ T[:3, 3]))


def mark_observed(
    vertices: np.ndarray, faces: np.ndarray, cloud: PointCloud, *, sensor_sigma_m: float, sigma_m: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Which vertices were observed, and a standard deviation for each.

    Args:
        vertices: (v, 3) m, completed surface.
        faces: (f, 3).
        cloud: What it was completed from, same frame.
        sensor_sigma_m: Noise of its points.
        sigma_m: (v,) m from the deformation, NaN where it does not tell.

    Returns:
        Observed (v,) bool: in sight of the viewpoint (of nothing, where there is none) and within three sensor
        sigmas of a point, or two and a half spacings of the points where that is wider; and sigma (v,) m, which where
        nothing else is known grows by a tenth of the distance to the nearest point.
    """
    points = cloud.points
    tree = KDTree(points)
    distance = tree.query(vertices)[0]
    spacing = float(np.median(tree.query(points[:: max(1, len(points) // 500)], k=min(2, len(points)))[0][:, -1]))
    observed = distance < max(3.0 * sensor_sigma_m, 2.5 * spacing)
    if cloud.viewpoint is not None:
        observed &= visible_points(vertices, faces, vertices, vertex_normals(vertices, faces), cloud.viewpoint)
    rough = np.hypot(sensor_sigma_m, 0.1 * distance)
    return observed, np.where(np.isfinite(sigma_m), sigma_m, rough)


def mark_shape(mesh: trimesh.Trimesh, detection: Detection) -> CompletedShape:
    """A mesh as a completed shape: which vertices were observed, and a rough sigma for each.

    Args:
        mesh: In the frame of the detection, m.
        detection: What was seen of it.
    """
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    observed, sigma = mark_observed(
        vertices,
        faces,
        detection.cloud,
        sensor_sigma_m=detection.sensor_sigma_m,
        sigma_m=np.full(len(vertices), np.nan),
    )
    return CompletedShape(mesh, observed, sigma)


def _horizontal(centred: np.ndarray, sight: np.ndarray | None, up: np.ndarray) -> np.ndarray:
    flat = np.eye(3) - np.outer(up, up)
    if sight is not None:
        x = flat @ sight
        if np.linalg.norm(x) > 1e-3:
            return x / np.linalg.norm(x)
    _, vectors = np.linalg.eigh((centred @ flat).T @ (centred @ flat) + 1e3 * np.outer(up, up) * len(centred))
    x = vectors[:, 0]
    # The sign of an eigenvector is no property of the points: the side with the longer tail is.
    x = x * (np.sign(((centred @ x) ** 3).sum()) or 1.0)
    return x / np.linalg.norm(x)


def _lowest_m(points: np.ndarray, viewpoint: np.ndarray | None, sensor: SensorProfile) -> float:
    """Height, m, down to which an object goes of which these level points were seen.

    Its foot is rounded, and the steeper the view, the more of that is out of sight.
    """
    seen = float(np.quantile(points[:, 2], 0.001))
    if viewpoint is None:
        return seen
    sight = viewpoint - points.mean(axis=0)
    range_m = float(np.linalg.norm(sight))
    sine = float(np.clip(sight[2] / (range_m + 1e-12), 0.0, 1.0))
    return seen - _FOOT * sensor.sigma_m * sine - sensor.step_rad / 2 * range_m


def _silhouette_of_view(view: View, mask: np.ndarray, sensor: SensorProfile) -> Silhouette:
    # Only a return that is farther proves a pixel empty up to it; no return (0) and nearer returns prove nothing.
    free = np.where(mask, 0.0, view.free_range_m).astype(np.float64)
    return Silhouette(view, free, True, _offset_to(mask), _FREE_MARGIN * sensor.sigma_m)


def guessed_silhouette(points: np.ndarray, viewpoint: np.ndarray, sensor: SensorProfile) -> Silhouette:
    """A picture of the cloud alone: a pixel as wide as the spacing of the points, small holes closed."""
    T_world_camera = look_at(viewpoint, points.mean(axis=0))
    camera = apply_T(invert_T(T_world_camera), points)
    xy = camera[:, :2] / np.maximum(camera[:, 2:], 1e-6)
    spacing = np.median(KDTree(xy).query(xy, k=2)[0][:, 1]) + 1e-9
    low, high = xy.min(axis=0), xy.max(axis=0)
    focal = min(1.0 / (1.5 * spacing), _MOST_PX / max(float((high - low).max()), 1e-9))
    corner = _PADDING_PX - low * focal
    K = np.array([[focal, 0, corner[0]], [0, focal, corner[1]], [0, 0, 1]])
    width, height = (np.ceil((high - low) * focal).astype(int) + 2 * _PADDING_PX + 1).tolist()
    mask = np.zeros((height, width), dtype=bool)
    column, row = np.rint(xy * focal + corner).astype(int).T
    mask[row, column] = True
    mask = ndimage.binary_closing(mask, structure=np.ones((3, 3)), iterations=2)
    between = round(sensor.step_rad / 2 * focal)  # rows, above and below, in which no ring looked
    if sensor.step_rad:
        mask = _convex(mask)
        mask = ndimage.binary_dilation(mask, structure=np.ones((2 * between + 1, 1)))
    view = DepthImage(np.zeros(mask.shape, dtype=np.float32), K, T_world_camera)
    return Silhouette(view, np.where(mask, 0.0, np.inf), False, _offset_to(mask), _FREE_MARGIN * sensor.sigma_m)


def _convex(mask: np.ndarray) -> np.ndarray:
    """The mask with all that lies between any two of its pixels: a LiDAR loses returns, of panes and dark paint."""
    pixels = np.argwhere(mask)
    if len(pixels) < 3 or np.linalg.matrix_rank(pixels - pixels[0]) < 2:
        return mask
    corners = pixels[ConvexHull(pixels).vertices].astype(np.float64)
    everywhere = np.argwhere(np.ones_like(mask))
    inside = Delaunay(corners).find_simplex(everywhere) >= 0
    return mask | inside.reshape(mask.shape)


def _below_highest(
    silhouette: Silhouette | None, points: np.ndarray, viewpoint: np.ndarray, sensor: SensorProfile
) -> tuple[Silhouette | None, np.ndarray | None]:
    """What is known of an object that goes on above all rings: of its upper end nothing.

    Returns:
        The silhouette without what it says of places above the highest ring, and the plane beyond which the object is
        out of sight (`LevelView.cut`), or None where its upper end was seen.
    """
    assert sensor.highest_rad is not None
    away = points - viewpoint
    elevation = np.arctan2(away[:, 2], np.linalg.norm(away[:, :2], axis=1))
    limit = sensor.highest_rad - sensor.step_rad
    if (elevation > limit).sum() < _FEW_AT_LIMIT:
        return silhouette, None
    if silhouette is not None and not silhouette.certain:
        height, width = silhouette.view.shape
        rows, columns = np.indices((height, width))
        there = silhouette.view.unproject(np.stack([columns, rows], axis=-1), np.ones((height, width))) - viewpoint
        above = np.arctan2(there[..., 2], np.linalg.norm(there[..., :2], axis=-1)) > limit
        silhouette = replace(silhouette, free_range_m=np.where(above, 0.0, silhouette.free_range_m))
    middle = away[:, :2].mean(axis=0)
    ahead = middle / np.linalg.norm(middle)
    return silhouette, np.array([*(-np.sin(limit) * ahead), np.cos(limit)])


def _offset_to(mask: np.ndarray) -> np.ndarray:
    if not mask.any():
        return np.zeros((2, *mask.shape))
    nearest = np.empty((2, *mask.shape), dtype=np.int32)
    ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True, indices=nearest)
    return (nearest - np.indices(mask.shape)).astype(np.float64)
