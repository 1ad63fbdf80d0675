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
from gfp_grasp.meshes.net import surface_net
from gfp_grasp.meshes.solid import Repair, make_solid, repair_mesh
from gfp_grasp.meshes.surface import (
    crossing_faces,
    enclosed_m3,
    graph_laplacian,
    neighbour_average,
    pairs_on_the_way,
    sample_surface,
    triangle_normals,
    vertex_normals,
)

__all__ = [
    "LARGEST_BYTES",
    "READER_ERRORS",
    "SUFFIXES",
    "Repair",
    "check_mesh",
    "crossing_faces",
    "enclosed_m3",
    "every_suffix",
    "graph_laplacian",
    "load_mesh",
    "make_solid",
    "neighbour_average",
    "pairs_on_the_way",
    "read_content",
    "repair_mesh",
    "sample_surface",
    "surface_net",
    "triangle_normals",
    "vertex_normals",
]
