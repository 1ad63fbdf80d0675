"""What one view says about one object, in the form that the fit reads."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy import ndimage
from scipy.spatial import KDTree

from gfp_grasp.clouds import estimate_normals, thin
from gfp_grasp.errors import TooFewPoints
from gfp_grasp.transforms import apply_T, invert_T, look_at
from gfp_grasp.types import DepthImage, Detection

MIN_POINTS = 20
# Median depth of unseen foot of cups, mugs and bottles (seeds of the validation split), by the sine of the elevation.
_FOOT_M = 0.004

# A surface may lie this far in front of a return before the ray to the return contradicts it: sensor noise at 1 m.
_FREE_MARGIN_M = 0.006


@dataclass(frozen=True, eq=False)
class Silhouette:
    """The object's pixels in a picture, and the space that the picture saw to be empty.

    Attributes:
        K: (3, 3) px.
        T_camera_world: (4, 4).
        free_depth_m: (h, w) m, depth up to which each pixel was seen to be empty; 0 where nothing is known.
        certain: Whether the picture is a real view; else it is guessed from the points of the cloud.
        offset_px: (2, h, w) px (row, column) from each pixel to the nearest pixel of the mask.
    """

    K: np.ndarray
    T_camera_world: np.ndarray
    free_depth_m: np.ndarray
    certain: bool
    offset_px: np.ndarray

    def pixels(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Column (n,) and row (n,) px at which points (n, 3) m, world, are seen, and their depth (n,) m."""
        matrix = self.K @ self.T_camera_world[:3]
        column, row, z = matrix[:, :3] @ points.T + matrix[:, 3:]
        z = np.maximum(z, 1e-6)
        return column / z, row / z, z

    def free_space_violation(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Points that lie in space that was seen empty, and the way back.

        Args:
            points: (n, 3) m, world.

        Returns:
            Index (t,) of these points and the displacement (t, 3) m, world, that brings each onto the ray
            of the nearest pixel of the object at the same depth.
        """
        column, row, z = self.pixels(points)
        height, width = self.free_depth_m.shape
        column, row = np.rint(column), np.rint(row)
        inside = np.flatnonzero((row >= 0) & (row < height) & (column >= 0) & (column < width))
        pixel = (row[inside] * width + column[inside]).astype(np.int64)
        out = z[inside] + _FREE_MARGIN_M < self.free_depth_m.ravel()[pixel]
        offset = self.offset_px.reshape(2, -1)[:, pixel[out]]
        moved = offset.any(axis=0)
        index = inside[out][moved]
        offset = offset[:, moved]
        step = np.column_stack([offset[1] / self.K[0, 0], offset[0] / self.K[1, 1], np.zeros(len(index))])
        return index, (step * z[index, None]) @ self.T_camera_world[:3, :3]


@dataclass(frozen=True, eq=False)
class Evidence:
    """What was seen of one object, thinned.

    Attributes:
        points: (n, 3) m, spread evenly over what was seen.
        normals: (n, 3) unit, towards the viewpoint where there is one.
        oriented: Whether the sign of the normals means anything.
        viewpoint: (3,) m or None.
        up: (3,) unit.
        floor_m: Height along up that the object's lowest point has, as far as known.
        floor_sigma_m: How sure that is, for a surface that ends above it and one that ends below it.
        floor_seen: Whether a support was seen; else an occluder may hide how much farther down the object goes.
        silhouette: Or None without a viewpoint.
        sigma_m: Standard deviation of the points' noise.
        cut: (3,) unit, world: normal of the plane through the viewpoint beyond which something hides the object; None
            where all of its outline is seen.
    """

    points: np.ndarray
    normals: np.ndarray
    oriented: bool
    viewpoint: np.ndarray | None
    up: np.ndarray
    floor_m: float
    floor_sigma_m: tuple[float, float]
    floor_seen: bool
    silhouette: Silhouette | None
    sigma_m: float
    cut: np.ndarray | None = None

    def few(self, count: int) -> Evidence:
        """The same with at most count of its points, always the same ones, drawn without order."""
        if len(self.points) <= count:
            return self
        drawn = np.sort(np.random.default_rng(0).permutation(len(self.points))[:count])
        return replace(self, points=self.points[drawn], normals=self.normals[drawn])


def gather_evidence(detection: Detection, *, num_points: int = 400) -> Evidence:
    """Thin a detection's cloud, estimate normals and read its view.

    Args:
        detection: One object, n >= MIN_POINTS.
        num_points: About how many points are kept.

    Raises:
        TooFewPoints: Fewer than MIN_POINTS points.
    """
    points = detection.cloud.points
    if len(points) < MIN_POINTS:
        raise TooFewPoints(f"cloud has {len(points)} points, {MIN_POINTS} are needed: is the object in view?")
    viewpoint = detection.cloud.viewpoint
    dense = thin(points, 4000)
    sparse = thin(dense, num_points)
    normals = estimate_normals(dense, sparse, viewpoint)
    if detection.support is not None:
        floor, floor_sigma = detection.support.height_m, (0.002, 0.002)
    else:
        floor, floor_sigma = _lowest(points, viewpoint, detection.up), (0.0015, 0.003)
    if detection.view is not None and detection.mask is not None:
        silhouette = _silhouette_of_view(detection.view, detection.mask)
    elif viewpoint is not None:
        silhouette = _silhouette_of_points(dense, viewpoint, detection.up)
    else:
        silhouette = None
    return Evidence(
        points=sparse,
        normals=normals,
        oriented=viewpoint is not None,
        viewpoint=viewpoint,
        up=detection.up,
        floor_m=floor,
        floor_sigma_m=floor_sigma,
        floor_seen=detection.support is not None,
        silhouette=silhouette,
        sigma_m=detection.sensor_sigma_m,
    )


def _lowest(points: np.ndarray, viewpoint: np.ndarray | None, up: np.ndarray) -> float:
    """Height, m, down to which an object goes of which these points were seen.

    Its foot is rounded, and the steeper the view, the more of that is out of sight.
    """
    seen = float(np.quantile(points @ up, 0.001))
    if viewpoint is None:
        return seen
    sight = viewpoint - points.mean(axis=0)
    sine = float(np.clip(sight @ up / (np.linalg.norm(sight) + 1e-12), 0.0, 1.0))
    return seen - _FOOT_M * sine


def _silhouette_of_view(view: DepthImage, mask: np.ndarray) -> Silhouette:
    # Only a return that is farther proves a pixel empty up to it; no return (0) and nearer returns prove nothing.
    free = np.where(mask, 0.0, view.depth_m).astype(np.float64)
    return Silhouette(view.K, invert_T(view.T_world_camera), free, True, _offset_to(mask))


def _silhouette_of_points(points: np.ndarray, viewpoint: np.ndarray, up: np.ndarray) -> Silhouette:
    """A picture of the cloud alone: a pixel as wide as the spacing of the points, small holes closed."""
    T_world_camera = look_at(viewpoint, points.mean(axis=0), up)
    camera = apply_T(invert_T(T_world_camera), points)
    z = np.maximum(camera[:, 2], 1e-6)
    xy = camera[:, :2] / z[:, None]
    spacing = np.median(KDTree(xy).query(xy, k=2)[0][:, 1]) + 1e-9
    low, high = xy.min(axis=0), xy.max(axis=0)
    focal = min(1.0 / (1.5 * spacing), 250.0 / max(float((high - low).max()), 1e-9))
    pad = 60
    K = np.array([[focal, 0, pad - low[0] * focal], [0, focal, pad - low[1] * focal], [0, 0, 1]])
    width, height = (np.ceil((high - low) * focal).astype(int) + 2 * pad + 1).tolist()
    mask = np.zeros((height, width), dtype=bool)
    column, row = np.rint(xy * focal + pad - low * focal).astype(int).T
    mask[row, column] = True
    mask = ndimage.binary_closing(mask, structure=np.ones((3, 3)), iterations=2)
    free = np.where(mask, 0.0, np.inf)
    return Silhouette(K, invert_T(T_world_camera), free, False, _offset_to(mask))


def _offset_to(mask: np.ndarray) -> np.ndarray:
    if not mask.any():
        return np.zeros((2, *mask.shape))
    nearest = np.empty((2, *mask.shape), dtype=np.int32)
    ndimage.distance_transform_edt(~mask, return_distances=False, return_indices=True, indices=nearest)
    return (nearest - np.indices(mask.shape)).astype(np.float64)
