"""Objects, table and gripper put together into one MuJoCo scene."""

# MuJoCo's names come from compiled modules, into which the type checker does not see.
# pyright: reportAttributeAccessIssue=false

from collections.abc import Sequence
from pathlib import Path

import mujoco
import numpy as np
import trimesh

from gfp_grasp.assets import data_dir
from gfp_grasp.errors import InvalidScene
from gfp_grasp.export import CONTACT_PRIORITY, CONTACT_SOLREF, Body
from gfp_grasp.scenes.objects import SceneObject
from gfp_grasp.transforms import quat_wxyz
from gfp_grasp.types import ConvexPart

# Torsional friction is a length, the radius of a contact patch times 2/3 of the coefficient: 7 mm of a pad or a foot.
_TORSION_M, _ROLLING_M = 0.005, 0.0001
_SOLREF = (0.008, 1.0)  # stiff: twice the least that a step of 2 ms can follow
_SOLIMP = (0.95, 0.99, 0.001, 0.5, 2.0)  # 30 N sink a pad by 0.26 mm, MuJoCo's default by 0.43
# Below these MuJoCo finds no hull or no volume, and says so without naming the part.
_LEAST_VOLUME_M3, _LEAST_THICKNESS_M = 1e-11, 2e-5
# Room for hundreds of parts that touch table and gripper; the system gives only as much as is used.
_ARENA_BYTES = 2**27
_COLOURS = ("#4f7cac", "#c05746", "#6b9080", "#d9a441", "#7d5ba6", "#3d5a80", "#a26769", "#588157")


def build_scene(
    objects: Sequence[SceneObject], *, gripper: bool = False, table: bool = True, table_height: float = 0.0
) -> mujoco.MjSpec:
    """A scene from the templates in sim_scenes/.

    Each object is a body NAME with a free joint NAME_free (unless fixed), geoms NAME_part_000 and on (group 3, they
    collide) and NAME_visual (group 2, it is seen); without a visual mesh the parts are seen. Contacts with an object
    have the object's friction.

    Args:
        objects: What stands in it; one is put into the single template, more into the clutter one.
        gripper: Whether sim_scenes/gripper.xml is in it, parked 1.5 m above the table's plane.
        table: Whether there is a table; body and geom are named "table".
        table_height: z of its top, m.

    Raises:
        InvalidScene: Two objects of one name, or a part that is too small or too flat to collide.
    """
    spec = _template("single" if len(objects) < 2 else "clutter", table, gripper)
    spec.memory = _ARENA_BYTES
    if table:
        for thing in [spec.body("table"), *spec.cameras, *spec.sites]:
            if getattr(thing, "name", "") != "grip_center":
                thing.pos[2] += table_height
    if gripper:
        for name in ("gripper_mocap", "gripper"):
            spec.body(name).pos[2] += table_height
    taken = {body.name for body in spec.bodies}
    for number, thing in enumerate(objects):
        if thing.name in taken:
            raise InvalidScene(f"the name {thing.name!r} is taken in this scene: give each object its own")
        taken.add(thing.name)
        _add_object(spec, thing, _COLOURS[number % len(_COLOURS)])
    return spec


def add_body(spec: mujoco.MjSpec, body: Body, *, prefix: str = "", contact: bool = True) -> None:
    """Add a completed object to any scene, as `export` writes it: free, with its inertia, its mesh and its parts.

    Args:
        spec: The scene.
        body: What is added; its frame is placed in the scene's world.
        prefix: Goes before the names of body, joint, geoms and meshes.
        contact: Parts carry contact parameters with which it stands still at MuJoCo's default options.
    """
    T, name = body.T_world_body, prefix + body.name
    added = spec.worldbody.add_body(name=name, pos=T[:3, 3], quat=quat_wxyz(T[:3, :3]))
    added.add_freejoint(name=f"{name}_free")
    added.explicitinertial = True
    added.mass, added.ipos = body.weight.mass_kg, body.weight.centre
    inertia = body.weight.inertia
    added.fullinertia = [inertia[i, j] for i, j in ((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))]
    visual = f"{name}_visual"
    _add_mesh(spec, visual, body.mesh.vertices, body.mesh.faces)
    looks = {"contype": 0, "conaffinity": 0, "group": 2, "rgba": [0.55, 0.65, 0.8, 1.0]}
    added.add_geom(name=visual, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=visual, mass=0, **looks)
    how = {"solref": CONTACT_SOLREF, "priority": CONTACT_PRIORITY} if contact else {}
    for index, part in enumerate(body.parts):
        hull = f"{name}_hull_{index:03d}"
        _add_mesh(spec, hull, part.vertices, part.faces)
        added.add_geom(name=hull, type=mujoco.mjtGeom.mjGEOM_MESH, meshname=hull, group=3, mass=0, **how)


