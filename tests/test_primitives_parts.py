"""Optional parts of a class: named regions, the body without any set of them, and the rule for when each is kept."""

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from toy_primitive import toy_cup_primitive

import gfp_grasp.answers as completing
from gfp_grasp.deform.template import _mirrors
from gfp_grasp.errors import InvalidMesh, InvalidOption
from gfp_grasp.primitives import read_primitive, save_primitive
from gfp_grasp.primitives.build import _subsets
from gfp_grasp.types import BODY_REGIONS, FittedPrimitive, GenericPrimitive, OptionalPart, Symmetry, Variant

_AT = 3 * 2 * math.pi / 32  # azimuth of the grip, one of the toy's segments


def _pot(rules: dict[str, str] | None = None) -> GenericPrimitive:
    """A vessel with a spout and a grip as regions, and a variant for each set of them; the bodies are the vessel's."""
    body = toy_cup_primitive()
    names = (*BODY_REGIONS, "grip", "spout")
    azimuth = np.arctan2(body.vertices[:, 1], body.vertices[:, 0])
    outer = (body.regions == 0) & (np.linalg.norm(body.vertices[:, :2], axis=1) > 0.02)
    regions = np.where(outer & (np.abs(azimuth - _AT) < 0.3), 2, body.regions)
    regions = np.where(outer & (np.abs(azimuth - _AT + math.pi) < 0.3), 3, regions)
    pot = replace(body, category="pot", regions=regions, region_names=names, spec=None)
    parts = tuple(OptionalPart(name, keep) for name, keep in (rules or {"grip": "seen", "spout": "seen"}).items())
    pot = replace(pot, spec=replace(pot.spec, optional_parts=parts))
    everything = np.arange(len(body.vertices))
    variants = [
        Variant(
            without,
            replace(pot, regions=np.where(np.isin(regions, [names.index(n) for n in without]), 0, regions)),
            everything,
        )
        for without in (("grip",), ("spout",), ("grip", "spout"))
    ]
    return replace(pot, variants=tuple(variants))


def test_regions_of_parts_are_asked_by_name():
    pot = _pot()
    assert pot.on_region("grip").sum() > 20
    assert pot.on_region("spout").sum() > 20
    np.testing.assert_array_equal(pot.on_part, pot.on_region("grip") | pot.on_region("spout"))
    assert not pot.on_region("lid").any()


def test_body_without_parts_is_the_variant_that_lacks_just_those():
    pot = _pot()
    assert pot.without([]) is pot
    for lacking in (["grip"], ["spout"], ["spout", "grip"]):
        body = pot.without(lacking)
        assert body is not None
        assert {name for name in ("grip", "spout") if not body.on_region(name).any()} == set(lacking)
    assert replace(pot, variants=pot.variants[:2]).without(["grip", "spout"]) is None


def test_every_set_of_parts_gets_a_variant():
    assert _subsets(()) == []
    assert _subsets(("grip",)) == [("grip",)]
    assert _subsets(("grip", "spout")) == [("grip",), ("spout",), ("grip", "spout")]


def test_variants_and_names_of_regions_come_back_from_disk(tmp_path: Path):
    pot = _pot({"grip": "always", "spout": "seen"})
    again = read_primitive(save_primitive(pot, tmp_path))
    assert again.region_names == pot.region_names
    assert again.spec.optional_parts == (OptionalPart("grip", "always"), OptionalPart("spout", "seen"))
    assert sorted(variant.without for variant in again.variants) == sorted(variant.without for variant in pot.variants)
    for variant in pot.variants:
        body = again.without(variant.without)
        assert body is not None
        np.testing.assert_array_equal(body.regions, variant.primitive.regions)
        assert body.spec == pot.spec


def test_regions_without_a_name_and_parts_without_a_region_are_refused():
    pot = _pot()
    with pytest.raises(InvalidMesh, match="region_names"):
        replace(pot, region_names=BODY_REGIONS, variants=())
    with pytest.raises(InvalidMesh, match="region_names"):
        replace(pot, region_names=("inside", "outside", "grip", "spout"))
    with pytest.raises(InvalidOption, match="lid"):
        replace(pot, spec=replace(pot.spec, optional_parts=(OptionalPart("lid"),)))
    with pytest.raises(InvalidMesh, match="vertex map"):
        Variant(("grip",), pot, np.arange(3))


@pytest.mark.parametrize(
    ("rules", "option", "seen", "lacking"),
    [
        ({"grip": "seen", "spout": "seen"}, "card", {"grip", "spout"}, set()),
        ({"grip": "seen", "spout": "seen"}, "card", {"grip"}, {"spout"}),
        ({"grip": "seen", "spout": "seen"}, "card", set(), {"grip", "spout"}),
        ({"grip": "seen", "spout": "always"}, "card", set(), {"grip"}),
        ({"grip": "always", "spout": "always"}, "card", set(), set()),
        ({"grip": "always", "spout": "always"}, "seen", {"grip"}, {"spout"}),
        ({"grip": "seen", "spout": "seen"}, "always", set(), set()),
    ],
)
def test_part_is_kept_as_its_card_or_the_option_says(monkeypatch, rules, option, seen, lacking):
    monkeypatch.setattr(completing, "part_is_seen", lambda fit, part, view: part in seen)
    pot = _pot(rules)
    fit = FittedPrimitive(pot, np.eye(4), np.ones(3), np.zeros(len(pot.modes)), 0.0)
    kept = completing._with_parts_seen(fit, None, option).primitive  # pyright: ignore[reportArgumentType]
    assert kept is pot.without(lacking)


def test_points_on_parts_beside_the_axis_are_mirrored_in_the_plane_of_the_parts_alone():
    pot = replace(_pot(), symmetry=Symmetry(np.array([0, 0, 1.0]), 1))
    (across, stays), (along, swaps), (turn, turns) = _mirrors(pot)
    in_plane = np.array([math.cos(_AT), math.sin(_AT), 0.0])
    np.testing.assert_allclose(across @ in_plane, in_plane, atol=1e-6)
    np.testing.assert_allclose(along @ in_plane, -in_plane, atol=1e-6)
    np.testing.assert_allclose(turn, np.diag([-1.0, -1.0, 1.0]), atol=1e-12)
    assert stays.tolist() == [True, True, True, True]
    assert swaps.tolist() == turns.tolist() == [True, True, False, False]
    for move in (across, along, turn):
        np.testing.assert_allclose(move @ move.T, np.eye(3), atol=1e-12)


def test_part_on_the_axis_keeps_its_place_in_every_mirror():
    body = toy_cup_primitive()
    low = body.vertices[:, 2] < 0.2 * body.vertices[:, 2].max()
    stem = replace(
        body,
        regions=np.where(low & (body.regions == 0), 2, body.regions),
        region_names=(*BODY_REGIONS, "stem"),
        spec=None,
    )
    moves = _mirrors(stem)
    assert len(moves) == 3
    assert all(stays.all() for _, stays in moves)


def test_mirror_plane_of_a_class_may_stand_at_any_angle():
    normal = np.array([math.sqrt(0.5), math.sqrt(0.5), 0.0])
    oblong = replace(toy_cup_primitive(), symmetry=Symmetry(np.array([0, 0, 1.0]), 1, normal))
    ((move, _),) = _mirrors(oblong)
    np.testing.assert_allclose(move @ [1.0, 0.0, 0.5], [0.0, -1.0, 0.5], atol=1e-12)
