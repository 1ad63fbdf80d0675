"""Endless things of no class: what a completion that knows no class learns from, and is measured on.

A kind is a way to make things: things like apples, tools and toys, and plain unions, revolutions, sweeps and shells.
The same kind, split and number give the same thing; splits share none.
"""

from __future__ import annotations

from collections.abc import Callable
from zlib import crc32

import numpy as np
import trimesh
from scipy.interpolate import CubicSpline

from gfp_grasp.errors import InvalidOption
from gfp_grasp.shapes.loft import smooth_noise, smoothstep, unite
from gfp_grasp.shapes.pieces import GRID, chain, hull, placed, random_solid, turned, without
from gfp_grasp.shapes.shape import SPLITS
from gfp_grasp.transforms import make_T, random_rotation, rotation_about

_CLEANED = 1e-4  # of the longest side: vertices without which the surface moves by less are left out

Make = Callable[[np.random.Generator], list[trimesh.Trimesh]]


def make_mixture(kind: str, number: int, *, split: str = "train") -> trimesh.Trimesh:
    """One thing of no class.

    Args:
        kind: One of MIXTURES.
        number: Number within the kind, from 0 on.
        split: "train", "val" or "test".

    Returns:
        One watertight body, m, resting on z = 0, its box about the z axis.

    Raises:
        InvalidOption: No such kind or split.
    """
    if kind not in _MAKERS or split not in SPLITS:
        kinds, splits = ", ".join(MIXTURES), ", ".join(SPLITS)
        raise InvalidOption(f"no things {kind!r} of a split {split!r}: choose one of {kinds}, and one of {splits}")
    rng = np.random.default_rng([crc32(f"{kind} {split}".encode()), number])
    make, smallest_m, largest_m = _MAKERS[kind]
    bodies = make(rng)
    longest = float(np.ptp(np.concatenate([body.vertices for body in bodies]), axis=0).max())
    mesh = unite(bodies, tolerance_m=_CLEANED * longest)
    mesh = max(mesh.split(only_watertight=True), key=lambda body: body.volume)
    mesh.apply_scale(_log_uniform(rng, smallest_m, largest_m) / float(mesh.extents.max()))
    low, high = mesh.bounds
    mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    return trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)


