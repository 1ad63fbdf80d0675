"""Boxes, a block and a bent body as things of a scene."""

import trimesh

from gfp_grasp.scenes import SceneObject
from gfp_grasp.transforms import make_T, rotation_about
from gfp_grasp.types import ConvexPart

TILTED = make_T(rotation_about((1, -2, 0.5), 0.8), (0.1, -0.05, 0.4))


def as_part(mesh):
    """A convex mesh as a part."""
    return ConvexPart(mesh.vertices, mesh.faces)


def box(extents, at=(0, 0, 0)):
    """A box about a place."""
    mesh = trimesh.creation.box(extents)
    mesh.apply_translation(at)
    return mesh


def l_shape():
    """A foot of 60 by 20 by 10 mm with a post of 10 by 20 by 80 mm at one end, as two parts and as one solid."""
    foot, post = box((0.06, 0.02, 0.01), (0.03, 0.01, 0.005)), box((0.01, 0.02, 0.08), (0.005, 0.01, 0.05))
    return (as_part(foot), as_part(post)), trimesh.boolean.union([foot, post])


def block(name="block", extents=(0.04, 0.06, 0.1), at=(0.0, 0.0), mass_kg=0.3, **knobs):
    """A box that stands at a place (x, y), alike on its picture and in its one part."""
    mesh = box(extents, (0, 0, extents[2] / 2))
    T = make_T(t=(*at, 0))
    return SceneObject(name, (as_part(mesh),), mesh, T, mass_kg, 0.5, **knobs)
