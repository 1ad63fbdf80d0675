"""Making a closed solid of an open or multi-piece mesh."""

from __future__ import annotations

import numpy as np
import trimesh

from gfp_grasp.errors import InvalidMesh
from gfp_grasp.meshes.crossing import crossing_faces
from gfp_grasp.meshes.load import check_mesh


def make_solid(mesh: trimesh.Trimesh) -> tuple[trimesh.Trimesh, float]:
    raise InvalidMesh("not yet")
