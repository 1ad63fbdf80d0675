"""Objects of a depth picture by votes: the network says which pixels are one thing, geometry where its surface ends."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from itertools import combinations

import numpy as np
from scipy import ndimage

from gfp_grasp.detect.clusters import cut_picture, keep_objects
from gfp_grasp.detect.continuation import join_behind
from gfp_grasp.detect.instances import PITCH_M, Votes, gather_votes, level_picture, vote
from gfp_grasp.detect.stacking import lower_outline, meets_below
from gfp_grasp.detect.tables import Table, keep_on_table, noise_at, noise_growth
from gfp_grasp.types import DepthImage, SensorProfile, SupportPlane

_MARGIN_PX = 24  # that the network sees around what is above the table
_AGREED = 0.85  # of the labelled pixels of a piece of surface, from which on all of it is one thing
_ONE_THING = 0.6  # mean of the bells of two parts over each other's votes, from which on they are one thing
_FAR = 4.0  # middles farther apart than so many spreads do not agree
_LEAST_SEED = 0.3  # median of a part below which it is nothing by its votes
_LEAST_OUTLINE_PX = 10  # of a lower outline below which nothing is known of what it meets
_MET = 0.3  # of its lower outline, that touches something
_SURE = 0.6  # and above which it is a thing for sure
_SAMPLE = 300  # pixels of a part whose votes are looked at


def label_by_votes(
    image: DepthImage, points: np.ndarray, table: Table, beyond_m: np.ndarray, *, sensor: SensorProfile
) -> np.ndarray:
    """Objects of a depth picture.

    Args:
        image: The picture.
        points: (h, w, 3) m of its pixels, world, NaN where nothing came back or where no object is looked for.
        table: What they stand on.
        beyond_m: (h, w), how far what is above the table is beyond its outline.
        sensor: Its noise and sizes are the units of all thresholds.

    Returns:
        (h, w) int32 labels: 0 for background, 1 for the object with most pixels, and so on.
    """
    labels, support = np.zeros(image.shape, dtype=np.int32), table.plane
    focal_px = float(image.K[0, 0])
    cut = cut_picture(points, support, image.viewpoint, focal_px, sensor=sensor)
    if cut is None:
        return labels
    pitch_m = float(np.median(cut.depth[cut.above])) / focal_px
    votes, gathered = _votes(image, support, cut.window, pitch_m)
    parts = _parted(np.where(cut.above, gathered, 0), cut.pieces)
    things = _joined(parts, votes)[parts]
    coarser = noise_growth(cut.depth)
    things = join_behind(things, cut.points, cut.depth, support, sensor=sensor, noise_growth=coarser)
    sure = _sure(things, votes.seed)
    beyond_m = beyond_m[cut.window]
    # What is sure to be a thing and meets what is below it may stand where the table is hidden; a chair meets nothing.
    outer = keep_on_table(things, beyond_m <= table.margin_m) == 0
    candidates = np.intersect1d(sure, np.unique(things[outer & (things > 0)]))
    placed = np.zeros(image.shape, dtype=np.int32)
    placed[cut.window] = things
    met = [k for k in candidates if _meets(k, placed, points, image, table, sensor)]
    reach_m = np.where(np.isin(things, met), table.reach_m, table.margin_m)
    things = np.where(keep_on_table(things, beyond_m <= reach_m) > 0, things, 0)
    labels[cut.window] = keep_objects(things, cut.points, support, cut.area_m2, sensor, coarser=coarser, sure=sure)
    return labels


def _meets(
    number: int, labels: np.ndarray, points: np.ndarray, image: DepthImage, table: Table, sensor: SensorProfile
) -> bool:
    """Whether an object touches what is seen below it, or ends where the picture ends."""
    outline = lower_outline(number, labels, points, image, table.plane, sigma_m=sensor.sigma_m)
    near = meets_below(outline, noise_at(points[labels == number], image.viewpoint, sensor))
    return len(near) < _LEAST_OUTLINE_PX or float(near.mean()) > _MET


def _sure(things: np.ndarray, seed: np.ndarray) -> np.ndarray:
    """Numbers of those things that the network takes for things."""
    return np.array([k for k in np.unique(things[things > 0]) if np.median(seed[things == k]) > _SURE], dtype=int)


def _votes(
    image: DepthImage, support: SupportPlane, window: tuple[slice, slice], pitch_m: float
) -> tuple[Votes, np.ndarray]:
    """Votes of a window of the picture, of every so many pixels and spread over those between, and their labels."""
    step = max(1, round(PITCH_M / pitch_m))
    wide = tuple(
        slice(max(s.start - _MARGIN_PX * step, 0), min(s.stop + _MARGIN_PX * step, n))
        for s, n in zip(window, image.shape, strict=True)
    )
    level = level_picture(image, support)[wide]
    votes, above = vote(level[::step, ::step], step * pitch_m)
    labels = gather_votes(votes, above)
    rows, columns = (
        np.minimum((np.arange(s.start, s.stop) - w.start + step // 2) // step, n - 1)
        for s, w, n in zip(window, wide, labels.shape, strict=True)
    )
    own = np.ix_(rows, columns)
    return Votes(votes.places[own], votes.spread_m[own], votes.seed[own]), labels[own]


def _parted(voted: np.ndarray, pieces: np.ndarray) -> np.ndarray:
    """Pieces of surface (h, w), from 1 on, each of which votes for one thing; 0 where there is no piece.

    A piece whose pixels do not agree is parted; those without a label go with the nearest of their piece.
    """
    num_pieces, num_things = int(pieces.max(initial=0)) + 1, int(voted.max(initial=0)) + 1
    counts = np.bincount((pieces * num_things + voted).ravel(), minlength=num_pieces * num_things)
    counts = counts.reshape(num_pieces, num_things)[:, 1:]
    labelled = counts.sum(axis=1)
    split = labelled > 0
    split &= counts.max(axis=1, initial=0) < _AGREED * labelled
    split[0] = False
    parts = pieces.copy()
    for piece in np.flatnonzero(split):
        inside = pieces == piece
        nearest = np.asarray(
            ndimage.distance_transform_edt(~(inside & (voted > 0)), return_distances=False, return_indices=True)
        )
        parts[inside] = num_pieces + piece * num_things + voted[nearest[0][inside], nearest[1][inside]]
    return np.unique(parts, return_inverse=True)[1].reshape(parts.shape).astype(np.int32) + int(parts.min() > 0)


def _joined(parts: np.ndarray, votes: Votes) -> np.ndarray:
    """(p + 1,) number of the thing of each part: parts that vote for one place are joined, those that agree most first.

    Two parts agree by the mean of the other's bell over the votes of either. Parts that are nothing by their votes are
    things of their own.
    """
    group = np.arange(int(parts.max(initial=0)) + 1)
    order = np.argsort(parts, axis=None, kind="stable")
    ends = np.cumsum(np.bincount(parts.ravel(), minlength=len(group)))
    places, spread_m, seed = votes.places.reshape(-1, 3), votes.spread_m.ravel(), votes.seed.ravel()
    groups: dict[int, _Voters] = {}
    for part in range(1, len(group)):
        pixels = order[ends[part - 1] : ends[part]]
        if len(pixels) and np.median(seed[pixels]) > _LEAST_SEED:
            thinned = pixels[:: -(-len(pixels) // _SAMPLE)]
            groups[part] = _Voters(places[thinned], float(np.median(spread_m[pixels])), len(pixels))
    agreed = {(a, b): _agreement(groups[a], groups[b]) for a, b in combinations(groups, 2)}
    while agreed:
        (a, b), most = max(agreed.items(), key=lambda pair: pair[1])
        if most < _ONE_THING:
            break
        group[group == b] = a
        groups[a] = groups[a].with_others(groups.pop(b))
        agreed = {pair: value for pair, value in agreed.items() if not {a, b} & set(pair)}
        agreed |= {(min(a, c), max(a, c)): _agreement(groups[a], groups[c]) for c in groups if c != a}
    return group


@dataclass(frozen=True, eq=False)
class _Voters:
    """Votes (n, 3) m of some of the pixels of a thing, the spread that they expect, and the number of its pixels."""

    places: np.ndarray
    spread_m: float
    num_pixels: int

    @cached_property
    def middle(self) -> np.ndarray:
        return np.median(self.places, axis=0)

    def with_others(self, other: _Voters) -> _Voters:
        total = self.num_pixels + other.num_pixels
        shares = self.num_pixels / total, other.num_pixels / total
        places = [
            own.places[:: max(1, int(len(own.places) / max(1.0, share * _SAMPLE)))]
            for own, share in zip((self, other), shares, strict=True)
        ]
        return _Voters(np.concatenate(places), shares[0] * self.spread_m + shares[1] * other.spread_m, total)


def _agreement(a: _Voters, b: _Voters) -> float:
    """Mean of the bells of two groups, each over the votes of the other."""
    apart = float(np.linalg.norm(a.middle - b.middle))
    if apart > _FAR * max(a.spread_m, b.spread_m):
        return 0.0
    bells = [
        np.exp(-((own.places - other.middle) ** 2).sum(axis=1) / (2 * other.spread_m**2)).mean()
        for own, other in ((a, b), (b, a))
    ]
    return float(np.mean(bells))
