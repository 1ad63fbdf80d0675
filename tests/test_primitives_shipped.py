"""The primitives that ship with the package."""

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.errors import UnknownCategory
from gfp_grasp.meshes import crossing_faces, load_mesh
from gfp_grasp.primitives import fit_whole_surface, list_primitives, load_kinds, load_primitive
from gfp_grasp.shapes import make_shape, split_seeds
from gfp_grasp.types import HANDLE

SHIPPED = ("bottle", "bottle.jug", "bottle.spray", "cup", "cup.lidded", "cup.stemmed", "mug")


def test_unknown_primitive_is_refused_with_those_on_offer():
    with pytest.raises(UnknownCategory, match="bottle, cup, mug"):
        load_primitive("spaceship")


def test_classes_are_listed_without_their_kinds():
    assert list_primitives() == ("bottle", "cup", "mug")
    assert [primitive.name for primitive in load_kinds("cup")] == ["cup", "cup.lidded", "cup.stemmed"]
    assert [primitive.name for primitive in load_kinds("mug")] == ["mug"]


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_primitive_is_clean(name):
    primitive = load_primitive(name)
    assert primitive is load_primitive(name)
    assert primitive.name == name
    assert primitive in load_kinds(primitive.category)
    bodies = [primitive] + ([primitive.twin] if primitive.twin else [])
    for body in bodies:
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_volume
        assert not len(crossing_faces(mesh.vertices, mesh.faces))
        assert all(part.to_trimesh().is_volume for part in body.parts)
    assert primitive.vertices[:, 2].min() == 0.0
    assert len(primitive.vertices) <= 1500
    assert primitive.explained.sum() > 0.95
    assert len(primitive.coefficient_samples) >= (40 if primitive.subcategory else 80)
    assert primitive.parts
    assert (primitive.twin is not None) == (name in ("mug", "bottle.jug"))
    if primitive.twin is not None and primitive.twin_map is not None:
        assert (primitive.regions[primitive.twin_map] != HANDLE).all()
        np.testing.assert_array_equal(primitive.vertices[primitive.twin_map], primitive.twin.vertices)
        np.testing.assert_array_equal(primitive.modes[:, primitive.twin_map], primitive.twin.modes)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_primitive_generalizes_as_its_card_says(name):
    primitive = load_primitive(name)
    assert float(str(primitive.card["generalization_mm"])) <= 1.5
    shapes = (make_shape(primitive.category, seed) for seed in split_seeds(primitive.category, "val"))
    member = next(shape for shape in shapes if primitive.subcategory in ("", shape.kind)).mesh
    assert fit_whole_surface(primitive, member)[1] < 0.0015


@pytest.mark.slow
@pytest.mark.parametrize("category", ["bottle", "cup", "mug"])
def test_shipped_primitive_fits_every_real_scan_of_its_class(category):
    paths = sorted((real_data.folder() / "meshes").glob(f"{category}__*.ply"))
    assert paths
    errors = {path.name: fit_whole_surface(load_primitive(category), load_mesh(path))[1] for path in paths}
    assert max(errors.values()) < 0.002, errors
