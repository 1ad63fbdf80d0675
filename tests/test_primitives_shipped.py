"""The primitives that ship with the package."""

import numpy as np
import pytest
import real_data
import trimesh

from gfp_grasp.meshes import crossing_faces, load_mesh
from gfp_grasp.primitives import PrimitiveLibrary, fit_full_surface
from gfp_grasp.shapes import make_shape, split_seeds

LIBRARY = PrimitiveLibrary.shipped()
SHIPPED = ("bottle", "bottle.jug", "bottle.spray", "cup", "cup.lidded", "cup.stemmed", "mug")


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_primitive_is_clean(name):
    primitive = LIBRARY.primitive(name)
    assert primitive is LIBRARY.primitive(name)
    assert primitive.name == name
    assert primitive in LIBRARY.members_of(primitive.category)
    bodies = [primitive] + ([variant.primitive for variant in primitive.variants])
    for body in bodies:
        mesh = trimesh.Trimesh(body.vertices, body.faces, process=False)
        assert mesh.is_volume
        assert not len(crossing_faces(mesh.vertices, mesh.faces))
        assert all(part.to_trimesh().is_volume for part in body.parts)
    assert primitive.vertices[:, 2].min() == 0.0
    assert len(primitive.vertices) <= 1500
    assert primitive.explained.sum() > 0.945
    assert len(primitive.coefficient_samples) >= (40 if primitive.subcategory else 80)
    assert primitive.parts
    assert [variant.without for variant in primitive.variants] == (
        [("handle",)] if name in ("mug", "bottle.jug") else []
    )
    for variant in primitive.variants:
        assert primitive.without(["handle"]) is variant.primitive
        assert not primitive.on_region("handle")[variant.vertex_map].any()
        assert not variant.primitive.on_part.any()
        assert variant.primitive.spec == primitive.spec
        np.testing.assert_array_equal(primitive.vertices[variant.vertex_map], variant.primitive.vertices)
        np.testing.assert_array_equal(primitive.modes[:, variant.vertex_map], variant.primitive.modes)


@pytest.mark.parametrize("name", SHIPPED)
def test_shipped_primitive_generalizes_as_its_card_says(name):
    primitive = LIBRARY.primitive(name)
    assert float(str(primitive.card["generalization_mm"])) <= 1.5
    shapes = (make_shape(primitive.category, seed) for seed in split_seeds(primitive.category, "val"))
    member = next(shape for shape in shapes if primitive.subcategory in ("", shape.kind)).mesh
    assert fit_full_surface(primitive, member)[1] < 0.0015


@pytest.mark.slow
@pytest.mark.parametrize("category", ["bottle", "cup", "mug"])
def test_shipped_primitive_fits_every_real_scan_of_its_class(category):
    paths = sorted((real_data.folder() / "meshes").glob(f"{category}__*.ply"))
    assert paths
    errors = {path.name: fit_full_surface(LIBRARY.primitive(category), load_mesh(path))[1] for path in paths}
    assert max(errors.values()) < 0.002, errors
