"""6. Add a class: a folder of meshes becomes a primitive, and the library knows one class more. Nothing is trained.

`python -m gfp_grasp.examples.06_add_a_class [NUM_MESHES]`; it makes its own folder, of urns.
"""

import sys
from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp import complete_to_mesh
from gfp_grasp.camera import cloud_of, intrinsics, render_mesh_view
from gfp_grasp.complete import CompleteConfig
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.train import build_from_folder
from gfp_grasp.transforms import look_at


def urn(rng: np.random.Generator) -> trimesh.Trimesh:
    """An urn that stands on z = 0: a belly, a neck, and a wall of 4 mm."""
    height, belly, neck = rng.uniform(0.14, 0.2), rng.uniform(0.03, 0.04), rng.uniform(0.014, 0.02)
    z = np.linspace(0.0, 1.0, 24)
    radius = neck + (belly - neck) * np.exp(-(((z - 0.35) / 0.3) ** 2))
    outer = np.column_stack([radius, z * height])
    inner = np.column_stack([radius - 0.004, 0.004 + z * (height - 0.004)])
    profile = np.concatenate([[[0.0, 0.0]], outer, inner[::-1], [[0.0, 0.004]]])
    return trimesh.creation.revolve(profile, sections=48)


if __name__ == "__main__":
    folder, cards, rng = Path("urns"), Path("my_gps"), np.random.default_rng(0)
    folder.mkdir(exist_ok=True)
    for number in range(int(sys.argv[1]) if len(sys.argv) > 1 else 12):
        urn(rng).export(folder / f"urn_{number}.off")

    # On the command line: gfp-grasp gps build urn --meshes urns --out my_gps
    cards.mkdir(exist_ok=True)
    save_primitive(build_from_folder(folder, "urn"), cards)
    library = PrimitiveLibrary.with_shipped(cards)
    print("classes:", ", ".join(library.categories))

    unseen = urn(rng)
    camera = look_at((0.45, -0.35, 0.35), (0.0, 0.0, 0.08))
    K = intrinsics(320, 240, 35.0)
    view, index = render_mesh_view([unseen], T_world_camera=camera, K=K, width=320, height=240, table_height=0.0)
    cloud = cloud_of(view, index == 0)
    # On the command line: gfp-grasp complete FILE --gps my_gps -o urn.glb
    completion = complete_to_mesh(cloud.points, viewpoint=cloud.viewpoint, config=CompleteConfig(library=library))
    print(f"completed as {completion.category}, watertight: {completion.mesh.is_watertight}")
    print(f"wrote {completion.export('urn.glb')}")
