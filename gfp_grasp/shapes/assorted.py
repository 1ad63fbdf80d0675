"""Endless kinds of things of no class: what a network sees so that it can tell kinds apart that it never saw.

A kind is a way to make things and a size; its members are as unlike as those of a class are. The same number of kind
and of member give the same thing. No kind is one of the families, but some could be taken for one: see `foreign_kinds`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Sequence
from zlib import crc32

import numpy as np
import trimesh

from gfp_grasp.shapes.loft import loft, rows, smooth_noise, smoothstep, sweep
from gfp_grasp.transforms import make_T, rotation_about

_GRID = np.linspace(0.0, 1.0, 25)
_SECTIONS = 32


def foreign_kinds(first: int, count: int) -> tuple[int, ...]:
    """So many numbers of kinds, from a first one on, whose members could be taken for none of the families."""
    kinds = (kind for kind in itertools.count(first) if _MAKERS[kind % len(_MAKERS)] in _FOREIGN)
    return tuple(itertools.islice(kinds, count))


def make_assorted(kind: int, member: int) -> trimesh.Trimesh:
    """One thing: m, z up, resting on z = 0; closed bodies, of which some reach into each other.

    Args:
        kind: Number of the kind, from 0 on.
        member: Number within the kind, from 0 on.
    """
    habit = np.random.default_rng([crc32(b"assorted"), kind])
    make = _MAKERS[kind % len(_MAKERS)]
    draw = _Draw(habit, np.random.default_rng([crc32(b"assorted"), kind, 1 + member]))
    mesh = make(draw)
    mesh.apply_scale(draw.about(1.0, 0.1))
    low, high = mesh.bounds
    mesh.apply_translation([-(low[0] + high[0]) / 2, -(low[1] + high[1]) / 2, -low[2]])
    return mesh


class _Draw:
    """Numbers of one thing: drawn for the kind first, then spread for the member."""

    def __init__(self, kind: np.random.Generator, member: np.random.Generator) -> None:
        self._kind, self._member = kind, member

    def size(self, low: float, high: float, spread: float = 0.15) -> float:
        """A positive number, log-uniform over the kinds."""
        return self.about(float(np.exp(self._kind.uniform(np.log(low), np.log(high)))), spread)

    def share(self, low: float, high: float, spread: float = 0.1) -> float:
        """A number that is uniform over the kinds and stays between the bounds."""
        middle = self._kind.uniform(low, high) + spread * (high - low) * self._member.normal()
        return float(np.clip(middle, low, high))

    def about(self, value: float, spread: float) -> float:
        """A member's own number, log-normal about the kind's."""
        return value * float(np.exp(spread * np.clip(self._member.normal(), -2, 2)))

    def often(self, share: float) -> bool:
        """Whether a share of the kinds does something; all members of a kind do the same."""
        return bool(self._kind.random() < share)

    def choice(self, number: int) -> int:
        """One of so many ways, the same for all members."""
        return int(self._kind.integers(number))

    def wave(self, amplitude: float) -> np.ndarray:
        """Smooth noise over the grid, three quarters of it the kind's."""
        own = smooth_noise(self._kind, _GRID, amplitude=amplitude, knots=5)
        return own + 0.25 * smooth_noise(self._member, _GRID, amplitude=amplitude, knots=5)

    def turn(self) -> np.ndarray:
        """A rotation (3, 3), the same for all members."""
        return rotation_about(self._kind.normal(size=3), self._kind.uniform(0, np.pi))


def _block(draw: _Draw) -> trimesh.Trimesh:
    """A box, as packets and books are, or one with rounded edges."""
    size = np.array([draw.size(0.03, 0.25), draw.size(0.03, 0.2), draw.size(0.02, 0.25)])
    if draw.often(0.5):
        return trimesh.creation.box(size)
    power = draw.share(3.0, 8.0)
    rounding = smoothstep(np.minimum(_GRID, 1 - _GRID) / 0.12) ** 0.5
    radius = size[0] / 2 * (0.85 + 0.15 * rounding)
    return _lofted(radius, _GRID * size[2], aspect=size[1] / size[0], power=power)