def compile_scene(spec: mujoco.MjSpec) -> mujoco.MjModel:
    """The compiled model.

    Raises:
        InvalidScene: MuJoCo refuses it; the message is MuJoCo's and names the element.
    """
    try:
        return spec.compile()
    except ValueError as error:
        raise InvalidScene(f"MuJoCo does not compile the scene: {error}") from error


def save_scene(spec: mujoco.MjSpec, path: str | Path) -> None:
    """Write a scene as one MJCF file that holds its meshes' numbers and opens in MuJoCo's viewer.

    Raises:
        InvalidScene: MuJoCo refuses the scene.
    """
    compile_scene(spec)
    Path(path).write_text(spec.to_xml(), encoding="utf-8")


def _template(name: str, table: bool, gripper: bool) -> mujoco.MjSpec:
    files = [name if table else "world"] + ["gripper"] * gripper
    includes = "".join(f'<include file="{file}.xml"/>' for file in files)
    # Every file is handed over by name: MuJoCo then needs no current folder, and a wheel may lie anywhere.
    texts = {path.name: path.read_bytes() for path in data_dir("sim_scenes").glob("*.xml")}
    return mujoco.MjSpec.from_string(f'<mujoco model="{name}">{includes}</mujoco>', include=texts)


def _add_object(spec: mujoco.MjSpec, thing: SceneObject, colour: str) -> None:
    T = thing.T_world_object
    body = spec.worldbody.add_body(name=thing.name, pos=T[:3, 3], quat=quat_wxyz(T[:3, :3]))
    _set_inertia(body, thing)
    if not thing.fixed:
        body.add_freejoint(name=f"{thing.name}_free")
    rgba = [*trimesh.visual.color.hex_to_rgba(colour)[:3] / 255.0, 1.0]
    shown = thing.visual is None
    for number, part in enumerate(thing.parts):
        name = f"{thing.name}_part_{number:03d}"
        _refuse_sliver(part, name)
        _add_mesh(spec, name, part.vertices, part.faces)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            group=2 if shown else 3,
            rgba=rgba,
            mass=0,
            condim=4,
            priority=1,  # else the larger of two frictions would rule, which is mostly the rubber's
            friction=[thing.friction, _TORSION_M, _ROLLING_M],
            solref=_SOLREF,
            solimp=_SOLIMP,
        )
    if thing.visual is not None:
        name = f"{thing.name}_visual"
        _add_mesh(spec, name, thing.visual.vertices, thing.visual.faces)
        body.add_geom(
            name=name,
            type=mujoco.mjtGeom.mjGEOM_MESH,
            meshname=name,
            group=2,
            rgba=rgba,
            mass=0,
            contype=0,
            conaffinity=0,
        )


def _add_mesh(spec: mujoco.MjSpec, name: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    mesh = spec.add_mesh(name=name, uservert=np.ravel(vertices), userface=np.ravel(faces))
    # The body has its own inertia; a shell's is found for any mesh, a volume's is refused for thin or open ones.
    mesh.inertia = mujoco.mjtMeshInertia.mjMESH_INERTIA_SHELL


def _set_inertia(body: mujoco.MjsBody, thing: SceneObject) -> None:
    """Mass spread evenly over the visual mesh if that is a volume, else over the parts."""
    solids = [thing.visual] if thing.visual is not None and thing.visual.is_volume else None
    solids = solids or [part.to_trimesh() for part in thing.parts]
    volumes = np.array([solid.volume for solid in solids])
    centres = np.array([solid.center_mass for solid in solids])
    centre = volumes @ centres / volumes.sum()
    density = thing.mass_kg / volumes.sum()
    tensor = np.zeros((3, 3))
    for solid, volume, at in zip(solids, volumes, centres, strict=True):
        offset = at - centre
        tensor += density * (solid.moment_inertia + volume * (offset @ offset * np.eye(3) - np.outer(offset, offset)))
    body.explicitinertial = True
    body.mass, body.ipos = thing.mass_kg, centre
    body.fullinertia = tensor[[0, 1, 2, 0, 0, 1], [0, 1, 2, 1, 2, 2]]


def _refuse_sliver(part: ConvexPart, name: str) -> None:
    spread = part.vertices - part.vertices.mean(axis=0)
    thickness = np.ptp(spread @ np.linalg.svd(spread, full_matrices=False)[2][-1]) if len(spread) > 3 else 0.0
    volume = part.to_trimesh().volume if len(part.faces) else 0.0
    if not (thickness > _LEAST_THICKNESS_M and volume > _LEAST_VOLUME_M3):
        raise InvalidScene(
            f"{name} is {thickness:.1e} m thin with {volume:.1e} m3: MuJoCo needs more than {_LEAST_THICKNESS_M} m and "
            f"{_LEAST_VOLUME_M3} m3. Leave such parts out"
        )