def _apple(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A lumpy ball, an egg, a pear or a bent fruit; dents at its ends, lobes around, a stalk."""
    ball = trimesh.creation.icosphere(subdivisions=4)
    directions = np.array(ball.vertices)
    azimuth, height = np.arctan2(directions[:, 1], directions[:, 0]), directions[:, 2]
    flat = np.sqrt(np.maximum(1 - height**2, 0))
    radius = 1 + np.interp(height, np.linspace(-1, 1, 40), smooth_noise(rng, GRID, amplitude=0.08, knots=5))
    radius += flat * rng.uniform(0, 0.09) * np.cos(rng.integers(2, 7) * azimuth + rng.uniform(0, 2 * np.pi))
    for _ in range(3):  # bumps
        radius += rng.uniform(-0.12, 0.12) * np.exp(-3 * (1 - directions @ _direction(rng)))
    for end in (-1, 1):
        depth, width = rng.choice([0.0, rng.uniform(0.05, 0.35)]), rng.uniform(0.03, 0.12)
        radius -= depth * np.exp(-(1 - end * height) / width)
    long = rng.choice([rng.uniform(0.75, 1.2), rng.uniform(1.2, 4.0)], p=[0.65, 0.35])
    points = np.maximum(radius, 0.3)[:, None] * directions * [1, rng.uniform(0.8, 1.0), long]
    bend = rng.uniform(0, 0.9) / long if long > 1.8 else 0.0
    points[:, 0] += bend * points[:, 2] ** 2 / long
    bodies = [trimesh.Trimesh(points, ball.faces, process=False)]
    if rng.random() < 0.4:
        top = points[np.abs(points[:, :2]).sum(axis=1) < 0.5 * flat.max()]
        start = top[top[:, 2].argmax()] if len(top) else points[points[:, 2].argmax()]
        way = np.array([rng.uniform(-0.3, 0.3), rng.uniform(-0.3, 0.3), rng.uniform(0.3, 0.8)])
        bodies.append(chain(np.array([start - 0.15 * way, start + 0.5 * way, start + way]), rng.uniform(0.03, 0.08)))
    return bodies


def _tool(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A handle along x with a head at one end or at both."""
    length, thick = 1.0, rng.uniform(0.02, 0.09)
    bend = rng.uniform(-0.15, 0.15) if rng.random() < 0.4 else 0.0
    t = np.linspace(0, 1, 14)
    path = np.column_stack([length * t, 0 * t, bend * np.sin(np.pi * t)])
    swell = np.exp(smooth_noise(rng, t, amplitude=rng.uniform(0, 0.35), knots=5))
    bodies = [chain(path, thick * swell, flat=rng.uniform(0.4, 1.0))]
    bodies += [placed(part, (length, 0, 0)) for part in _head(rng, thick)]
    if rng.random() < 0.3:
        back = rotation_about((0, 0, 1), np.pi)
        bodies += [placed(part, (0, 0, 0), back) for part in _head(rng, thick)]
    return bodies


def _head(rng: np.random.Generator, thick: float) -> list[trimesh.Trimesh]:
    """Bodies at the origin that a handle from -x ends in: a block, a blade, prongs, a ring, a bulb or a bar."""
    wide, deep = rng.uniform(0.15, 0.5), rng.uniform(0.08, 0.35)
    match rng.integers(6):
        case 0:
            tall = rng.uniform(1.2, 4) * thick
            return [placed(trimesh.creation.box([deep, wide, tall]), (rng.uniform(0, 0.5) * deep, 0, 0))]
        case 1:
            point, thin = rng.uniform(0.1, 1.0), rng.uniform(0.006, 0.02)
            corners = [[-0.5 * thick, w * wide / 2, z * thin] for w in (-1, 1) for z in (-1, 1)]
            corners += [[2 * deep, w * point * wide / 2, 0.5 * z * thin] for w in (-1, 1) for z in (-1, 1)]
            return [hull(np.array(corners))]
        case 2:
            count, slim = int(rng.integers(2, 5)), rng.uniform(0.012, 0.03)
            across = np.linspace(-wide / 2, wide / 2, count)
            bar = chain(np.column_stack([0 * across, across, 0 * across]), 1.3 * slim)
            curve = np.linspace(0, 1, 8)
            rise = rng.uniform(-0.2, 0.2) * deep * curve**2
            prongs = [chain(np.column_stack([2 * deep * curve, 0 * curve + y, rise]), slim) for y in across]
            return [bar, *prongs]
        case 3:
            gap = rng.choice([0.0, rng.uniform(0.4, 1.6)])
            turn = np.linspace(gap / 2, 2 * np.pi - gap / 2, 25)
            radius = wide / 2
            ring = np.column_stack([radius + radius * np.cos(turn), radius * np.sin(turn), 0 * turn])
            return [chain(ring, rng.uniform(0.02, 0.07), flat=rng.uniform(0.5, 1.0))]
        case 4:
            bulb = trimesh.creation.icosphere(subdivisions=3, radius=0.5)
            bulb.apply_scale([2 * deep, wide, rng.uniform(0.05, 0.3)])
            return [placed(bulb, (0.7 * deep, 0, 0))]
        case _:
            t = np.linspace(-0.5, 0.5, 10)
            bow = rng.uniform(-0.15, 0.15) * (1 - 4 * t**2)
            upright = rng.random() < 0.5
            bar = np.column_stack([bow, 0 * t if upright else wide * t, wide * t if upright else 0 * t])
            return [chain(bar, rng.uniform(0.03, 0.09) * (1 + rng.uniform(-0.5, 0.5) * 2 * t))]


def _toy(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A trunk along x with limbs or wheels in pairs, a head, something on top."""
    long, wide, tall = 1.0, rng.uniform(0.25, 0.8), rng.uniform(0.2, 0.8)
    trunk = random_solid(rng, np.array([long, wide, tall]))
    bodies, under = [trunk], -0.5 * tall
    legs = rng.uniform(0.05, 0.6)
    reach = rng.uniform(0.3, 0.45)
    wheels = rng.random() < 0.4
    for x in (-reach, reach) if rng.random() < 0.75 else (0.0,):
        radius = rng.uniform(0.06, 0.22)
        for side in (-1, 1):
            hip = np.array([x, side * wide * rng.uniform(0.25, 0.32), under + 0.25 * tall])
            if wheels:
                wheel = trimesh.creation.cylinder(radius=radius, height=0.5 * wide, sections=28)
                wheel.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2), (x, side * 0.4 * wide, under)))
                bodies.append(wheel)
            else:
                foot = hip * [1, 1.2, 0] + [0, 0, under - legs]
                bodies.append(chain(np.linspace(hip, foot, 4), radius * rng.uniform(0.4, 0.7)))
    if rng.random() < 0.8:
        size = rng.uniform(0.2, 0.55) * np.array([1, rng.uniform(0.7, 1.1), rng.uniform(0.7, 1.2)])
        head = np.array([rng.uniform(0.35, 0.6), 0, rng.uniform(0.2, 0.6) * tall + 0.3 * size[2]])
        bodies.append(placed(random_solid(rng, size), head))
        bodies.append(chain(np.linspace([0.3, 0, 0.2 * tall], head, 4), 0.3 * size[1]))
        if rng.random() < 0.5:  # ears
            for side in (-1, 1):
                ear = head + np.array([0, side * 0.35 * size[1], 0.35 * size[2]])
                tip = ear + rng.uniform(0.1, 0.35) * np.array([-0.2, 0.5 * side, 1])
                bodies.append(chain(np.linspace(ear, tip, 3), np.linspace(0.06, 0.025, 3)))
    if rng.random() < 0.5:  # a tail, an arm, a mast
        start = np.array([rng.uniform(-0.45, 0.2), 0, rng.uniform(0, 0.4) * tall])
        way = start + np.array([rng.uniform(-0.6, 0), 0, rng.uniform(0.2, 0.9)])
        bodies.append(chain(np.array([start, (start + way) / 2 + [0, 0, 0.1], way]), rng.uniform(0.025, 0.08)))
    return bodies


def _union(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Two to six solids, each with its middle on the surface of one before."""
    bodies = [_at_will(random_solid(rng, _extents(rng)), rng)]
    for _ in range(int(rng.integers(1, 6))):
        other = bodies[int(rng.integers(len(bodies)))]
        spot = np.array(other.vertices)[int(rng.integers(len(other.vertices)))]
        middle = other.vertices.mean(axis=0)
        bodies.append(placed(_at_will(random_solid(rng, 0.8 * _extents(rng)), rng), middle + 0.8 * (spot - middle)))
    return bodies


def _revolution(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A solid of one profile, round or nearly so, with steps, waists and flares."""
    tall = rng.uniform(0.3, 3.0)
    profile = np.exp(smooth_noise(rng, GRID, amplitude=rng.uniform(0.05, 0.5), knots=int(rng.integers(3, 7))))
    for _ in range(int(rng.integers(0, 4))):
        step = smoothstep((GRID - rng.uniform(0.05, 0.95)) / rng.uniform(0.01, 0.15))
        profile = profile * (1 + rng.uniform(-0.6, 0.6) * step)
    ends = smoothstep(np.minimum(GRID, 1 - GRID) / rng.uniform(0.01, 0.2)) ** 0.5
    profile = np.maximum(profile * (rng.uniform(0.3, 1.0) * (1 - ends) + ends), 0.04)
    aspect, power = rng.choice([1.0, rng.uniform(0.5, 1.0)]), rng.choice([2.0, rng.uniform(2.0, 6.0)])
    return [turned(profile, tall * GRID, aspect=aspect, power=power)]


def _sweep(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A tube along a curve in space, thicker here and thinner there; some are closed to a ring, some fork."""
    bodies: list[trimesh.Trimesh] = []
    path = np.zeros((1, 3))
    for _ in range(1 if rng.random() < 0.7 else 2):
        knots = rng.normal(size=(int(rng.integers(3, 6)), 3)) * [1, rng.uniform(0.2, 1), rng.uniform(0.1, 0.8)]
        ring = rng.random() < 0.3
        if ring:
            turn = np.linspace(0, 2 * np.pi, 7)[:, None]
            knots = np.concatenate([np.cos(turn), rng.uniform(0.5, 1) * np.sin(turn), 0 * turn], axis=1)
            knots[:-1] += 0.15 * rng.normal(size=(6, 3))
            knots[-1] = knots[0]
        else:
            knots = knots + np.linspace(0, rng.uniform(0, 3), len(knots))[:, None] * _direction(rng)
        if bodies:  # it begins on the first
            knots = knots - knots[0] + path[int(rng.integers(len(path)))]
        curve = CubicSpline(np.linspace(0, 1, len(knots)), knots, bc_type="periodic" if ring else "natural")
        t = np.linspace(0, 1, 29)
        path = curve(t)
        length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
        thick = length * np.exp(rng.uniform(np.log(0.012), np.log(0.09)))
        swell = np.exp(smooth_noise(rng, t, amplitude=rng.uniform(0, 0.3), knots=4))
        swell[-1] = swell[0] if ring else swell[-1]
        bodies.append(chain(path, thick * swell, flat=rng.uniform(0.3, 1.0)))
    return bodies


def _shell(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """Something thin: an open vessel, a pipe, a scoop or a bent sheet; vessels may have a handle."""
    if rng.random() < 0.3:
        return _bent_sheet(rng)
    tall, wall = rng.uniform(0.2, 2.2), rng.uniform(0.012, 0.08)
    side = np.exp(smooth_noise(rng, GRID, amplitude=0.15, knots=4)) * (1 + rng.uniform(-0.6, 0.6) * (GRID - 0.5))
    aspect, power = rng.choice([1.0, rng.uniform(0.5, 1.0)]), rng.choice([2.0, rng.uniform(2.5, 6.0)])
    outer = turned(side, tall * GRID, aspect=aspect, power=power)
    through = rng.random() < 0.2  # a pipe
    inside = np.linspace(-0.1 * tall if through else min(wall, 0.5 * tall), 1.1 * tall, 40)
    inner = turned(np.maximum(np.interp(inside, tall * GRID, side) - wall, 0.1), inside, aspect=aspect, power=power)
    body = without(outer, inner)
    if rng.random() < 0.2:  # a scoop: a part is cut away
        block = trimesh.creation.box([6, 6, 6])
        tilt = rotation_about((rng.normal(), rng.normal(), 0.2), rng.uniform(0.2, 1.4))
        body = without(body, placed(block, tilt @ (0, 0, 3 + tall * rng.uniform(0.3, 0.9)), tilt))
    if rng.random() > 0.35:
        return [body]
    turn = np.linspace(-np.pi / 2, np.pi / 2, 14)
    low, high = np.sort(rng.uniform(0.1, 0.9, 2)) * tall
    reach, at = rng.uniform(0.25, 0.7), np.interp([low, high], tall * GRID, side) - 0.6 * wall
    x = np.interp(turn, [-np.pi / 2, np.pi / 2], at) + reach * np.cos(turn)
    path = np.column_stack([x, 0 * turn, (low + high) / 2 + (high - low) / 2 * np.sin(turn)])
    return [body, chain(path, rng.uniform(0.05, 0.12), flat=rng.uniform(0.4, 1.0))]


def _bent_sheet(rng: np.random.Generator) -> list[trimesh.Trimesh]:
    """A strip that is folded a few times, as brackets, trays and book ends are."""
    wide, thin = rng.uniform(0.3, 1.5), rng.uniform(0.015, 0.05)
    heading, place, bodies = 0.0, np.zeros(2), []
    for _ in range(int(rng.integers(1, 4))):
        length = rng.uniform(0.4, 1.2)
        after = place + length * np.array([np.cos(heading), np.sin(heading)])
        corners = [[*(end + thin * np.array(s)), y] for end in (place, after) for s in _SQUARE for y in (0, wide)]
        bodies.append(hull(np.array(corners)))
        place, heading = after, heading + rng.choice([-1, 1]) * rng.uniform(0.4, 1.7)
    return bodies


_SQUARE = ((-1, -1), (-1, 1), (1, -1), (1, 1))


def _at_will(mesh: trimesh.Trimesh, rng: np.random.Generator) -> trimesh.Trimesh:
    """Turned at will half of the time, else upright."""
    return placed(mesh, (0, 0, 0), random_rotation(rng) if rng.random() < 0.5 else None)


def _extents(rng: np.random.Generator) -> np.ndarray:
    return np.exp(rng.uniform(np.log(0.15), np.log(1.0), 3))


def _direction(rng: np.random.Generator) -> np.ndarray:
    way = rng.normal(size=3)
    return way / np.linalg.norm(way)


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


# Who makes a kind, and its smallest and largest longest side, m.
_MAKERS: dict[str, tuple[Make, float, float]] = {
    "apple-like": (_apple, 0.03, 0.2),
    "tool-like": (_tool, 0.08, 0.35),
    "toy-like": (_toy, 0.05, 0.3),
    "union": (_union, 0.03, 0.4),
    "revolution": (_revolution, 0.03, 0.35),
    "sweep": (_sweep, 0.06, 0.35),
    "shell": (_shell, 0.04, 0.35),
}
MIXTURES = tuple(_MAKERS)
