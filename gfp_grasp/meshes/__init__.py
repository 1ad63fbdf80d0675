"""Triangle meshes: reading and checking them, sampling, crossings, and making solids of broken ones."""

from gfp_grasp.meshes.load import (
    LARGEST_BYTES,
    READER_ERRORS,
    SUFFIXES,
    check_mesh,
    every_suffix,
    load_mesh,
    read_content,
)
from gfp_grasp.meshes.solid import make_solid
from gfp_grasp.meshes.surface import (
    crossing_faces,
    graph_laplacian,
    neighbour_average,
    sample_surface,
    triangle_normals,
    vertex_normals,
)

__all__ = [
    "LARGEST_BYTES",
    "READER_ERRORS",
    "SUFFIXES",
    "check_mesh",
    "crossing_faces",
    "every_suffix",
    "graph_laplacian",
    "load_mesh",
    "make_solid",
    "neighbour_average",
    "read_content",
    "sample_surface",
    "triangle_normals",
    "vertex_normals",
]
