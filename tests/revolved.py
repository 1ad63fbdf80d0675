"""Small cups and mugs with known measures, and a quick build, for the tests of primitives."""

import numpy as np
import trimesh

from gfp_grasp.primitives import BuildConfig
from gfp_grasp.primitives.correspondence import CorrespondenceConfig
from gfp_grasp.primitives.remesh import RemeshConfig

QUICK = BuildConfig(
    rounds=1,
    parts=False,
    correspondence=CorrespondenceConfig(steps=6, rounds=3, num_samples=1200),
    remesh=RemeshConfig(min_edge=0.027, max_edge=0.1, iterations=4),
)


def cup(*, height=0.1, bottom=0.03, top=0.04, wall=0.003, sections=40):
    """A tapered cup with a round rim; the wall is `wall` thick, measured level. Closed, base at z = 0."""
    rise = np.linspace(0, 1, 12)
    outside = np.c_[bottom + (top - bottom) * rise, height * rise]
    turn = np.linspace(0, np.pi, 5)[1:-1]
    rim = np.c_[top - wall / 2 + wall / 2 * np.cos(turn), height + wall / 2 * np.sin(turn)]
    floor = 0.004 / height
    fall = np.linspace(1, floor, 12)
    inside = np.c_[bottom + (top - bottom) * fall - wall, height * fall]
    base = np.c_[np.linspace(0, bottom, 4)[:-1], np.zeros(3)]
    centre = np.c_[np.linspace(inside[-1, 0], 0, 4)[1:], np.full(3, inside[-1, 1])]
    mesh = trimesh.creation.revolve(np.vstack([base, outside, rim, inside, centre]), sections=sections)
    assert mesh.is_volume
    return mesh


def mug(*, reach=0.028, **measures):
    """A cup with half a torus as its handle, towards +x."""
    body = cup(**measures)
    handle = trimesh.creation.torus(major_radius=reach, minor_radius=0.005, major_sections=32, minor_sections=12)
    handle.apply_transform(trimesh.transformations.rotation_matrix(np.pi / 2, [1, 0, 0]))
    handle.apply_translation([0.038, 0, 0.05])
    whole = trimesh.boolean.union([body, handle], engine="manifold")
    # What of the torus reaches into the cup goes: the cavity is a cone just inside the wall.
    cone = np.array([[0, 0.006], [0.0276, 0.006], [0.0371, 0.101], [0.0371, 0.2], [0, 0.2]])
    mesh = trimesh.boolean.difference([whole, trimesh.creation.revolve(cone, sections=40)], engine="manifold")
    assert mesh.is_volume
    assert mesh.euler_number == 0
    return mesh


def wall_thickness(vertices, faces, *, low, high):
    """Level thickness (n,) m of an upright wall about the z axis, at azimuths all around, between two heights."""
    mesh = trimesh.Trimesh(vertices, faces, process=False)
    azimuth = np.linspace(0, 2 * np.pi, 24, endpoint=False) + 0.01
    thickness = []
    for height in np.linspace(low, high, 7):
        start = np.tile([0.0, 0.0, height], (24, 1))
        directions = np.c_[np.cos(azimuth), np.sin(azimuth), np.zeros(24)]
        places, rays, _ = mesh.ray.intersects_location(start, directions, multiple_hits=True)
        radius = np.linalg.norm(places[:, :2], axis=1)
        for ray in range(24):
            thickness.append(np.ptp(radius[rays == ray]))
    return np.array(thickness)


def bowl(*, height=0.06, rim=0.075, base=0.03, fullness=2.5, wall=0.004, foot=0.0, sections=48):
    """A revolved bowl: its side swells from the base to the rim, more so for a larger fullness; base at z = 0."""
    rise = np.linspace(0, 1, 16)
    outer = np.c_[base + (rim - base) * (1 - (1 - rise) ** fullness) ** (1 / fullness), height * rise]
    turn = np.linspace(0, np.pi, 5)[1:-1]
    edge = np.c_[rim - wall / 2 + wall / 2 * np.cos(turn), height + wall / 2 * np.sin(turn)]
    inner = np.c_[outer[:, 0] - wall, np.maximum(outer[:, 1], wall)][::-1]
    inner = inner[inner[:, 0] > 0.2 * base]
    inner = inner[: 1 + int((inner[:, 1] > wall).sum())]
    floor = np.c_[np.linspace(inner[-1, 0], 0, 5)[1:], np.full(4, wall)]
    under = np.c_[np.linspace(0, base, 5)[:-1], np.full(4, foot)]
    if foot > 0:
        under = np.vstack([under[:-1], [[0.8 * base, foot], [0.8 * base, 0.0]]])
        floor[:, 1] += foot
        inner[:, 1] = np.maximum(inner[:, 1], wall + foot)
    mesh = trimesh.creation.revolve(np.vstack([under, outer, edge, inner, floor]), sections=sections)
    assert mesh.is_volume
    return mesh


def write_bowls(folder, *, count=24, seed=0):
    """A folder of bowls as OFF files, in random poses and sizes; every fourth is broken, and one is no mesh at all."""
    rng = np.random.default_rng(seed)
    for number in range(count):
        size = rng.uniform(0.75, 1.3)
        mesh = bowl(
            height=size * rng.uniform(0.045, 0.08),
            rim=size * rng.uniform(0.06, 0.085),
            base=size * rng.uniform(0.02, 0.038),
            fullness=rng.uniform(1.4, 3.0),
            wall=rng.uniform(0.002, 0.005),
            foot=rng.choice([0.0, 0.004]),
            sections=int(rng.integers(32, 72)),
        )
        vertices, faces = np.array(mesh.vertices), np.array(mesh.faces)
        broken = (number // 4) % 5 if number % 4 == 3 else None
        if broken == 0:  # a hole
            faces = faces[np.linalg.norm(vertices[faces].mean(axis=1) - vertices[faces[200, 0]], axis=1) > 0.012]
        elif broken == 1:  # faces that look inward
            some = rng.permutation(len(faces))[: len(faces) // 8]
            faces[some] = faces[some][:, ::-1]
        elif broken == 2:  # a soup: no two faces share a corner
            vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces)).reshape(-1, 3)
        elif broken == 3:  # faces twice, and a corner that nothing uses
            vertices, faces = np.vstack([vertices, [[1.0, 1.0, 1.0]]]), np.vstack([faces, faces[:100]])
        turn, place = trimesh.transformations.random_rotation_matrix(rng.random(3))[:3, :3], rng.normal(size=3)
        vertices = vertices @ turn.T + place
        if broken == 4:
            (folder / f"{number:02d}.off").write_text("OFF\n3 1 0\nnot a mesh")
            continue
        trimesh.Trimesh(vertices, faces, process=False).export(folder / f"{number:02d}.off")
