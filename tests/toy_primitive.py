"""A small statistical cup of known structure: every member has the same rings, so its modes are exact."""

import math
from functools import lru_cache

import numpy as np
import trimesh

from gfp_grasp.camera import SensorModel, apply_sensor, cloud_of, intrinsics, render_mesh_view, sample_viewpoint
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import INSIDE, OUTSIDE, Detection, GenericPrimitive, OrientedBox, SupportPlane, Symmetry

_SEGMENTS = 32
_LEVELS = 10


def cup_vertices(height: float, radius: float, taper: float, wall: float, floor: float) -> np.ndarray:
    """(v, 3) m of a revolved cup: foot, outside, rim, inside, floor."""
    t = np.linspace(0, 1, _LEVELS)
    outer = radius * (taper + (1 - taper) * t)
    z_in = floor + (height - floor) * t[::-1]
    inner = np.interp(z_in / height, t, outer) - wall
    profile = np.vstack(
        [
            [[outer[0] * 0.5, 0.0]],
            np.column_stack([outer, height * t]),
            np.column_stack([inner, z_in]),
            [[inner[-1] * 0.5, floor]],
        ]
    )
    angle = np.arange(_SEGMENTS) / _SEGMENTS * 2 * np.pi
    rings = [np.column_stack([r * np.cos(angle), r * np.sin(angle), np.full(_SEGMENTS, z)]) for r, z in profile]
    return np.vstack([[[0, 0, 0]], *rings, [[0, 0, floor]]])


def cup_faces() -> np.ndarray:
    """(f, 3) of every `cup_vertices`, outward."""
    rings = 2 * _LEVELS + 2
    last = rings * _SEGMENTS + 1
    faces = []
    for j in range(_SEGMENTS):
        k = (j + 1) % _SEGMENTS
        faces.append([0, 1 + k, 1 + j])
        for i in range(rings - 1):
            a, b = 1 + i * _SEGMENTS, 1 + (i + 1) * _SEGMENTS
            faces += [[a + j, a + k, b + j], [a + k, b + k, b + j]]
        a = 1 + (rings - 1) * _SEGMENTS
        faces.append([last, a + j, a + k])
    return np.array(faces)


def random_cup(rng: np.random.Generator) -> trimesh.Trimesh:
    """A member of the class."""
    return trimesh.Trimesh(_member(rng), cup_faces(), process=False)


@lru_cache(maxsize=1)
def toy_cup_primitive() -> GenericPrimitive:
    """Mean and five modes of 120 members."""
    rng = np.random.default_rng(0)
    members = np.array([_member(rng) for _ in range(120)])
    logs = np.log(np.ptp(members, axis=1))
    logs -= logs.mean(axis=0)
    shapes = members / np.exp(logs)[:, None]
    mean = shapes.mean(axis=0)
    centred = (shapes - mean).reshape(len(shapes), -1)
    _, values, vectors = np.linalg.svd(centred, full_matrices=False)
    deviation = values[:5] / math.sqrt(len(shapes))
    modes = (vectors[:5] * deviation[:, None]).reshape(5, -1, 3)
    regions = np.full(len(mean), OUTSIDE, dtype=np.uint8)
    regions[1 + (_LEVELS + 1) * _SEGMENTS :] = INSIDE
    return GenericPrimitive(
        category="cup",
        vertices=mean,
        faces=cup_faces(),
        modes=modes,
        explained=values[:5] ** 2 / (values**2).sum(),
        log_scale_cov=np.cov(logs.T),
        coefficient_samples=np.hstack([centred @ vectors[:5].T / deviation, logs]),
        symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), math.inf),
        up=np.array([0.0, 0.0, 1.0]),
        regions=regions,
    )


def see(
    mesh: trimesh.Trimesh,
    seed: int,
    *,
    sigma_m: float = 0.001,
    with_view: bool = False,
    T_world_object: np.ndarray | None = None,
) -> tuple[trimesh.Trimesh, Detection]:
    """The mesh where it stands, and a detection of it from a random side, the table known."""
    rng = np.random.default_rng(seed)
    height = float(rng.uniform(-0.2, 0.8))
    if T_world_object is None:
        T_world_object = make_T(rotation_about((0, 0, 1), rng.uniform(0, 6)), (0.1, -0.2, height))
    placed = mesh.copy()
    placed.apply_transform(T_world_object)
    K = intrinsics(320, 240, 35)
    camera = sample_viewpoint(rng, target=placed.bounds.mean(axis=0))
    image, index = render_mesh_view(
        [placed], T_world_camera=camera, K=K, width=320, height=240, table_height=T_world_object[2, 3]
    )
    image = apply_sensor(image, SensorModel.gaussian(sigma_m), rng)
    mask = (index == 0) & (image.depth_m > 0)
    detection = Detection(
        cloud=cloud_of(image, mask),
        up=np.array([0.0, 0.0, 1.0]),
        support=SupportPlane(np.array([0.0, 0.0, 1.0]), T_world_object[2, 3]),
        category="cup",
        scores={"cup": 1.0},
        box=OrientedBox(make_T(None, placed.bounds.mean(axis=0)), placed.extents),
        view=image if with_view else None,
        mask=mask if with_view else None,
        sensor_sigma_m=sigma_m,
    )
    return placed, detection


def _member(rng: np.random.Generator) -> np.ndarray:
    return cup_vertices(
        height=rng.uniform(0.06, 0.14),
        radius=rng.uniform(0.03, 0.055),
        taper=rng.uniform(0.65, 1.0),
        wall=rng.uniform(0.0015, 0.005),
        floor=rng.uniform(0.003, 0.01),
    )
