"""What closes a bottle: caps, nozzles, pumps and spray heads."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import trimesh

from gfp_grasp.shapes.handles import even_path
from gfp_grasp.shapes.loft import rounded, rows, sweep

Top = tuple[np.ndarray, list[trimesh.Trimesh]]


def wide(rng: np.random.Generator, last: np.ndarray, *, jar: bool) -> np.ndarray:
    """A lid about as wide as the body, with the body's section: rings from the body's last ring to the axis."""
    tall = rng.uniform(0.008, 0.025) if jar else rng.uniform(0.015, 0.045)
    gap, edge = rng.uniform(0.0004, 0.002), rng.uniform(0.001, 0.006)
    over = rng.uniform(-0.001, 0.003) if jar else rng.uniform(-0.0015, 0.001)
    taper = 0.0 if jar else rng.choice([0.0, rng.uniform(0.0, 0.35)])
    groove = last[0] - gap - 0.0012
    corners = [
        [last[0], 0], [groove, 0.0006], [groove, 0.0012 + gap], [last[0] + over, 0.0018 + gap],
        [(last[0] + over) * (1 - taper), tall], [1e-6, tall + rng.choice([0.0, rng.uniform(0.0, 0.006)])],
    ]  # fmt: skip
    return _like(rounded(corners, [0, 0, 0, 0.0006, edge, 0]), last)


def standing(rng: np.random.Generator, above: np.ndarray) -> np.ndarray:
    """A cap to stand on, from the axis at z = 0 up to a groove below the ring `above`."""
    tall, flare = rng.uniform(0.018, 0.05), rng.uniform(-0.08, 0.3)
    half = above[0] * (1 + rng.uniform(-0.1, 0.05))
    edge = rng.uniform(0.001, 0.004)
    corners = [
        [1e-6, 0],
        [half * (1 - 0.3 * flare), 0],
        [half, tall],
        [half * 0.93, tall + 0.001],
        [half * 0.93, tall + 0.0025],
    ]
    return _like(rounded(corners, [0, edge, 0.0012, 0, 0]), above, height=0.0)


def screw(rng: np.random.Generator, neck: float, base: float) -> Top:
    """A flat or domed screw cap on a neck of any length, with or without a transfer ring."""
    bare = rng.choice([rng.uniform(0.0005, 0.004), rng.uniform(0.004, 0.05)], p=[0.65, 0.35]) * min(1, 0.02 / neck)
    over, tall, edge = rng.uniform(0.0008, 0.004), rng.uniform(0.009, 0.028), rng.uniform(0.0006, 0.004)
    out = neck + over
    dome = rng.choice([0.0, rng.uniform(0, 0.006)])
    lip = [[neck, bare]] if rng.random() < 0.5 else _ring(neck, bare, rng.uniform(0.001, 0.004))
    start = lip[-1][1]
    taper = rng.uniform(0.8, 1.02)
    corners = [[neck, 0], *lip, [out, start + 0.0004], [out * taper, start + tall], [1e-6, start + tall + dome]]
    return _turned(corners, [0, *[0.0004] * len(lip), 0.0008, edge, 0], base), []


def nozzle(rng: np.random.Generator, neck: float, base: float) -> Top:
    """A collar that runs out into a cone, as on mustard, glue and sauces."""
    out, collar = neck + rng.uniform(0.0005, 0.004), rng.uniform(0.006, 0.018)
    tip, cone = rng.uniform(0.0025, 0.006), rng.uniform(0.015, 0.045)
    step = out * rng.uniform(0.55, 0.95)
    waist = rng.uniform(0.3, 0.7)
    corners = [
        [neck, 0], [neck, 0.001], [out, 0.0015], [out, collar], [step, collar + 0.002],
        [tip + (step - tip) * rng.uniform(0.25, 0.75), collar + waist * cone], [tip, collar + cone],
        [1e-6, collar + cone],
    ]  # fmt: skip
    return _turned(corners, [0, 0, 0.0008, 0.002, 0.003, 0.02, 0.0015, 0], base), []


def sports(rng: np.random.Generator, neck: float, base: float) -> Top:
    """A cap with a dome and a spout to drink from; half of them under a tall cover."""
    out, collar = neck + rng.uniform(0.001, 0.004), rng.uniform(0.01, 0.02)
    spout = out * rng.uniform(0.3, 0.55)
    rise, dome = rng.uniform(0.01, 0.025), rng.uniform(0.003, 0.012)
    corners = [[neck, 0], [neck, 0.001], [out, 0.0015], [out, collar], [spout * 1.1, collar + dome]]
    radii = [0, 0, 0.001, 0.004, 0.002]
    if rng.random() < 0.6:
        head = spout * rng.uniform(1.0, 1.35)
        top = collar + dome + rise
        corners += [[spout, top - 0.006], [head, top - 0.005], [head, top], [1e-6, top]]
        radii += [0.001, 0.001, 0.002, 0]
    else:
        top = collar + dome + rise
        corners += [[spout, top], [1e-6, top + 0.003]]
        radii += [0.004, 0]
    return _turned(corners, radii, base), []


def pump(rng: np.random.Generator, neck: float, base: float) -> Top:
    """A collar, a thin stem and a head with a spout towards +x."""
    neck = max(neck, 0.008)
    out, collar = neck + rng.uniform(0.001, 0.004), rng.uniform(0.01, 0.02)
    stem, rise = rng.uniform(0.003, 0.005), rng.uniform(0.012, 0.035)
    head, thick = rng.uniform(0.007, 0.015), rng.uniform(0.007, 0.014)
    low = collar + rise
    corners = [
        [neck, 0], [out, 0.0005], [out, collar], [stem * 1.6, collar + 0.002], [stem, collar + 0.004], [stem, low],
        [head, low + 0.001], [head, low + thick], [1e-6, low + thick + 0.001],
    ]  # fmt: skip
    top = _turned(corners, [0, 0.001, 0.002, 0.001, 0.001, 0.001, 0.002, 0.004, 0], base)
    reach, tube = rng.uniform(0.022, 0.045), rng.uniform(0.0032, 0.0045)
    z = base + low + thick * 0.55
    droop = rng.uniform(0.0, 0.018)
    path = rounded([[0, z], [reach - 0.008, z + 0.001], [reach, z - droop]], [0, 0.008, 0], steps=10)
    return top, [_tube(path, tube * rng.uniform(1.0, 1.6), tube)]


def spray(rng: np.random.Generator, neck: float, base: float) -> Top:
    """A collar and a trigger head that points towards +x."""
    out, collar = neck + rng.uniform(0.001, 0.004), rng.uniform(0.012, 0.02)
    stalk = min(out * 0.8, 0.011)
    head_z = collar + rng.uniform(0.016, 0.03)
    top = _stalk(neck, out, collar, stalk, head_z, base)
    half, wide_half = rng.uniform(0.008, 0.014), rng.uniform(0.008, 0.013)
    z = base + head_z + 0.3 * half
    back, front = -rng.uniform(0.015, 0.03), out + rng.uniform(0.018, 0.034)
    path = np.array([[back, z - 0.35 * half], [0.4 * back, z], [0.35 * front, z], [0.7 * front, z + 0.001], [front, z]])
    size = np.interp(np.linspace(0, 1, 16), [0, 0.2, 0.6, 0.85, 1], [0.7, 1.0, 0.95, 0.65, 0.6])
    head = _tube(path, wide_half * size, half * size, count=16, power=3.5)
    # Clear of the collar, or the trigger would close a loop with it.
    kick = rng.uniform(0.004, 0.014)
    start = max(0.45 * front, out + 0.009 - kick)
    drop = min(rng.uniform(0.03, 0.045), head_z - 0.003)
    trigger = rounded([[start, z], [start + 0.004, z - 0.4 * drop], [start + kick, z - drop]], [0, 0.02, 0], steps=10)
    return top, [head, _tube(trigger, 0.006, 0.0028, power=3.0)]


def trigger_head(rng: np.random.Generator, neck: float, rising: np.ndarray) -> Top:
    """A collar, a head as long as a hand is wide with a nozzle towards +x, and a trigger below it for two fingers.

    Args:
        rng: Draws sizes.
        neck: Radius of the neck, m.
        rising: Rings (n, 4) of the bottle from its base to its neck; the trigger keeps clear of them.
    """
    base = float(rising[-1, 2])
    out, collar = neck + rng.uniform(0.0015, 0.004), rng.uniform(0.013, 0.022)
    stalk, head_z = out * rng.uniform(0.6, 0.9), collar + rng.uniform(0.012, 0.03)
    top = _stalk(neck, out, collar, stalk, head_z, base)
    half, wide_half = rng.uniform(0.009, 0.016), rng.uniform(0.008, 0.015)
    z = base + head_z + 0.4 * half
    back, front = -rng.uniform(0.02, 0.042), rng.uniform(0.034, 0.05)
    tilt = rng.uniform(-0.1, 0.25)
    path = np.array([[back, z - (0.4 * half)], [0.4 * back, z], [0.5 * front, z], [front, z + tilt * front]])
    size = np.interp(
        np.linspace(0, 1, 20), [0, 0.25, 0.6, 1], [rng.uniform(0.5, 0.9), 1.0, 0.95, rng.uniform(0.6, 0.9)]
    )
    head = _tube(path, wide_half * size, half * size, count=20, power=rng.uniform(2.4, 4.0))
    tip = rng.uniform(0.005, 0.0085)
    nose = np.array([[0.8 * front, z + 0.8 * tilt * front], [front + rng.uniform(0.006, 0.02), z + tilt * front]])
    nozzle_end = _tube(nose, tip, tip, count=8, power=2.2)
    drop, kick = rng.uniform(0.035, 0.06), rng.uniform(-0.004, 0.02)
    # Clear of the collar, or the trigger would close a loop with it.
    start = max(front * rng.uniform(0.55, 0.85), out + 0.009, out + 0.007 - kick)
    beside = rising[rising[:, 0] > min(start, start + kick) - 0.009, 2]
    drop = min(drop, z - float(beside.max(initial=0.0)) - 0.005)
    lever = rounded([[start, z], [start - 0.002, z - 0.4 * drop], [start + kick, z - drop]], [0, 0.03, 0], steps=10)
    return top, [head, nozzle_end, _tube(lever, rng.uniform(0.005, 0.009), rng.uniform(0.0024, 0.004), power=3.0)]


CAPS: dict[str, Callable[[np.random.Generator, float, float], Top]] = {
    "screw": screw, "nozzle": nozzle, "sports": sports, "pump": pump, "spray": spray, "jug": screw,
}  # fmt: skip


def _ring(neck: float, height: float, thick: float) -> list[list[float]]:
    """Corners of a transfer ring under the cap."""
    out = neck + 0.6 * thick
    return [[neck, height], [out, height + 0.0004], [out, height + thick], [neck, height + thick + 0.0004]]


def _stalk(neck: float, out: float, collar: float, stalk: float, top: float, base: float) -> np.ndarray:
    """Rings of a collar and of the stalk on it that carries a trigger head; radii and heights in m."""
    corners = [[neck, 0], [out, 0.0005], [out, collar], [stalk, collar + 0.002], [stalk, top], [1e-6, top + 0.001]]
    return _turned(corners, [0, 0.001, 0.002, 0.001, 0.001, 0], base)


def _turned(corners: list, radii: list, base: float) -> np.ndarray:
    profile = rounded(corners, radii)
    return rows(profile[:, 0], base + profile[:, 1])


def _like(profile: np.ndarray, ring: np.ndarray, *, height: float | None = None) -> np.ndarray:
    """Rings of a profile with the section of `ring`, whose narrower half-width keeps its distance from the wider."""
    lift = ring[2] if height is None else height
    aspect = ring[1] / ring[0]
    return rows(profile[:, 0], lift + profile[:, 1], aspect=aspect, power=ring[3])


def _tube(
    path: np.ndarray, across: float | np.ndarray, along: float | np.ndarray, *, count: int = 24, power: float = 2.2
) -> trimesh.Trimesh:
    return sweep(even_path(path, count), np.broadcast_to(across, count), np.broadcast_to(along, count), power=power)
