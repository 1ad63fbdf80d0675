"""All procedural families: sound, metric, upright, the same for their seed; cups, mugs and bottles in more detail."""

import time
from itertools import combinations

import numpy as np
import pytest
import trimesh

from gfp_grasp.errors import InvalidOption, UnknownCategory
from gfp_grasp.meshes import crossing_faces, sample_surface
from gfp_grasp.shapes import FAMILIES, HOUSEHOLD, SPLITS, TRAFFIC, Family, Shape, get_family, make_shape, split_seeds
from gfp_grasp.shapes.family import Made, draw_kind
from gfp_grasp.types import CategorySpec

HEIGHTS_M = {"cup": (0.045, 0.21), "mug": (0.065, 0.135), "bottle": (0.055, 0.37)}
SEEDS = tuple(range(24))
LONGEST_M = {"household": (0.03, 0.55), "traffic": (0.3, 18.0)}
FEW = range(4)


@pytest.fixture(scope="module")
def shapes():
    return {family: [make_shape(family, seed) for seed in SEEDS] for family in HEIGHTS_M}


def _assert_sound(shape: Shape) -> None:
    mesh = shape.mesh
    assert mesh.is_volume, shape.name
    assert mesh.body_count == 1, shape.name
    assert len(crossing_faces(mesh.vertices, mesh.faces)) == 0, shape.name


@pytest.mark.parametrize("family", FAMILIES)
def test_every_shape_is_one_closed_volume_of_the_size_of_its_group_on_the_ground(family):
    for shape in (make_shape(family, seed) for seed in FEW):
        _assert_sound(shape)
        low, high = LONGEST_M[get_family(family).group]
        assert low < shape.mesh.extents.max() < high, shape.name
        assert shape.mesh.bounds[0, 2] == pytest.approx(0.0, abs=1e-9), shape.name
        assert np.abs(shape.mesh.bounds[:, :2].mean(axis=0)).max() < 0.4 * shape.mesh.extents.max(), shape.name


@pytest.mark.parametrize("family", FAMILIES)
def test_the_same_seed_gives_the_same_shape_and_others_differ(family):
    shapes = [make_shape(family, seed) for seed in FEW]
    np.testing.assert_array_equal(make_shape(family, 2).mesh.vertices, shapes[2].mesh.vertices)
    extents = np.array([shape.mesh.extents for shape in shapes])
    assert min(np.abs(a - b).max() for a, b in combinations(extents, 2)) > 1e-5


@pytest.mark.parametrize("family", FAMILIES)
def test_a_family_says_of_its_class_what_a_card_can_hold(family):
    known = get_family(family)
    for name in known.names:
        parent = family if "." in name else None
        spec = CategorySpec.from_dict({"category": name, "parent": parent, **known.spec_of(name)})
        assert set(spec.alike) <= set(FAMILIES) - {family}
        assert "upright" in spec.rests
    assert {name for names in known.also.values() for name in names} <= set(FAMILIES) - {family}


@pytest.mark.parametrize("family", HEIGHTS_M)
def test_cups_mugs_and_bottles_stand_upright_at_the_origin(family, shapes):
    low, high = HEIGHTS_M[family]
    for shape in shapes[family]:
        assert low < shape.mesh.bounds[1, 2] < high, shape.name
        assert shape.mesh.extents[:2].max() < 0.19, shape.name
        standing = shape.mesh.vertices[shape.mesh.vertices[:, 2] < 0.003]
        middle = (standing.min(axis=0) + standing.max(axis=0)) / 2
        np.testing.assert_allclose(middle[:2], 0.0, atol=0.001, err_msg=shape.name)
    extents = np.array([shape.mesh.extents for shape in shapes[family]])
    assert extents[:, 2].std() > 0.1 * extents[:, 2].mean()


def test_a_mug_has_its_handle_towards_plus_x(shapes):
    for shape in shapes["mug"]:
        (left, _, _), (right, _, _) = shape.mesh.bounds
        assert shape.has_handle
        assert right + left > 0.015, shape.name
        handle = shape.mesh.vertices[shape.mesh.vertices[:, 0] > -left + 0.008]
        assert np.abs(handle[:, 1]).max() < 0.02, shape.name


@pytest.mark.parametrize("family", ["cup", "mug"])
def test_walls_are_as_thick_as_they_say_and_between_1_and_6_mm(family, shapes):
    for shape in shapes[family]:
        if shape.wall_m == 0:
            continue
        assert 0.001 <= shape.wall_m <= 0.006, shape.name
        thickness = _thickness(shape.mesh)
        assert np.median(thickness) == pytest.approx(shape.wall_m, rel=0.15), shape.name
        assert np.quantile(thickness, 0.02) > 0.0008, shape.name


