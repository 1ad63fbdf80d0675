"""Small cups and mugs with known measures, for the tests of primitives."""

import numpy as np
import trimesh


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
