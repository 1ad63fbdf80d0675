"""Makes the files that ship for the quick start: `python -m gfp_grasp.demo.quickstart` (or `make quickstart`).

sim_scenes/quickstart.npz is a capture of a procedural mug of the test split, rendered and put through the model of
a RealSense; sim_scenes/demo_parts.npz holds the convex parts of the demonstration's objects; sim_scenes/street.npz is
one turn of an HDL-64 in a street of the test split, with the boxes and classes of what it saw.
"""

from pathlib import Path

import numpy as np
import trimesh

from gfp_grasp.assets import data_dir
from gfp_grasp.captures import SAMPLE_FILE, STREET_FILE
from gfp_grasp.demo.demo_scene import CLUTTER, FILE, SINGLE, pick_objects, write_parts
from gfp_grasp.demo.jobs import EYES, set_stage, take_picture
from gfp_grasp.scenes import draw_street, scan_street
from gfp_grasp.transforms import apply_T, invert_T

SEED = 0
_STREET_SEED, _NUM_THINGS = 67, 18  # eight classes, most of them in plain view
_STEPS_A_M = 256  # 4 mm, a fifth of the sensor's noise: the file is half as large as with all digits


def main() -> None:
    """Write the three files."""
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
    write_street(folder / STREET_FILE)


def write_street(path: Path) -> None:
    """Write a scan of a street as `gfp_grasp.datasets.read_scans` reads it, in the sensor's frame, z up, m."""
    rng = np.random.default_rng(_STREET_SEED)
    street = draw_street(rng, num_things=_NUM_THINGS, split="test")
    scan, number = scan_street(street, rng)
    points = apply_T(invert_T(scan.T_world_sensor), scan.points()[scan.range_m > 0])
    seen = [street.things[i] for i in np.unique(number[number >= 0])]
    poses = [invert_T(scan.T_world_sensor) @ thing.box.T_world_box for thing in seen]
    boxes = [
        (*T[:3, 3], *thing.box.extents, np.arctan2(T[1, 0], T[0, 0])) for T, thing in zip(poses, seen, strict=True)
    ]
    np.savez_compressed(
        path,
        points=(np.round(points * _STEPS_A_M) / _STEPS_A_M).astype(np.float32),
        boxes=np.array(boxes, dtype=np.float32),
        classes=np.array([thing.category for thing in seen]),
    )


if __name__ == "__main__":
    main()
