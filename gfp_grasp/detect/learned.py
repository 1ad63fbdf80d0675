"""Objects of a depth picture by votes: the network says which pixels are one thing, geometry where its surface ends."""

from __future__ import annotations

import numpy as np
from scipy import ndimage

from gfp_grasp.detect.clusters import cut_picture, keep_objects
from gfp_grasp.detect.instances import PITCH_M, gather_votes, level_picture, vote
from gfp_grasp.detect.tables import noise_growth
from gfp_grasp.types import DepthImage, SensorProfile, SupportPlane

_MARGIN_PX = 24  # that the network sees around what is above the table
_LABELLED = 0.4  # of a piece of surface, from which on the votes decide about it
_AGREED = 0.85  # of its labelled pixels, from which on all of it is one thing


def label_by_votes(
    image: DepthImage, points: np.ndarray, support: SupportPlane, *, sensor: SensorProfile
) -> np.ndarray:
    """Objects of a depth picture.

    Args:
        image: The picture.
        points: (h, w, 3) m of its pixels, world, NaN where nothing came back or where no object is looked for.
        support: What they stand on.
        sensor: Its noise and sizes are the units of all thresholds.

    Returns:
        (h, w) int32 labels: 0 for background, 1 for the object with most pixels, and so on.
    """
    labels = np.zeros(image.shape, dtype=np.int32)
    focal_px = float(image.K[0, 0])
    cut = cut_picture(points, support, image.viewpoint, focal_px, sensor=sensor)
    if cut is None:
        return labels
    pitch_m = float(np.median(cut.depth[cut.above])) / focal_px
    voted = np.where(cut.above, _votes(image, support, cut.window, pitch_m), 0)
    things = _snapped(voted, cut.pieces)
    coarser = noise_growth(cut.depth)
    labels[cut.window] = keep_objects(things, cut.points, support, cut.area_m2, sensor, coarser=coarser)
    return labels


def _votes(image: DepthImage, support: SupportPlane, window: tuple[slice, slice], pitch_m: float) -> np.ndarray:
    """(h, w) int32 labels of a window of the picture, by the votes of every so many pixels."""
    step = max(1, round(PITCH_M / pitch_m))
    wide = tuple(
        slice(max(s.start - _MARGIN_PX * step, 0), min(s.stop + _MARGIN_PX * step, n))
        for s, n in zip(window, image.shape, strict=True)
    )
    level = level_picture(image, support)[wide]
    votes, above = vote(level[::step, ::step], step * pitch_m)
    coarse = gather_votes(votes, above)
    rows, columns = (
        np.minimum((np.arange(s.start, s.stop) - w.start + step // 2) // step, n - 1)
        for s, w, n in zip(window, wide, coarse.shape, strict=True)
    )
    return coarse[np.ix_(rows, columns)]


def _snapped(voted: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Labels (h, w) that end where pieces of surface end; a piece that nobody voted for is a thing of its own."""
    num_pieces, num_things = int(pieces.max(initial=0)) + 1, int(voted.max(initial=0)) + 1
    counts = np.bincount((pieces * num_things + voted).ravel(), minlength=num_pieces * num_things)
    counts = counts.reshape(num_pieces, num_things)
    labelled = counts[:, 1:].sum(axis=1)
    first = counts[:, 1:].max(axis=1, initial=0)
    known = labelled >= _LABELLED * counts.sum(axis=1)
    whole = known & (first >= _AGREED * labelled)
    own = np.where(whole, counts[:, 1:].argmax(axis=1) + 1 if num_things > 1 else 0, 0)
    own = np.where(known, own, num_things + np.arange(num_pieces))
    own[0] = 0
    things = own[pieces]
    for piece in np.flatnonzero(known & ~whole)[(np.flatnonzero(known & ~whole) > 0)]:
        inside = pieces == piece
        seen = inside & (voted > 0)
        nearest = np.asarray(ndimage.distance_transform_edt(~seen, return_distances=False, return_indices=True))
        things[inside] = voted[nearest[0][inside], nearest[1][inside]]
    return things.astype(np.int32)