def test_a_mug_is_empty_inside(shapes):
    for shape in shapes["mug"]:
        axis = np.zeros((20, 3))
        axis[:, 2] = np.linspace(0.35, 0.99, 20) * shape.mesh.bounds[1, 2]
        around = np.linspace(0, 2 * np.pi, 16, endpoint=False)
        directions = np.stack([np.cos(around), np.sin(around), 0 * around], axis=1)
        # From the axis outward, the first thing met is the inner wall, on the handle's side as on the others.
        for height in axis[5:15]:
            hits, ray, _ = shape.mesh.ray.intersects_location(
                np.repeat(height[None], 16, axis=0), directions, multiple_hits=False
            )
            reach = np.linalg.norm(hits - height, axis=1)[np.argsort(ray)]
            assert len(reach) == 16, shape.name
            assert abs(reach[0] - reach[8]) < 0.001, shape.name
        assert not shape.mesh.contains(axis).any(), shape.name


def test_all_variants_come_up_in_the_training_split():
    kinds = {
        family: {make_shape(family, seed).kind for seed in split_seeds(family, "train")[:40]} for family in HEIGHTS_M
    }
    assert kinds["mug"] == {"round", "d", "ear", "square"}
    assert kinds["cup"] == {"tapered", "straight", "bulged", "square", "stemmed", "footed", "lidded"}
    assert len(kinds["bottle"]) >= 8


def test_splits_are_disjoint_and_large():
    for family in FAMILIES:
        train, val, test = (split_seeds(family, split) for split in SPLITS)
        assert (len(train), len(val), len(test)) == (400, 60, 60)
        assert len({*train, *val, *test}) == 520


def test_families_are_those_of_the_two_groups():
    assert (*HOUSEHOLD, *TRAFFIC) == FAMILIES
    assert len(FAMILIES) == len(set(FAMILIES)) == 30
    assert {get_family(name).group for name in HOUSEHOLD} == {"household"}
    assert {get_family(name).group for name in TRAFFIC} == {"traffic"}


def test_unknown_families_and_splits_are_refused_with_what_is_legal():
    with pytest.raises(UnknownCategory, match="cup, mug, bottle"):
        make_shape("boat", 0)
    with pytest.raises(UnknownCategory, match="cup, mug, bottle"):
        split_seeds("boat", "train")
    with pytest.raises(InvalidOption, match="train, val, test"):
        split_seeds("cup", "dev")


def test_shapes_are_made_in_a_fraction_of_a_second():
    for group, limit_s in ((HOUSEHOLD, 0.3), (TRAFFIC, 0.8)):
        started = time.perf_counter()
        for family in group:
            for seed in FEW:
                make_shape(family, seed)
        assert (time.perf_counter() - started) / (len(group) * len(FEW)) < limit_s


NAMED = {name: {*get_family(name).variants, *get_family(name).also} for name in FAMILIES}


@pytest.mark.slow
@pytest.mark.parametrize("family", [name for name, kinds in NAMED.items() if kinds])
def test_the_kinds_that_a_family_names_are_made(family):
    assert NAMED[family] <= {make_shape(family, seed).kind for seed in split_seeds(family, "train")[:60]}


@pytest.mark.slow
@pytest.mark.parametrize("family", FAMILIES)
def test_shapes_of_the_splits_are_sound(family):
    count = 60 if family in HEIGHTS_M else 6
    for split in SPLITS:
        for seed in split_seeds(family, split)[:count]:
            _assert_sound(make_shape(family, seed))


def _thickness(mesh: trimesh.Trimesh) -> np.ndarray:
    """Way m through the material below samples of the sides of a vessel, away from its floor and rim."""
    points, normals, _ = sample_surface(mesh, 1500, np.random.default_rng(0))
    tall = mesh.bounds[1, 2]
    level = (np.abs(normals[:, 2]) < 0.3) & (points[:, 2] > 0.4 * tall) & (points[:, 2] < 0.9 * tall)
    # Away from the handle.
    level &= points[:, 0] < 0.3 * np.abs(mesh.bounds[0, 0])
    points, normals = points[level], normals[level]
    hits, ray, _ = mesh.ray.intersects_location(points - 1e-5 * normals, -normals, multiple_hits=False)
    return np.linalg.norm(hits - points[ray], axis=1)


def test_kinds_are_drawn_by_their_shares():
    rng = np.random.default_rng(0)
    drawn = [draw_kind(rng, {"plain": 0.75, "rare": 0.25, "never": 0.0}) for _ in range(2000)]
    assert {kind: drawn.count(kind) / 2000 for kind in drawn} == pytest.approx({"plain": 0.75, "rare": 0.25}, abs=0.03)


def test_a_variant_has_what_its_class_says_and_its_own():
    own, lidded = {"hollow": True, "alike": ("cup",)}, {"hollow": False}
    family = Family("urn", lambda rng: Made(trimesh.Trimesh(), "plain"), "household", own, {"lidded": lidded})
    assert family.names == ("urn", "urn.lidded")
    assert family.spec_of("urn") == {"hollow": True, "alike": ("cup",)}
    assert family.spec_of("urn.lidded") == {"hollow": False, "share": pytest.approx(0.0821, abs=1e-4)}
    assert (family.members_of("urn"), family.members_of("urn.lidded")) == (80, 40)
