"""1. Complete a cloud: points of one object in, its whole shape out.

`python -m gfp_grasp.examples.01_complete_a_cloud [FILE]`; without a file it completes the sample that ships.
"""

import sys

from gfp_grasp import complete_to_mesh
from gfp_grasp.captures import read_capture

if __name__ == "__main__":
    capture = read_capture(sys.argv[1] if len(sys.argv) > 1 else "sample")
    completion = complete_to_mesh(capture.points, viewpoint=capture.viewpoint)  # (n, 3) m, z is up

    print(f"class {completion.category}, {completion.scores.get(completion.category, 1.0):.0%} sure")
    print(f"watertight: {completion.mesh.is_watertight}, size {completion.mesh.extents.round(3)} m")
    print(f"{completion.observed.mean():.0%} of the vertices were seen; the others are guessed")
    print(f"standard deviation of a vertex: {1000 * completion.sigma_m.mean():.1f} mm on average")
    print(f"wrote {completion.export('completed.glb')}")
