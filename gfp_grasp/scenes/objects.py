"""Objects as a scene takes them: a mesh that is seen, convex parts that collide, a pose, a mass and a friction.

Parts of true objects are kept in memory, and on disk where `collision.store` keeps those of `decompose`.
"""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass

import numpy as np
import trimesh

from gfp_grasp.collision import key_of, read_parts, write_parts
from gfp_grasp.errors import DecompositionFailed, InvalidMesh, InvalidScene
from gfp_grasp.meshes import check_mesh, make_solid
from gfp_grasp.transforms import make_T
from gfp_grasp.types import CategorySpec, CollisionMesh, ConvexPart, TrueObject, default_density

TARGET = "object"  # the name of the object that a trial grasps, unless it is told another


@dataclass(frozen=True, eq=False)
class SceneObject:
    """One object of a scene.

    Attributes:
        name: Name of its body in the simulator; unique in the scene.
        parts: Convex parts that collide, in the object's frame, m.
        visual: What cameras see and what gives the inertia, watertight, in the object's frame; None shows the parts.
        T_world_object: (4, 4) pose at the start.
        mass_kg: Mass.
        friction: Sliding friction coefficient of its contacts, whatever touches it.
        fixed: Stuck to the world.
    """

    name: str
    parts: tuple[ConvexPart, ...]
    visual: trimesh.Trimesh | None
    T_world_object: np.ndarray
    mass_kg: float
    friction: float
    fixed: bool = False

    def __post_init__(self) -> None:
        T = np.array(self.T_world_object, dtype=np.float64)
        if (
            T.shape != (4, 4)
            or not np.isfinite(T).all()
            or not np.allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-6)
        ):
            raise InvalidScene(f"{self.name}: T_world_object must be a finite rigid (4, 4) transform, got\n{T}")
        if not self.parts:
            raise InvalidScene(f"{self.name} has no convex parts: it would fall through the table")
        if not (0 < self.mass_kg < np.inf and 0 <= self.friction < np.inf):
            raise InvalidScene(
                f"{self.name}: mass {self.mass_kg} kg must be positive, friction {self.friction} not negative"
            )
        T.setflags(write=False)
        object.__setattr__(self, "T_world_object", T)

    @classmethod
    def of(cls, truth: TrueObject, T_world_object: np.ndarray, *, name: str | None = None) -> SceneObject:
        """A true object at a pose, under its own name or another."""
        return cls(name or truth.name, truth.collision.parts, truth.mesh, T_world_object, truth.mass_kg, truth.friction)

    @classmethod
    def of_parts(
        cls, parts: tuple[ConvexPart, ...], mass_kg: float, friction: float, *, name: str = TARGET
    ) -> SceneObject:
        """Convex parts in the world frame, lifted out of the table where they reach below z = 0.

        Raises:
            InvalidScene: There are no parts.
        """
        if not parts:
            raise InvalidScene(f"{name} has no convex parts: it would fall through the table")
        points = np.concatenate([part.vertices for part in parts])
        centre = points.mean(axis=0)
        local = tuple(ConvexPart(part.vertices - centre, part.faces) for part in parts)
        sunk = min(0.0, float(points[:, 2].min()))
        return cls(name, local, None, make_T(t=centre - (0.0, 0.0, sunk)), mass_kg, friction)


_KEPT = 256  # at 0.2 MB
_memory: dict[str, CollisionMesh] = {}


def mesh_sha256(mesh: trimesh.Trimesh) -> str:
    """Hash of the vertices as little-endian float32 and the faces as int32: a mesh read twice has one hash anywhere."""
    digest = hashlib.sha256(np.asarray(mesh.vertices, dtype="<f4").tobytes())
    digest.update(np.asarray(mesh.faces, dtype="<i4").tobytes())
    return digest.hexdigest()


def decompose_cached(
    mesh: trimesh.Trimesh, decompose: Callable[[trimesh.Trimesh], CollisionMesh], *, maker: str
) -> CollisionMesh:
    """What decompose(mesh) gives, computed once a mesh.

    Args:
        mesh: Passed on to `decompose`.
        decompose: The work.
        maker: Says what `decompose` is and with which options; results of different makers are kept apart.
    """
    key = key_of(f"{maker}/{mesh_sha256(mesh)}")
    if key not in _memory:
        found = read_parts(key)
        if found is None:
            found = decompose(mesh)
            write_parts(key, found)
        if len(_memory) >= _KEPT:
            _memory.pop(next(iter(_memory)))
        _memory[key] = found
    return _memory[key]


Decompose = Callable[[trimesh.Trimesh], CollisionMesh]

# Longest side of what one hand grasps off a table; beyond it a file is in millimetres or inches, or has no unit at all.
LEAST_M, LARGEST_M = 0.01, 1.0
# A mesh that fills less of its hull than this is an open vessel, whose walls weigh; what fills more may have contents.
_VESSEL_FILL = 0.5
_MASS_KG = (0.02, 1.0)
# Mean and 95 % error that end the search. What CoACD's default threshold leaves on thin cups and mugs is 0.4 to 0.9 mm
# and 1.3 to 3.0 mm; few parts must do better, for more of them cost 2 s where CoACD takes half a minute.
_FEW_PARTS, _FEW_ERROR_M = 96, (0.0005, 0.002)
_MANY_PARTS, _MANY_ERROR_M = 256, (0.001, 0.0035)
_FRICTION = (0.4, 1.0)  # rubber on wet plastic to rubber on dry stoneware


