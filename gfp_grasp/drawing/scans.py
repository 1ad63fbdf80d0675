"""A whole LiDAR scan seen obliquely from above, with the completed objects standing in it: the paper's first figure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from PIL import Image, ImageDraw

from gfp_grasp.camera import cast_rays, intrinsics, pixel_rays
from gfp_grasp.completion import CompletedScene
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import apply_T, invert_T, look_at, make_T, rotation_between
from gfp_grasp.types import RangeImage

# Blue, red, green, amber, violet, teal, pink, brown: apart from each other in hue, and each deep enough to be paled.
_CLASS_RGB = np.array(
    [
        *((38, 98, 176), (196, 58, 48), (44, 134, 82), (214, 128, 18)),
        *((118, 72, 160), (20, 132, 144), (196, 70, 130), (124, 88, 58)),
    ],
    dtype=np.uint8,
)
_PALED = 0.62  # share of white in what was guessed
_LOW_GREY, _HIGH_GREY = 184.0, 76.0  # of the road, and of what is this high above it:
_GREY_M = 4.0
_LEAST_WORDS_PX = 10  # size of the words of a legend
_PAPER = np.array([250.0, 250.0, 248.0])
_SHADOW = 0.86  # brightness of the ground in an object's shadow
_SUN = np.array([-0.38, 0.55, 0.95]) / np.linalg.norm([-0.38, 0.55, 0.95])  # level frame
_AMBIENT, _LIT = 0.62, 0.46
_SUPERSAMPLE, _FOV_DEG = 2, 36.0
_EYE_M, _AIM_M = (
    np.array([-36.0, -13.0, 21.5]),
    np.array([-0.4, 1.0, 0.0]),
)  # from the place on the road under the sensor
_POINT_M, _POINT_PX = 0.035, (1, 5)  # size of a point, and its limits before shrinking
_FADE_M = (40.0, 110.0)  # distance to the eye over which points pale away
_HIDDEN_M = 0.1  # a point this near before a surface is a part of it
_FARTHEST_M = 300.0


@dataclass(frozen=True, eq=False)
class ClassColours:
    """Colours of the classes of a scene.

    Attributes:
        rgb: (3,) uint8 of each class, the most frequent first.
        counts: Number of objects of each class.
    """

    rgb: dict[str, np.ndarray]
    counts: dict[str, int]

    @classmethod
    def of(cls, categories: Sequence[str]) -> ClassColours:
        """Colours of the classes of some objects."""
        counts = dict(sorted(Counter(categories).items(), key=lambda pair: (-pair[1], pair[0])))
        return cls({name: _CLASS_RGB[i % len(_CLASS_RGB)] for i, name in enumerate(counts)}, counts)

    def of_vertices(self, category: str, observed: np.ndarray) -> np.ndarray:
        """(v, 3) uint8: the class's colour where the surface was seen, paler where it is guessed."""
        return np.where(observed[:, None], self.rgb[category], paled(self.rgb[category]))


def paled(rgb: np.ndarray) -> np.ndarray:
    """(3,) uint8, the same hue with more white: the colour of guessed surface."""
    return (rgb + _PALED * (255.0 - rgb)).round().astype(np.uint8)


def height_greys(height_m: np.ndarray) -> np.ndarray:
    """(n, 3) uint8 of points (n,) m above the road: the road is light, what is high is dark."""
    share = np.clip(height_m / _GREY_M, 0.0, 1.0) ** 0.7
    grey = _LOW_GREY + share * (_HIGH_GREY - _LOW_GREY)
    return np.repeat(grey[:, None], 3, axis=1).round().astype(np.uint8)


