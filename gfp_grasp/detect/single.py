"""A cloud that should hold one object, perhaps with some of its table, and seldom as clean as that."""

from __future__ import annotations

import warnings

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import KDTree

from gfp_grasp.camera import mask_of_points
from gfp_grasp.clouds import voxel_grid
from gfp_grasp.detect.clusters import VOXEL, cluster_points, label_points
from gfp_grasp.detect.detector import UP, DetectConfig, make_detection
from gfp_grasp.detect.support import find_support
from gfp_grasp.detect.tables import find_table
from gfp_grasp.detect.upright import guess_up
from gfp_grasp.detect.validate import MIN_POINTS, robust_extents
from gfp_grasp.errors import InvalidCloud, InvalidView, NothingDetected
from gfp_grasp.parallel import one_thread
from gfp_grasp.types import DepthImage, Detection, SensorProfile, SupportPlane, View
from gfp_grasp.units import unit_advice

# No camera has an object fill more of its picture than this, to either side; from within one it is a half space.
_RINGS_APART = 6.0  # steps of a LiDAR's rings that points of one thing may be apart
_MAX_HALF_ANGLE_DEG = 65.0
_MIN_SHARE_IN_MASK = 0.1
_CROWD_OF = 4000  # grid cells among which the neighbours of each are counted
_SECOND_SHARE = 0.1  # a second cluster of this share of the first's surface is worth a warning
# Multiples of the sensor's noise:
_NEAR = 40.0  # clusters this near may be one object behind an occluder,
_BEHIND = 70.0  # and those this near that are beside each other in the picture one surface, seen at a slant
_SAME_RANGE = 20 / 3  # a pixel sees a point when their ranges agree to this

_BESIDE = 4.0  # of the angles between neighbouring rays
_COMPANY = 4  # neighbouring rays to the same range, that a flying pixel does not have
_LOST_SHARE, _LOST_EXTENT = 0.03, 1.1  # points left out are worth a warning where the others extend less by this

_MAX_WIDTH = 0.3  # clusters that are farther apart are no single object; in the sensor's largest