def _can(draw: _Draw) -> trimesh.Trimesh:
    """A solid that is round or nearly so, no narrower at the top than elsewhere by much."""
    radius, tall = draw.size(0.02, 0.09), draw.size(0.03, 0.2)
    profile = radius * np.exp(draw.share(-0.25, 0.25) * (_GRID - 0.5) + draw.wave(0.05))
    return _lofted(profile, _GRID * tall, aspect=draw.share(0.6, 1.0), power=draw.share(2.0, 2.6))


def _dish(draw: _Draw) -> trimesh.Trimesh:
    """An open dish, flat or deep, of any bend."""
    radius = draw.size(0.055, 0.16)
    return _dish_mesh(draw, radius, radius * draw.size(0.12, 0.95, 0.2))


def _dish_mesh(draw: _Draw, radius: float, tall: float, *, roundest: float = 3.2) -> trimesh.Trimesh:
    base, wall = radius * draw.share(0.2, 0.8), draw.size(0.0015, 0.006)
    r = base + (radius - base) * _GRID
    z = tall * _GRID ** draw.share(1.0, roundest)
    aspect, power = (draw.share(0.5, 1.0), draw.share(2.0, 6.0)) if draw.often(0.25) else (1.0, 2.0)
    outside, inside = rows(r, z, aspect=aspect, power=power), rows(r - wall, z + wall, aspect=aspect, power=power)
    inside = inside[inside[:, 0] > 1e-3]
    middle = rows([1e-6], [0.0]), rows([1e-6], [wall])
    return loft(np.concatenate([middle[0], outside, inside[::-1], middle[1]]), segments=_SECTIONS)


def _pot(draw: _Draw) -> trimesh.Trimesh:
    """A wide open vessel with a stick, with ears, with a bail or with none of them."""
    radius = draw.size(0.075, 0.16)
    tall, wall = radius * draw.size(0.3, 1.3), draw.size(0.0015, 0.005)
    belly = radius * (1 + draw.share(-0.12, 0.12) * np.sin(np.pi * _GRID))
    z = _GRID * tall
    bowl = [rows([1e-6], [0.0]), rows(belly, z), rows(belly[::-1] - wall, z[::-1] + wall * (1 - _GRID[::-1]))]
    body = loft(np.concatenate([*bowl, rows([1e-6], [wall])]), segments=_SECTIONS)
    high = tall * draw.share(0.55, 0.9)
    parts = [body]
    way = draw.choice(4)
    if way == 0:
        parts.append(_stick(draw, radius, high))
    elif way == 1:
        ear = _loop(draw, radius, high - 0.02, 0.04, 0.03)
        parts += [ear, ear.copy().apply_transform(make_T(rotation_about((0, 0, 1), np.pi)))]
    elif way == 2:
        arc = np.linspace(0, np.pi, 25)
        path = np.column_stack([radius * np.cos(arc), np.zeros(25), tall + radius * draw.share(0.5, 1.2) * np.sin(arc)])
        thick = np.full(25, draw.size(0.002, 0.006))
        parts.append(sweep(path, 1.5 * thick, thick, segments=12))
    return _together(parts)


def _ball(draw: _Draw) -> trimesh.Trimesh:
    """A ball, an egg or a pebble."""
    mesh = trimesh.creation.icosphere(subdivisions=3, radius=1.0)
    radius = draw.size(0.018, 0.1)
    mesh.apply_scale(radius * np.array([1.0, draw.share(0.6, 1.0), draw.share(0.5, 1.5)]))
    return mesh


def _rod(draw: _Draw) -> trimesh.Trimesh:
    """Something long that lies: straight, bent, thicker in its middle or at an end."""
    length, thick = draw.size(0.06, 0.3), draw.size(0.005, 0.035)
    bend = draw.share(0.0, 1.0) * length if draw.often(0.5) else 0.0
    x = (_GRID - 0.5) * length
    path = np.column_stack([x, np.zeros_like(x), bend * (_GRID - 0.5) ** 2])
    ends = np.sqrt(np.maximum(1 - (2 * _GRID - 1) ** 8, 0.0025))
    shape = ends * np.exp(draw.wave(0.35) + draw.share(-0.6, 0.6) * (_GRID - 0.5))
    mesh = sweep(path, thick * shape * draw.share(0.5, 1.0), thick * shape, segments=16)
    mesh.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2)))
    return mesh


