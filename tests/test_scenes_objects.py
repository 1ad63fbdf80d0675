"""Objects of a scene: their parts, size, weight and friction, and where they stand by themselves."""

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
import trimesh
from scene_things import as_part, block, box, l_shape

from gfp_grasp.collision import hull
from gfp_grasp.errors import DecompositionFailed, InvalidMesh, InvalidScene
from gfp_grasp.primitives import PrimitiveLibrary, save_primitive
from gfp_grasp.scenes import SceneObject, load_objects, objects, true_object
from gfp_grasp.scenes import objects as scene_objects
from gfp_grasp.transforms import apply_T
from gfp_grasp.types import CategorySpec, CollisionMesh, ConvexPart


@pytest.mark.parametrize(("height_m", "lifted_m"), [(-0.03, 0.03), (0.05, 0.0)])
def test_parts_of_the_world_frame_are_lifted_out_of_the_table_and_not_put_down(height_m, lifted_m):
    (foot, post), _ = l_shape()
    shift = np.array([0.1, 0.2, height_m])
    thing = SceneObject.of_parts(
        tuple(ConvexPart(part.vertices + shift, part.faces) for part in (foot, post)), 0.2, 0.6
    )
    assert (thing.name, thing.mass_kg, thing.friction, thing.visual) == ("object", 0.2, 0.6, None)
    for part, before in zip(thing.parts, (foot, post), strict=True):
        stands = apply_T(thing.T_world_object, part.vertices)
        np.testing.assert_allclose(stands, before.vertices + shift + (0, 0, lifted_m), atol=1e-12)
    with pytest.raises(InvalidScene, match="no convex parts"):
        SceneObject.of_parts((), 0.2, 0.6)


def test_an_object_may_be_without_friction_and_not_below_it():
    assert block().friction == 0.5
    assert replace(block(), friction=0.0).friction == 0.0
    for wrong in ({"friction": -1e-9}, {"mass_kg": np.inf}, {"T_world_object": np.diag([1.0, 1, 1.001, 1])}):
        with pytest.raises(InvalidScene, match="block"):
            replace(block(), **wrong)


# True objects


class Told(np.random.Generator):
    """A generator that notes its ranges and gives a place in them."""

    def __init__(self, share):
        super().__init__(np.random.PCG64())
        self.share, self.asked = share, []

    def uniform(self, low, high):  # pyright: ignore[reportIncompatibleMethodOverride]
        self.asked.append((low, high))
        return low + self.share * (high - low)


def open_cylinder():
    outer, inner = trimesh.creation.cylinder(0.04, 0.1), trimesh.creation.cylinder(0.037, 0.1)
    inner.apply_translation((0, 0, 0.003))
    return trimesh.boolean.difference([outer, inner])


def test_an_open_vessel_weighs_as_its_walls_and_a_closed_one_as_filled():
    cup = open_cylinder()
    for mesh, densities in ((cup, (900.0, 2400.0)), (box((0.05, 0.06, 0.12)), (150.0, 1050.0))):
        for share in (0.0, 0.5, 1.0):
            rng = Told(share)
            thing = true_object(mesh, "x", "cup", rng, hull)
            assert rng.asked == [densities, (0.4, 1.0)]
            assert thing.mass_kg == pytest.approx(mesh.volume * (densities[0] + share * np.ptp(densities)))
            assert thing.friction == pytest.approx(0.4 + 0.6 * share)


@pytest.mark.parametrize(
    ("hollow", "is_open", "densities"),
    [
        (True, True, (10.0, 20.0)),
        (False, False, (10.0, 20.0)),
        (True, False, (150.0, 1050.0)),  # a cup with its lid on
        (False, True, (900.0, 2400.0)),  # a bottle cut open
    ],
)
def test_the_card_of_a_class_says_how_dense_its_members_are(hollow, is_open, densities):
    spec = CategorySpec("bowl", hollow=hollow, density_kg_m3=(10.0, 20.0))
    rng = Told(0.0)
    true_object(open_cylinder() if is_open else box((0.05, 0.06, 0.12)), "x", "bowl", rng, hull, spec=spec)
    assert rng.asked[0] == densities


def test_a_source_asks_the_library_that_it_is_given(tmp_path):
    """The shipped bottle at twice the density, in a folder of its own."""
    shipped = PrimitiveLibrary.shipped()
    low, high = shipped.spec("bottle").density_kg_m3
    heavy = replace(shipped.spec("bottle"), density_kg_m3=(2 * low, 2 * high))
    save_primitive(replace(shipped.primitive("bottle"), spec=heavy), tmp_path)
    box((0.05, 0.06, 0.12)).export(tmp_path / "bottle__square.ply")
    (source,) = load_objects(tmp_path / "bottle__square.ply")
    plain, doubled = (source.load(decompose=hull, library=library) for library in (None, PrimitiveLibrary(tmp_path)))
    assert doubled.mass_kg == pytest.approx(2 * plain.mass_kg)
    unknown = replace(source, category="teapot").load(decompose=hull)
    assert unknown.mass_kg == plain.mass_kg


