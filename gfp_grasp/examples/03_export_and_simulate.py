"""3. Export a completion for MuJoCo and let it fall onto a floor.

`python -m gfp_grasp.examples.03_export_and_simulate`
"""

# MuJoCo's names come from compiled modules, into which a type checker does not see.
# pyright: reportAttributeAccessIssue=false

import mujoco

from gfp_grasp import complete_to_mesh
from gfp_grasp.captures import read_capture
from gfp_grasp.collision import CollisionConfig

if __name__ == "__main__":
    capture = read_capture("sample")
    completion = complete_to_mesh(capture.points, viewpoint=capture.viewpoint)
    parts = completion.collide(CollisionConfig(max_parts=24, max_vertices_per_part=32))
    print(
        f"{len(parts.parts)} convex parts by {parts.made_by}, {1000 * parts.error_m[0]:.1f} mm off the mesh on average"
    )

    path = completion.export("object.xml")  # MJCF with its meshes inside, a body with a free joint, and a floor
    model = mujoco.MjModel.from_xml_path(str(path))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    start = data.xipos[1].copy()
    while data.time < 2.0:
        mujoco.mj_step(model, data)
    fell_mm = 1000 * (start - data.xipos[1])[2]
    print(f"after {data.time:.0f} s its centre of mass is {fell_mm:.1f} mm lower, speed {abs(data.qvel).max():.4f}")