def level_frame_of(scene: CompletedScene) -> np.ndarray:
    """T_level_world (4, 4) of a scan's scene: z is up, the road under the sensor is near z = 0, the sensor above 0."""
    assert isinstance(scene.view, RangeImage)
    R = rotation_between(scene.up, (0.0, 0.0, 1.0))
    place = R @ scene.view.viewpoint
    height_m = place[2] - _height_over_road(scene)
    forward = R @ scene.view.T_world_sensor[:3, 0]
    yaw = np.arctan2(forward[1], forward[0])
    turn = np.array([[np.cos(yaw), np.sin(yaw), 0.0], [-np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    return make_T(turn @ R, -turn @ np.array([place[0], place[1], height_m]))


def _height_over_road(scene: CompletedScene) -> float:
    """Height of the sensor, m; the road is taken to go on as it is below the nearest object."""
    place, up = scene.view.viewpoint, scene.up
    assert place is not None
    known = [one for one in scene if one.detection.support is not None]
    if not known:
        return 0.0
    nearest = min(known, key=lambda one: float(np.linalg.norm(one.detection.cloud.points.mean(axis=0) - place)))
    support = nearest.detection.support
    assert support is not None
    return float(support.distances(place[None])[0] / (support.normal @ up))


def scan_points(scene: CompletedScene) -> np.ndarray:
    """Points (n, 3) m of a scan's scene that belong to none of its objects, in the scan's frame."""
    assert isinstance(scene.view, RangeImage)
    rest = scene.view.range_m > 0
    for completion in scene:
        if completion.detection.mask is not None:
            rest = rest & ~completion.detection.mask
    return scene.view.points()[rest]


def first_look(scene: CompletedScene) -> tuple[np.ndarray, np.ndarray]:
    """Eye (3,) and aim (3,) m, in the scan's frame, of a look from behind, right and above of the sensor."""
    eye, aim = apply_T(invert_T(level_frame_of(scene)), np.stack([_EYE_M, _AIM_M]))
    return eye, aim


def draw_scan(scene: CompletedScene, *, width: int = 1600, height: int = 860) -> np.ndarray:
    """Picture (h, w, 3) uint8 of a scan with its completed objects, seen from behind, right and above of the sensor.

    Points are grey by their height, objects have the colour of their class, and guessed surface is paler. A legend says
    so.

    Args:
        scene: Completed objects of a LiDAR's scan.
        width: Columns.
        height: Rows.
    """
    T_level = level_frame_of(scene)
    wide, high = _SUPERSAMPLE * width, _SUPERSAMPLE * height
    K, T_camera = intrinsics(wide, high, _FOV_DEG), look_at(_EYE_M, _AIM_M)
    colours = ClassColours.of([completion.category for completion in scene])
    picture, depth_m = _cast_objects(scene, T_level, colours, pixel_rays(K, wide, high).reshape(-1, 3), T_camera)
    picture, depth_m = picture.reshape(high, wide, 3), depth_m.reshape(high, wide)
    points = apply_T(T_level, scan_points(scene))
    _paint_points(picture, depth_m, points, height_greys(points[:, 2]), K, T_camera)
    small = picture.reshape(height, _SUPERSAMPLE, width, _SUPERSAMPLE, 3).mean(axis=(1, 3))
    return _with_legend(np.clip(small, 0, 255).astype(np.uint8), colours)


def _cast_objects(
    scene: CompletedScene, T_level: np.ndarray, colours: ClassColours, rays: np.ndarray, T_camera: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Colour (p, 3) of each ray, on paper that is darker in the objects' shadows, and the depth (p,) m it met."""
    placed = [(apply_T(T_level, c.mesh.vertices), np.asarray(c.mesh.faces)) for c in scene]
    directions = rays @ T_camera[:3, :3].T
    distance, face, number = cast_rays(placed, T_camera[:3, 3], directions)
    picture = np.broadcast_to(_PAPER, (len(rays), 3)).copy()
    with np.errstate(divide="ignore"):
        to_road = np.where(directions[:, 2] < 0, -T_camera[2, 3] / directions[:, 2], np.inf)
    road = np.flatnonzero(np.isinf(distance) & (to_road < _FARTHEST_M))
    ground = T_camera[:3, 3] + to_road[road, None] * directions[road]
    dark = np.isfinite(cast_rays(placed, ground, np.broadcast_to(_SUN, ground.shape))[0])
    picture[road[dark]] *= _SHADOW
    for i, (completion, (vertices, faces)) in enumerate(zip(scene, placed, strict=True)):
        met = np.flatnonzero(number == i)
        corners = faces[face[met]]
        at = T_camera[:3, 3] + distance[met, None] * directions[met]
        weights = _barycentric(at, vertices[corners])[..., None]
        normals = (weights * vertex_normals(vertices, faces)[corners]).sum(axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-9)
        rgb = (weights * colours.of_vertices(completion.category, completion.observed)[corners]).sum(axis=1)
        picture[met] = rgb * (_AMBIENT + _LIT * np.clip(normals @ _SUN, 0.0, 1.0))[:, None]
    return picture, distance


def _barycentric(points: np.ndarray, triangles: np.ndarray) -> np.ndarray:
    """Weights (n, 3) of the corners (n, 3, 3) of the triangles that the points (n, 3) lie in."""
    a, b = triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0]
    p = points - triangles[:, 0]
    aa, ab, bb = (a * a).sum(axis=1), (a * b).sum(axis=1), (b * b).sum(axis=1)
    pa, pb = (p * a).sum(axis=1), (p * b).sum(axis=1)
    area = np.maximum(aa * bb - ab * ab, 1e-18)
    v, w = (bb * pa - ab * pb) / area, (aa * pb - ab * pa) / area
    return np.clip(np.column_stack([1 - v - w, v, w]), 0.0, 1.0)


def _paint_points(
    picture: np.ndarray, depth_m: np.ndarray, points: np.ndarray, colours: np.ndarray, K: np.ndarray, T: np.ndarray
) -> None:
    """Paint points over a picture (h, w, 3) where no surface hides them, the farthest first, as squares."""
    local = apply_T(invert_T(T), points)
    order = np.argsort(-local[:, 2])
    local, colours = local[order], colours[order].astype(np.float64)
    before = local[:, 2] > 1.0
    local, colours = local[before], colours[before]
    z = local[:, 2]
    pixels = (local @ K.T)[:, :2] / z[:, None]
    fade = np.clip((z - _FADE_M[0]) / (_FADE_M[1] - _FADE_M[0]), 0.0, 0.85)[:, None]
    colours = colours + fade * (_PAPER - colours)
    sizes = np.clip(np.round(K[0, 0] * _POINT_M / z), *_POINT_PX).astype(int)
    rows, columns = picture.shape[:2]
    for size in np.unique(sizes):
        chosen = sizes == size
        corner = np.round(pixels[chosen] - size / 2).astype(int)
        for dx in range(size):
            for dy in range(size):
                u, v = corner[:, 0] + dx, corner[:, 1] + dy
                inside = (u >= 0) & (u < columns) & (v >= 0) & (v < rows)
                u, v = u[inside], v[inside]
                shown = z[chosen][inside] < depth_m[v, u] - _HIDDEN_M
                picture[v[shown], u[shown]] = colours[chosen][inside][shown]


def _with_legend(picture: np.ndarray, colours: ClassColours) -> np.ndarray:
    """The picture over a strip that names the classes and says what pale and grey mean, in words that fit its width."""
    width = picture.shape[1]
    largest = max(_LEAST_WORDS_PX, round(width / 66))
    strips = (_legend(width, size, colours) for size in range(largest, _LEAST_WORDS_PX - 1, -1))
    strip = next((strip for strip, end in strips if end <= width), None)
    if strip is None:
        strip, _ = _legend(width, _LEAST_WORDS_PX, colours)
    return np.concatenate([picture, np.asarray(strip)])


def _legend(width: int, size: int, colours: ClassColours) -> tuple[Image.Image, float]:
    """A strip in words of a size, px, and where its last word ends."""
    strip = Image.new("RGB", (width, round(2.6 * size)), tuple(_PAPER.astype(int)))
    draw = ImageDraw.Draw(strip)
    x, y, ink = size, strip.height / 2, (60, 64, 70)

    def say(words: str) -> None:
        nonlocal x
        draw.text((x, y), words, fill=ink, font_size=size, anchor="lm")
        x += draw.textlength(words, font_size=size) + 1.2 * size

    def swatch(left: np.ndarray, right: np.ndarray) -> None:
        nonlocal x
        for k, rgb in enumerate((left, right)):
            at = x + 0.55 * size * k
            draw.rectangle((at, y - 0.45 * size, at + 0.55 * size, y + 0.45 * size), fill=tuple(int(c) for c in rgb))
        x += 1.45 * size

    for name, rgb in colours.rgb.items():
        swatch(rgb, paled(rgb))
        say(f"{name.replace('_', ' ')} {colours.counts[name]}")
    x = max(x, width - draw.textlength("pale: guessed     points, dark is high", font_size=size) - 3 * size)
    say("pale: guessed")
    swatch(*height_greys(np.array([0.0, _GREY_M])))
    say("points, dark is high")
    return strip, x - 1.2 * size