def _cone(draw: _Draw) -> trimesh.Trimesh:
    """A cone, a dome or a bell, narrowing to a point or nearly so."""
    radius, tall = draw.size(0.025, 0.1), draw.size(0.03, 0.2)
    profile = radius * (1 - draw.share(0.8, 0.98) * _GRID ** draw.share(0.5, 4.0))
    return _lofted(profile, _GRID * tall, aspect=draw.share(0.7, 1.0))


def _heap(draw: _Draw) -> trimesh.Trimesh:
    """Two to four bodies that stand in or beside each other, as tools, toys and machines do."""
    parts = []
    for _ in range(2 + draw.choice(3)):
        extents = np.array([draw.size(0.015, 0.14) for _ in range(3)])
        match draw.choice(3):
            case 0:
                part = trimesh.creation.box(extents)
            case 1:
                part = trimesh.creation.cylinder(radius=extents[0] / 2, height=extents[1], sections=24)
            case _:
                part = trimesh.creation.icosphere(subdivisions=2, radius=0.5)
                part.apply_scale(extents)
        if draw.often(0.3):
            part.apply_transform(make_T(draw.turn()))
        part.apply_translation([draw.share(-0.07, 0.07, 0.05) for _ in range(3)])
        parts.append(part)
    return _together(parts)


def _goblet(draw: _Draw) -> trimesh.Trimesh:
    """Something on a thin foot: a lamp, a bowl on a stem, a mushroom, a trophy."""
    radius, tall = draw.size(0.05, 0.12), draw.size(0.08, 0.25)
    at, thin = draw.share(0.25, 0.6), draw.share(0.06, 0.2)
    foot = np.exp(-((_GRID / 0.08) ** 2)) * draw.share(0.4, 0.9)
    top = smoothstep((_GRID - at) / draw.share(0.05, 0.3)) * np.exp(draw.share(-1.2, 0.2) * (_GRID - at))
    profile = radius * np.maximum.reduce([foot, top, np.full_like(_GRID, thin)])
    return _lofted(profile, _GRID * tall)


def _jug(draw: _Draw) -> trimesh.Trimesh:
    """A big closed body with a loop, a spout or both."""
    radius, tall = draw.size(0.07, 0.12), draw.size(0.1, 0.24)
    belly = radius * np.exp(draw.share(-0.5, 0.3) * (_GRID - 0.4) + draw.wave(0.12))
    parts = [_lofted(belly, _GRID * tall)]
    loop, spout = draw.often(0.7), draw.often(0.7)
    if loop or not spout:
        parts.append(_loop(draw, 0.9 * radius, tall * draw.share(0.2, 0.35), tall * draw.share(0.35, 0.6), 0.05))
    if spout:
        t, reach = _GRID, draw.size(0.04, 0.09)
        rise = draw.share(0.2, 1.0) * tall * 0.6
        path = np.column_stack([-0.8 * radius - reach * t, 0 * t, tall * 0.4 + rise * t**1.5])
        thick = draw.size(0.008, 0.016) * (1.5 - t)
        parts.append(sweep(path, thick, thick, segments=16))
    if draw.often(0.4):
        knob = trimesh.creation.icosphere(subdivisions=2, radius=draw.size(0.008, 0.018))
        knob.apply_translation([0, 0, tall])
        parts.append(knob)
    return _together(parts)