def true_object(
    mesh_or_shape: object,
    name: str,
    category: str,
    rng: np.random.Generator,
    decompose: Decompose | None = None,
    *,
    spec: CategorySpec | None = None,
) -> TrueObject:
    """What the simulator holds for a mesh.

    Args:
        mesh_or_shape: A trimesh.Trimesh, or anything with one as `.mesh`; m, z up; open meshes are closed.
        name: Name of the mesh in its data set, never a path.
        category: Class, or "" where it is unknown.
        rng: Draws mass and friction.
        decompose: Gives the convex parts; None cuts by planes (collision.cut_parts) into up to 96 parts, where that
            leaves more than 0.5 mm mean error into up to 256, and where that leaves more than 1 mm runs
            collision.decompose; results are kept on disk by mesh.
        spec: What is known of the class. Its density is that of an open member of a hollow class and of a closed
            member of another class. Anything else, as a cup with a lid, has the density that things of its kind have.

    Returns:
        The object in its own frame: base at z = 0, the middle of its bounding box at x = y = 0 unless its own axis,
        x = y = 0, already passes through it.

    Raises:
        InvalidMesh: No solid can be made of the mesh, or its longest side is not within 1 cm and 1 m.
        DecompositionFailed: The mesh is all crumbs.
    """
    mesh = rested(solid_mesh(mesh_or_shape))
    fill = mesh.volume / mesh.convex_hull.volume
    density = rng.uniform(*_density_range(spec, hollow=fill < _VESSEL_FILL))
    mass_kg = float(np.clip(mesh.volume * density, *_MASS_KG))
    friction = float(rng.uniform(*_FRICTION))
    collision = _decompose_cached(mesh) if decompose is None else decompose(mesh)
    return TrueObject(name, category, mesh, collision, mass_kg, friction)


def _density_range(spec: CategorySpec | None, *, hollow: bool) -> tuple[float, float]:
    """Lowest and highest density, kg/m3, of an object that is hollow or not."""
    return spec.density_kg_m3 if spec is not None and spec.hollow == hollow else default_density(hollow=hollow)


def solid_mesh(mesh_or_shape: object, *, largest_m: float = LARGEST_M) -> trimesh.Trimesh:
    """A watertight mesh; the very same one where it already is a volume.

    Args:
        mesh_or_shape: A mesh, m, or a shape.
        largest_m: Its longest side is at most as long.

    Raises:
        InvalidMesh: It cannot be closed, is none, or its longest side is shorter than 1 cm or too long.
    """
    mesh = check_mesh(getattr(mesh_or_shape, "mesh", mesh_or_shape))  # pyright: ignore[reportArgumentType]
    longest_m = float(np.max(mesh.extents))
    if not LEAST_M <= longest_m <= largest_m:
        raise InvalidMesh(
            f"the mesh is {longest_m:.3g} m long, {LEAST_M} to {largest_m} m are expected: scale it to metres, "
            "by 0.001 if its file is in millimetres"
        )
    return mesh if mesh.is_volume else make_solid(mesh)[0]


def rested(mesh: trimesh.Trimesh) -> trimesh.Trimesh:
    """The mesh on z = 0; moved sideways only if its own axis does not pass through it."""
    low, high = np.asarray(mesh.bounds)
    off_axis = (low[:2] > 0).any() or (high[:2] < 0).any()
    middle = (low + high)[:2] / 2 if off_axis else np.zeros(2)
    shift = -np.array([*middle, low[2]])
    if not np.abs(shift).max() > 1e-9:
        return mesh
    moved = mesh.copy()
    moved.apply_translation(shift)
    return moved


def _decompose_cached(mesh: trimesh.Trimesh) -> CollisionMesh:
    return decompose_cached(
        mesh, _decompose, maker=f"cuts {_FEW_PARTS} {_FEW_ERROR_M}, {_MANY_PARTS} {_MANY_ERROR_M}, or coacd"
    )


def _decompose(mesh: trimesh.Trimesh) -> CollisionMesh:
    """Plane cuts where they are as true to the mesh as CoACD mostly is: they take a twentieth of its time."""
    from gfp_grasp.collision import cut_parts, decompose

    cuts = []
    for max_parts, limit_m in ((_FEW_PARTS, _FEW_ERROR_M), (_MANY_PARTS, _MANY_ERROR_M)):
        cuts.append(cut_parts(mesh, max_parts=max_parts))
        if cuts[-1].error_m[0] <= limit_m[0] and cuts[-1].error_m[1] <= limit_m[1]:
            return cuts[-1]
    with suppress(DecompositionFailed):
        cuts.append(decompose(mesh))
    return min(cuts, key=lambda collision: collision.error_m[0])