def test_half_a_hull_of_material_is_a_filled_body_and_less_a_vessel():
    """A block with a well: it fills 0.49 or 0.51 of its hull."""
    for fill, low in ((0.49, 900.0), (0.51, 150.0)):
        well = box((0.04, 0.04, 0.1 * (1 - fill) / 0.64))
        well.apply_translation((0, 0, 0.05 - well.extents[2] / 2 + 1e-4))
        mesh = trimesh.boolean.difference([box((0.05, 0.05, 0.1)), well])
        rng = Told(0.0)
        true_object(mesh, "x", "", rng, hull)
        assert mesh.volume / mesh.convex_hull.volume == pytest.approx(fill, abs=2e-3)
        assert rng.asked[0][0] == low


def test_masses_stay_between_twenty_grams_and_a_kilogram():
    assert true_object(box((0.02, 0.02, 0.02)), "x", "", Told(0.0), hull).mass_kg == 0.02
    assert true_object(box((0.2, 0.2, 0.2)), "x", "", Told(1.0), hull).mass_kg == 1.0


@pytest.mark.parametrize(("length_m", "refused"), [(0.0099, True), (0.0101, False), (0.99, False), (1.01, True)])
def test_what_is_no_size_for_a_hand_is_refused(length_m, refused):
    mesh = box((length_m / 2, length_m / 3, length_m))
    if refused:
        with pytest.raises(InvalidMesh, match="scale it to metres"):
            objects.solid_mesh(mesh)
    else:
        assert objects.solid_mesh(SimpleNamespace(mesh=mesh)).is_volume


def test_an_object_is_put_on_the_ground_and_keeps_its_own_axis_if_that_passes_through_it():
    through = box((0.04, 0.06, 0.1), (0.015, -0.02, 0.3))
    np.testing.assert_allclose(objects.rested(through).bounds[0], (-0.005, -0.05, 0.0), atol=1e-12)
    for shift in ((0.5, 0, 0), (-0.5, 0, 0), (0, 0.5, 0), (0, -0.5, 0)):
        beside = box((0.04, 0.06, 0.1), np.add(shift, (0, 0, -0.7)))
        moved = objects.rested(beside)
        np.testing.assert_allclose(moved.bounds, [(-0.02, -0.03, 0.0), (0.02, 0.03, 0.1)], atol=1e-12)
        assert beside.bounds[0, 2] < -0.7
    ready = box((0.04, 0.06, 0.1), (0, 0, 0.05))
    assert objects.rested(ready) is ready


def test_plane_cuts_are_taken_where_they_are_true_enough_and_coacd_where_it_is_better(monkeypatch):
    part = as_part(box((0.05, 0.05, 0.05)))

    def found(mean, high, maker: Any = "cuts"):
        return CollisionMesh((part,), (mean, high, 2 * high), maker, 0.0)

    def choice(few, many, coacd):
        asked = []

        def cut(mesh, *, max_parts):
            asked.append(max_parts)
            return found(*(few if max_parts == 96 else many))

        def whole(mesh):
            asked.append("coacd")
            if coacd is None:
                raise DecompositionFailed("crashed")
            return found(*coacd, maker="coacd")

        monkeypatch.setattr("gfp_grasp.collision.decompose", whole)
        monkeypatch.setattr("gfp_grasp.collision.cut_parts", cut, raising=False)
        result = objects._decompose(box((0.05, 0.05, 0.05)))
        return result.made_by, result.error_m[0], asked

    good, worse, bad = (0.0004, 0.001), (0.0009, 0.003), (0.003, 0.01)
    assert choice(good, bad, bad) == ("cuts", 0.0004, [96])
    assert choice((0.0004, 0.0021), worse, bad) == ("cuts", 0.0009, [96, 256])
    assert choice((0.0006, 0.001), worse, bad) == ("cuts", 0.0009, [96, 256])
    assert choice((0.0012, 0.001), (0.0011, 0.003), (0.0008, 0.01)) == ("coacd", 0.0008, [96, 256, "coacd"])
    assert choice((0.0006, 0.001), (0.0007, 0.004), bad) == ("cuts", 0.0006, [96, 256, "coacd"])
    assert choice(bad, bad, None)[0] == "cuts"


def test_parts_are_kept_by_mesh_and_by_maker_and_few_at_a_time(monkeypatch):
    monkeypatch.setattr(scene_objects, "_memory", {})
    monkeypatch.setattr(scene_objects, "_KEPT", 2)
    monkeypatch.setenv("GFP_GRASP_CACHE", "off")
    calls = []

    def made(mesh):
        calls.append(mesh.extents[0])
        return hull(mesh)

    meshes = [box((0.05 + 0.01 * i, 0.05, 0.05)) for i in range(3)]
    first = scene_objects.decompose_cached(meshes[0], made, maker="a")
    assert scene_objects.decompose_cached(meshes[0].copy(), made, maker="a") is first
    scene_objects.decompose_cached(meshes[0], made, maker="b")
    assert len(calls) == 2
    scene_objects.decompose_cached(meshes[1], made, maker="a")
    assert len(scene_objects._memory) == 2
    scene_objects.decompose_cached(meshes[0], made, maker="a")  # the first was dropped
    assert len(calls) == 4


def test_a_mesh_has_the_hash_of_its_single_precision_bytes():
    mesh = box((0.05, 0.06, 0.07))
    assert scene_objects.mesh_sha256(mesh) == scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices.astype(np.float32), mesh.faces, process=False)
    )
    assert scene_objects.mesh_sha256(mesh) != scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices + 1e-6, mesh.faces, process=False)
    )
    assert scene_objects.mesh_sha256(mesh) != scene_objects.mesh_sha256(
        trimesh.Trimesh(mesh.vertices, mesh.faces[::-1], process=False)
    )