def _slab(draw: _Draw) -> trimesh.Trimesh:
    """A flat thing of any outline, lying or standing on an edge: a tool, a shoe's sole, a phone."""
    turn = np.linspace(0, 2 * np.pi, 49)[:-1]
    waves = sum(draw.share(-0.35, 0.35) / n * np.cos(n * turn + draw.share(0, 2 * np.pi, 0.01)) for n in range(1, 5))
    reach = draw.size(0.03, 0.12) * np.exp(waves)
    outline = np.column_stack([reach * np.cos(turn), reach * np.sin(turn) * draw.share(0.3, 1.0)])
    thick = draw.size(0.006, 0.06)
    count = len(outline)
    vertices = np.concatenate([np.column_stack([outline, np.full(count, z)]) for z in (0.0, thick)])
    here, there = np.arange(count), np.roll(np.arange(count), -1)
    side = np.concatenate([np.stack([here, there, there + count], 1), np.stack([here, there + count, here + count], 1)])
    middle = np.array([[0, 0, 0.0], [0, 0, thick]])
    low = np.stack([np.full(count, 2 * count), there, here], 1)
    high = np.stack([np.full(count, 2 * count + 1), here + count, there + count], 1)
    mesh = trimesh.Trimesh(np.concatenate([vertices, middle]), np.concatenate([side, low, high]), process=False)
    if draw.often(0.3):
        mesh.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2)))
    return mesh


def _body_on_legs(draw: _Draw) -> trimesh.Trimesh:
    """A long body on wheels or legs, with something on top, of the size of a toy up to that of a lorry."""
    long = draw.size(0.08, 0.3)
    wide, tall, clear = long * draw.share(0.25, 0.6), long * draw.share(0.1, 0.4), long * draw.share(0.03, 0.2)
    body = trimesh.creation.box([long, wide, tall])
    body.apply_translation([0, 0, clear + tall / 2])
    cabin = trimesh.creation.box([long * draw.share(0.2, 0.8), 0.9 * wide, tall * draw.share(0.3, 1.2)])
    cabin.apply_translation([long * draw.share(-0.3, 0.3), 0, clear + tall + cabin.extents[2] / 2])
    parts, across = [body, cabin], draw.share(0.3, 0.5) * wide
    for x in (-1, 1):
        for y in (-1, 1):
            leg = trimesh.creation.cylinder(radius=max(clear, 0.004), height=0.15 * wide, sections=16)
            leg.apply_transform(make_T(rotation_about((1, 0, 0), np.pi / 2), (x * 0.35 * long, y * across, clear)))
            parts.append(leg)
    mesh = _together(parts)
    mesh.apply_scale(draw.size(1.0, 12.0) if draw.often(0.5) else 1.0)
    return mesh


def _together(parts: Sequence[trimesh.Trimesh]) -> trimesh.Trimesh:
    """Several bodies as one mesh, without cutting them."""
    ends = np.cumsum([len(part.vertices) for part in parts])
    faces = [part.faces + end - len(part.vertices) for part, end in zip(parts, ends, strict=True)]
    return trimesh.Trimesh(np.concatenate([p.vertices for p in parts]), np.concatenate(faces), process=False)


def _lofted(radius: np.ndarray, height: np.ndarray, *, aspect: float = 1.0, power: float = 2.0) -> trimesh.Trimesh:
    """A closed solid of one profile."""
    ends = rows([1e-6], height[:1]), rows([1e-6], height[-1:])
    return loft(
        np.concatenate([ends[0], rows(radius, height, aspect=aspect, power=power), ends[1]]), segments=_SECTIONS
    )


def _stick(draw: _Draw, radius: float, high: float) -> trimesh.Trimesh:
    """A long handle towards +x."""
    length, thick = draw.size(0.08, 0.2), draw.size(0.006, 0.015)
    path = np.column_stack([0.95 * radius + length * _GRID, 0 * _GRID, high + draw.share(0.0, 0.3) * length * _GRID])
    return sweep(path, np.full(25, thick), np.full(25, 0.6 * thick), segments=12)


def _loop(draw: _Draw, radius: float, low: float, span: float, reach: float) -> trimesh.Trimesh:
    """A loop towards +x."""
    turn = np.linspace(-np.pi / 2, np.pi / 2, 25)
    path = np.column_stack([0.95 * radius + reach * np.cos(turn), 0 * turn, low + span / 2 * (1 + np.sin(turn))])
    thick = np.full(25, draw.size(0.003, 0.008))
    return sweep(path, 1.5 * thick, thick, segments=12)


_MAKERS: tuple[Callable[[_Draw], trimesh.Trimesh], ...] = (
    _block, _can, _dish, _pot, _ball, _rod, _cone, _heap, _goblet, _jug, _slab, _body_on_legs,
)  # fmt: skip
_FOREIGN = (_ball, _rod, _cone, _heap, _slab)
