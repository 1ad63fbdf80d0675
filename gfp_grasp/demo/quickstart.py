"""Makes the files that ship for the quick start: `python -m gfp_grasp.demo.quickstart` (or `make quickstart`).

sim_scenes/quickstart.npz is a capture of a procedural mug of the test split, rendered and put through the model of
a RealSense; sim_scenes/demo_parts.npz holds the convex parts of the demonstration's objects.
"""

import numpy as np
import trimesh

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import SAMPLE_FILE
from gfp_grasp.demo.demo_scene import CLUTTER, FILE, SINGLE, pick_objects, write_parts
from gfp_grasp.demo.jobs import EYES, set_stage, take_picture
from gfp_grasp.transforms import apply_T, invert_T

SEED = 0


def main() -> None:
    """Write both files."""
    folder = data_dir("sim_scenes")
    sources = (*pick_objects(CLUTTER), *pick_objects(SINGLE))
    write_parts([source.load() for source in sources], folder / FILE)
    rng = np.random.default_rng(SEED)
    stage, (truth,) = set_stage(sources[-1:], rng)
    image, geom = take_picture(stage, EYES["single"], rng)
    mesh = trimesh.Trimesh(apply_T(stage.pose(truth.name), truth.mesh.vertices), truth.mesh.faces, process=False)
    np.savez_compressed(
        folder / SAMPLE_FILE,
        depth_m=image.depth_m,
        K=image.K,
        T_world_camera=image.T_world_camera,
        mask=stage.geoms(truth.name)[geom] & (geom >= 0),
        mesh_vertices_cam=apply_T(invert_T(image.T_world_camera), mesh.vertices).astype(np.float32),
        mesh_faces=mesh.faces.astype(np.int32),
    )


if __name__ == "__main__":
    main()