@one_thread()
def detect_single(
    points: np.ndarray,
    *,
    viewpoint: np.ndarray | None = None,
    up: np.ndarray | None = UP,
    support_height: float | None = None,
    view: View | None = None,
    mask: np.ndarray | None = None,
    category: str | None = None,
    config: DetectConfig = DetectConfig(),
) -> Detection:
    """The one object of a cloud.

    Args:
        points: (n, 3) m, finite (see clean_cloud); table and flying pixels are taken off.
        viewpoint: (3,) m, where the camera stood; the view's camera where that is given.
        up: (3,) the support's normal; None takes a plane under the object, or else guesses, with a warning, by the axes
            of the camera and what the object looks like (see `upright`): OpenCV's, OpenGL's and a ROS body's frames are
            told apart by where the points lie; with a viewpoint that is not the origin, and no view, z where the camera
            is above the object, else another axis. `Detection.up` says which.
        support_height: Height of the table along up, m; None looks for it, and leaves support None where there is none.
        view: All that the sensor saw.
        mask: (h, w) bool, the object's pixels in it; None marks the pixels that the points fall on.
        category: Given class.
        config: Switches.

    Raises:
        NothingDetected: Nothing stands above the support.
        InvalidCloud: Several clusters, wider apart than one object can be, an object that is too large, or a viewpoint
            that is within it or out of range.
        InvalidView: A mask without a view or of another shape, or a view that did not see the points.
    """
    mask = _checked_mask(mask, view)
    if view is not None and viewpoint is None:
        viewpoint = view.viewpoint
    points = points[:: -(-len(points) // config.max_points)]
    support = _support(points, viewpoint, up, support_height, view, config)
    if support is not None:
        up = support.normal
    mine = _object_points(points, support, None if viewpoint is None else np.asarray(viewpoint, dtype=float), config)
    if viewpoint is not None:
        _refuse_viewpoint(np.asarray(viewpoint, dtype=np.float64), mine, config.sensor)
    if up is None:
        up = guess_up(mine, viewpoint, view)
    if view is not None:
        mask = _mask_of(mine, view, mask, config.sensor)
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
    view: View | None,
    config: DetectConfig,
) -> SupportPlane | None:
    if support_height is not None:
        if up is None:
            found = _support(points, viewpoint, None, None, view, config)
            up = guess_up(points, viewpoint, view) if found is None else found.normal
        return SupportPlane(up, support_height)
    if isinstance(view, DepthImage):
        table = find_table(view, up, sensor=config.sensor).best
        if table is not None:
            return table.plane
    return find_support(points, up, viewpoint=viewpoint, sensor=config.sensor)


def _object_points(
    points: np.ndarray, support: SupportPlane | None, viewpoint: np.ndarray | None, config: DetectConfig
) -> np.ndarray:
    """Points of the object alone: above the support, in one cluster or in several near ones, no flying pixels."""
    if config.sensor.step_rad and viewpoint is not None:
        labels = _between_rings(points, support, viewpoint, config.sensor)
    elif support is None:
        centres, cell_of = voxel_grid(points, VOXEL * config.sensor.sigma_m)
        labels = cluster_points(centres, config.sensor)[cell_of]
    else:
        labels = label_points(points, support, sensor=config.sensor, drop=False)
    if viewpoint is not None:
        labels = _joined_at_a_slant(points, labels, viewpoint, config.sensor)
    sizes = np.bincount(labels)[1:]
    if not sizes.size or sizes.max() < MIN_POINTS:
        above = "" if support is None else " above the support"
        advice = "is its height right, and" if support is not None else "are there more, from nearer by, and"
        raise NothingDetected(
            f"no {MIN_POINTS} of the {len(points)} points hang together{above}: {advice} is this the object?"
        )
    chosen = points[np.isin(labels, _chosen_clusters(points, labels, config.sensor))]
    return _without_flying(chosen, viewpoint, config.sensor)


def _joined_at_a_slant(
    points: np.ndarray, labels: np.ndarray, viewpoint: np.ndarray, sensor: SensorProfile
) -> np.ndarray:
    """Labels of clusters, those joined that neighbouring rays saw near each other.

    A surface at a slant, or behind a rim, comes back in strips that are wider apart than its points are elsewhere.
    """
    count = int(labels.max())
    if count < 2:
        return labels
    tree, beside, _ = _rays(points, viewpoint)
    first = int(np.bincount(labels[labels > 0]).argmax())
    some = np.flatnonzero((labels > 0) & (labels != first))
    some = some[:: -(-len(some) // 2000)]
    near = [
        (a, b) for a, found in zip(some, tree.query_ball_point(tree.data[some], beside), strict=True) for b in found
    ]
    a, b = np.array(near).T
    meet = (labels[b] > 0) & (np.linalg.norm(points[a] - points[b], axis=1) < _BEHIND * sensor.sigma_m)
    ends = labels[a[meet]], labels[b[meet]]
    graph = coo_array((np.ones(len(ends[0])), ends), shape=(count + 1, count + 1))
    joined = connected_components(graph, directed=False)[1][labels]
    answer = np.zeros_like(labels)
    answer[labels > 0] = np.unique(joined[labels > 0], return_inverse=True)[1] + 1
    return answer


def _warn_of_lost(chosen: np.ndarray, points: np.ndarray) -> None:
    """Warn where the chosen of the points above the support are fewer, and reach less far, than all of them."""
    lost = 1.0 - len(chosen) / len(points)
    extents_m, all_m = robust_extents(chosen), robust_extents(points)
    if lost > _LOST_SHARE and (all_m > _LOST_EXTENT * extents_m).any():
        axis = int((all_m - extents_m).argmax())
        warnings.warn(
            f"{lost:.0%} of the points hang apart from the others and are left out: with them the object would be "
            f"{all_m[axis]:.3g} m long, not {extents_m[axis]:.3g} m; mend the crop, or give the viewpoint",
            stacklevel=6,
        )


def _between_rings(
    points: np.ndarray, support: SupportPlane | None, viewpoint: np.ndarray, sensor: SensorProfile
) -> np.ndarray:
    """(n,) int32 clusters of what a LiDAR saw, 0 for what is of the road and for outliers.

    A side that is met at a slant, or whose paint is dark, has returns of every few rings alone.
    """
    above = np.ones(len(points), dtype=bool) if support is None else support.distances(points) > sensor.floor_m
    labels = np.zeros(len(points), dtype=np.int32)
    if above.any():
        range_m = float(np.median(np.linalg.norm(points[above] - viewpoint, axis=1)))
        labels[above] = cluster_points(points[above], sensor, least_gap_m=_RINGS_APART * sensor.step_rad * range_m)
    return labels


def _chosen_clusters(points: np.ndarray, labels: np.ndarray, sensor: SensorProfile) -> list[int]:
    """The biggest cluster, and those so near that an occluder may part them; warns of every other one that counts."""
    cell_m = 2 * VOXEL * sensor.sigma_m
    surface = [len(voxel_grid(points[labels == k], cell_m)[0]) for k in range(1, int(labels.max()) + 1)]
    first = int(np.argmax(surface)) + 1
    others = [
        k for k in range(1, len(surface) + 1) if k != first and surface[k - 1] > _SECOND_SHARE * surface[first - 1]
    ]
    if not others:
        _refuse_too_large(points[labels == first], sensor)
        _warn_of_lost(points[labels == first], points[labels > 0])
        return [first]
    everything = points[np.isin(labels, [first, *others])]
    width_m = float(robust_extents(everything).max())
    if width_m > _MAX_WIDTH * sensor.largest_m:
        raise InvalidCloud(
            f"the cloud holds {1 + len(others)} clusters, {width_m:.2f} m across together, and clusters of one "
            f"object are within {_MAX_WIDTH * sensor.largest_m:.2f} m: pass one object's points, or the depth picture "
            'to complete_scene; if a LiDAR saw it, say so (sensor="lidar")'
        )
    tree = KDTree(points[labels == first])
    near = [k for k in others if tree.query(_few(points[labels == k]))[0].min() < _NEAR * sensor.sigma_m]
    fate = "taken for one object behind an occluder" if near else "only the biggest is used"
    warnings.warn(f"the cloud holds {1 + len(others)} clusters; {len(near) + 1} of them: {fate}", stacklevel=5)
    return [first, *near]


def _refuse_too_large(points: np.ndarray, sensor: SensorProfile) -> None:
    extent_m = float(robust_extents(points).max())
    if extent_m > sensor.largest_m:
        raise InvalidCloud(
            f"the object is {extent_m:.4g} m across, at most {sensor.largest_m} is expected: "
            f"{unit_advice(extent_m, least_m=sensor.smallest_m, most_m=sensor.largest_m)}; if it holds more than one "
            'object, crop it; if a LiDAR saw it, say so (sensor="lidar")'
        )


def _without_flying(points: np.ndarray, viewpoint: np.ndarray | None, sensor: SensorProfile) -> np.ndarray:
    """Points whose surroundings are not much emptier than the object's: flying pixels hang in the air by themselves.

    Those of a surface at a slant are far from each other, but at the range of some that neighbouring rays saw. All of a
    LiDAR's are kept: its dark sides are as empty.
    """
    if sensor.step_rad:
        return points
    cell_m = VOXEL * sensor.sigma_m
    centres, cell_of = voxel_grid(points, cell_m)
    some = centres[:: -(-len(centres) // _CROWD_OF)]
    crowd = KDTree(some).query_ball_point(centres, 4 * cell_m, return_length=True)
    dense = (crowd >= 0.2 * np.median(crowd))[cell_of]
    if viewpoint is not None and not dense.all():
        tree, beside, range_m = _rays(points, viewpoint)
        alone = np.flatnonzero(~dense)
        for i, near in zip(alone, tree.query_ball_point(tree.data[alone], beside), strict=True):
            dense[i] = (np.abs(range_m[near] - range_m[i]) < 4 * cell_m).sum() > _COMPANY
    return points[dense] if dense.sum() >= MIN_POINTS else points


def _rays(points: np.ndarray, viewpoint: np.ndarray) -> tuple[KDTree, float, np.ndarray]:
    """A tree of the unit rays to points (n, 3), how far apart in it neighbours may be, and their ranges (n,) m."""
    sight = points - viewpoint
    range_m = np.linalg.norm(sight, axis=1)
    rays = sight / np.maximum(range_m[:, None], 1e-9)
    tree = KDTree(rays)
    return tree, _BESIDE * float(np.median(tree.query(_few(rays), k=2)[0][:, 1])), range_m


def _refuse_viewpoint(viewpoint: np.ndarray, points: np.ndarray, sensor: SensorProfile) -> None:
    sight = points - viewpoint
    distance = np.linalg.norm(sight, axis=1)
    if np.median(distance) > sensor.farthest_m:
        away_m = float(np.median(distance))
        advice = unit_advice(away_m, least_m=0.1, most_m=sensor.farthest_m)
        raise InvalidCloud(
            f"viewpoint is {away_m:.4g} m away from the object, at most {sensor.farthest_m:.0f} is expected: is it in "
            f"the frame of the cloud, and in metres? ({advice})"
        )
    middle = points.mean(axis=0) - viewpoint
    cosine = sight @ middle / np.maximum(distance * np.linalg.norm(middle), 1e-12)
    if np.quantile(cosine, 0.05) < np.cos(np.radians(_MAX_HALF_ANGLE_DEG)):
        raise InvalidCloud(
            f"viewpoint is inside of the object or touches it, {distance.min():.3f} m from its nearest point: give the "
            "place where the camera stood, in the frame of the cloud, or None if it is unknown"
        )


def _checked_mask(mask: object, view: View | None) -> np.ndarray | None:
    if mask is None:
        return None
    if view is None:
        raise InvalidView("a mask came without its view: give both, or neither")
    try:
        pixels = np.asarray(mask)
        pixels = np.nan_to_num(pixels).astype(bool) if pixels.dtype.kind == "f" else pixels.astype(bool)
    except (TypeError, ValueError, RuntimeError) as error:
        raise InvalidView(f"mask is a {type(mask).__name__}; an (h, w) bool array is expected") from error
    if pixels.shape != view.shape:
        raise InvalidView(f"mask has shape {pixels.shape}, the view {view.shape}")
    return pixels


def _mask_of(points: np.ndarray, view: View, mask: np.ndarray | None, sensor: SensorProfile) -> np.ndarray:
    """The given mask, or else the pixels of the points; refused where it or the view has nothing of the points."""
    seen = mask_of_points(points, view, tolerance_m=_SAME_RANGE * sensor.sigma_m)
    if not seen.any():
        raise InvalidView(
            "the view saw nothing where the points are: is its pose (T_world_camera) in the frame of the cloud?"
        )
    if mask is None:
        return seen
    share = float((seen & mask).sum() / seen.sum())
    if share < _MIN_SHARE_IN_MASK:
        raise InvalidView(f"the mask covers {share:.0%} of the points' pixels: is it true on the object's pixels?")
    return mask


def _few(points: np.ndarray) -> np.ndarray:
    return points[:: -(-len(points) // 2000)]
