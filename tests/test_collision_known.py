"""Errors, rooms, cuts, levels and bindings of convex parts, to the number, on bodies without any symmetry."""

import inspect
import threading
import warnings
from dataclasses import asdict, replace

import numpy as np
import pytest
import trimesh
from bodies import l_parts, l_shape
from moments import assert_known, bent
from revolved import cup
from test_collision_deformed import CUP, TEMPLATE, completed, primitive, tapered
from toy_bodies import l_body, refined

from gfp_grasp import collision
from gfp_grasp.collision import (
    CollisionConfig,
    DecomposeConfig,
    attempts,
    choice,
    convex_part,
    cut_parts,
    decomposition,
    deform_parts,
    union_error_m,
)
from gfp_grasp.collision.choice import _ball, _measured, _said
from gfp_grasp.collision.convex import _directions, convex_parts, fewer_corners, needed_corners
from gfp_grasp.collision.cutting import _measured as measured_piece
from gfp_grasp.collision.cutting import _planes, _solid
from gfp_grasp.collision.deformed import _thinned, bind_parts
from gfp_grasp.collision.fidelity import ball_radii_m, barycentric_hold, volume_ratios, widest_gap
from gfp_grasp.collision.levels import levels_of
from gfp_grasp.collision.parts import PartFaces, diagonal_m
from gfp_grasp.errors import InvalidOption
from gfp_grasp.types import CollisionMesh, ConvexPart


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _ball_points(count: int = 300, seed: int = 0) -> np.ndarray:
    points = _rng(seed).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True) * [0.05, 0.03, 0.04]


def _rough_parts() -> list[ConvexPart]:
    """Five overlapping parts that follow a bent L roughly: some surface is missing, some is too much."""
    vertices = np.asarray(BODY.vertices)
    parts = [
        convex_part(vertices[(vertices[:, 2] > 0.02 * k - 0.01) & (vertices[:, 2] < 0.02 * k + 0.024)])
        for k in range(5)
    ]
    return [part for part in parts if part is not None]


BODY = bent(l_body(0.015))
PARTS = _rough_parts()


def test_options_of_coacd_are_its_own_by_default() -> None:
    import coacd  # type: ignore[import-untyped]

    own = {
        name: value.default for name, value in inspect.signature(coacd.run_coacd).parameters.items() if name != "mesh"
    }
    assert DecomposeConfig().coacd_options() == own
    config = asdict(DecomposeConfig())
    assert {name: config[name] for name in set(config) - set(own)} == {
        "time_limit_s": 300.0,
        "memory_limit_mb": 4096,
        "attempts": 4,
        "engine": "coacd",
        "vhacd_resolution": 400_000,
        "cache": True,
    }
    assert asdict(CollisionConfig()) == {
        "max_parts": 80,
        "max_vertices_per_part": None,
        "tolerance_m": None,
        "engine": "auto",
    }


@pytest.mark.parametrize("count", [300, 2000])
def test_errors_of_rough_parts_are_those_of_old(count: int) -> None:
    assert_known(f"union error {count}", union_error_m(PARTS, BODY, count=count, rng=_rng()), rel=1e-4)
    # Long triangles, whose nearest is not among those of the nearest centroids.
    assert_known(f"union error of an L {count}", union_error_m(PARTS, l_shape(), count=count, rng=_rng(1)), rel=1e-4)


def test_errors_are_measured_at_two_thousand_places_and_volumes_at_four_thousand() -> None:
    assert union_error_m(PARTS, BODY, rng=_rng()) == union_error_m(PARTS, BODY, count=2000, rng=_rng())
    assert volume_ratios(PARTS, BODY, rng=_rng()) == volume_ratios(PARTS, BODY, count=4000, rng=_rng())
    assert_known("volume ratios", volume_ratios(PARTS, BODY, rng=_rng()))


def test_places_that_hide_deep_within_the_union_are_measured_to_its_outside() -> None:
    inner = BODY.copy()
    inner.apply_scale(0.7)
    inner.apply_translation((0.008, 0.002, 0.012))
    assert_known("union error of what is hidden", union_error_m(PARTS, inner, count=600, rng=_rng()), rel=1e-4)


def test_the_widest_gap_and_what_holds_it_are_those_of_old() -> None:
    tall = bent(cup(sections=24))
    centre = widest_gap(tall)
    assert centre is not None
    assert_known("widest gap", centre)
    assert_known("widest gap of another seed", widest_gap(tall, seed=3))  # pyright: ignore[reportArgumentType]
    vertices = np.asarray(tall.vertices)
    for name, place in (("hollow", centre), ("wall", vertices[100] + 0.002), ("far", np.array([0.4, 0.1, 0.2]))):
        near, weights = barycentric_hold(place, vertices)
        np.testing.assert_allclose(weights @ vertices[near], place, atol=1e-9)
        assert_known(f"barycentric hold {name}", np.append(near, weights), rel=1e-4)
    assert_known("ball radii", ball_radii_m(centre, tall, PartFaces.of(PARTS)))


@pytest.mark.parametrize(("depth", "hollow"), [(0.0015, False), (0.011, True)])
def test_a_dent_is_no_hollow_until_a_ball_of_a_fortieth_fits(depth: float, hollow: bool) -> None:
    bowl = trimesh.boolean.difference(
        [
            trimesh.creation.box((0.1, 0.08, 0.04)),
            trimesh.creation.box((0.07, 0.05, 2 * depth)).apply_translation((0, 0, 0.02)),
        ]
    )
    assert (widest_gap(refined(bowl, 0.003)) is not None) == hollow


def test_cuts_are_those_of_old() -> None:
    body = bent(l_body(0.03))
    found = cut_parts(body, concavity_m=0.0015, max_parts=20)
    assert found.made_by == "cuts"
    for k, part in enumerate(found.parts):
        assert_known(f"cut part {k}", part.vertices, rel=1e-4)
    assert_known("cut error", found.error_m, rel=1e-3)
    assert_known("cut notes", [found.notes["concavity_m"], found.notes["volume_ratio"]], rel=1e-4)  # pyright: ignore[reportArgumentType]
    bowl = cut_parts(bent(cup(sections=16)), concavity_m=0.004)
    volumes = np.array([part.to_trimesh().volume for part in bowl.parts])
    assert_known("cut cup volumes", np.sort(volumes), rel=1e-3)


def test_planes_that_are_tried_pass_the_deepest_vertex_the_middle_and_the_axis() -> None:
    piece = measured_piece(_solid(BODY))
    assert_known("concavity", [*piece.deepest, piece.concavity_m], rel=1e-4)
    for name, axis in (("aside", (0.01, 0.02)), ("near", piece.deepest[:2] + 0.001)):
        planes = _planes(piece, np.asarray(axis))
        assert_known(f"planes {name}", [np.append(normal, offset) for normal, offset in planes], rel=1e-4)
    assert len(_planes(piece, np.array([0.01, 0.02]))) == 10


def test_levels_of_many_parts_are_those_of_old() -> None:
    levels = levels_of(tuple(PARTS), BODY)
    assert_known("merges", levels.merges)
    assert_known("level errors", levels.errors_m, rel=1e-4)
    assert len(levels.errors_m) == len(levels.parts) == 5


def test_few_corners_are_chosen_as_ever() -> None:
    hull = convex_part(_ball_points())
    assert hull is not None
    for count in (4, 9, 40):
        assert_known(f"fewer corners {count}", fewer_corners(np.asarray(hull.vertices), count))
    assert_known("directions", _directions(13))
    for tolerance_m in (1e-4, 2e-3):
        assert_known(f"needed corners {tolerance_m}", needed_corners(_ball_points(), tolerance_m))
    parts, dropped = convex_parts([_ball_points(), _ball_points(50, 1) * [1, 1, 1e-4]], max_vertices=12)
    assert dropped == 1
    assert_known("convex part", parts[0].vertices)
    assert_known("thinned", _thinned(_ball_points(900, 2), 0.12))


def test_parts_of_a_bent_cup_are_bound_as_ever() -> None:
    bound = bind_parts(TEMPLATE, 3, gap_m=None)
    assert_known("binding", np.einsum("pc,pci->pi", bound.weights, TEMPLATE.vertices[bound.corners]))
    assert_known("binding ends", bound.ends)
    moved = np.asarray(bent(trimesh.Trimesh(tapered(np.asarray(CUP.vertices)), CUP.faces, process=False)).vertices)
    for count, most in ((None, None), (2, None), (99, 8)):
        parts = deform_parts(TEMPLATE, moved, count=count, max_vertices=most)
        # Sizes, not corners: where three points are in line, rounding says which of them is a corner.
        solids = [trimesh.Trimesh(part.vertices, part.faces) for part in parts]
        sizes = [[*solid.center_mass, *solid.extents, solid.volume * 1e3] for solid in solids]
        assert_known(f"deformed parts {count}", sizes)


def test_deformed_parts_are_measured_at_three_hundred_places() -> None:
    mesh = trimesh.Trimesh(tapered(np.asarray(CUP.vertices)), CUP.faces, process=False)
    template = primitive(CUP, TEMPLATE.parts)
    found = _measured(template, mesh, 5, CollisionConfig())
    rng = _rng()
    faces = PartFaces.of(found.parts)
    ratios = volume_ratios(faces, mesh, count=300, rng=rng)
    assert (found.notes["volume_ratio"], found.notes["union_volume_ratio"]) == ratios
    assert found.error_m == union_error_m(faces, mesh, count=300, rng=rng)
    assert (found.made_by, found.notes["level"], found.notes["dropped"]) == ("carried", 5, 0)
    assert 0 <= float(found.notes["deforming_s"]) <= found.seconds < 10  # pyright: ignore[reportArgumentType]
    assert_known("ball of a cup", [found.notes["ball_m"], found.notes["ball_left_m"]])  # pyright: ignore[reportArgumentType]
    assert _ball(template, mesh, faces).keys() == {"ball_m", "ball_left_m"}
    flat = trimesh.Trimesh(np.asarray(CUP.vertices) * [1, 1, 0.02], CUP.faces, process=False)
    assert _ball(template, flat, faces) == {}


def test_a_warning_names_parts_figures_and_what_is_left_of_the_ball() -> None:
    def said(made_by: str, left_m: float | None = None) -> str:
        notes = {} if left_m is None else {"ball_m": 0.02, "ball_left_m": left_m}
        return _said(CollisionMesh(tuple(PARTS), (0.0012, 0.0034, 0.1), made_by, 0.0, notes))  # pyright: ignore[reportArgumentType]

    figures = "miss the mesh by 1.2 mm on average, 3.4 mm for 95 %"
    assert said("carried") == f"deformed parts {figures}"
    assert said("hull", 0.0161) == f"the hull {figures}"
    assert said("coacd", 0.005) == f"CoACD's 5 parts {figures}, and leave 25% of the ball that fits inside"


def test_a_budget_of_vertices_is_a_limit_of_coacd() -> None:
    assert choice._as_coacd(CollisionConfig(max_parts=7)) == DecomposeConfig(max_convex_hull=7)
    limited = choice._as_coacd(CollisionConfig(max_parts=7, max_vertices_per_part=12))
    assert limited == DecomposeConfig(max_convex_hull=7, decimate=True, max_ch_vertex=12)


@pytest.mark.parametrize(("excess", "convex"), [(0.0005, True), (0.002, False)])
def test_a_mesh_that_its_hull_exceeds_by_a_thousandth_is_not_convex(excess: float, convex: bool) -> None:
    box = refined(trimesh.creation.box((0.1, 0.1, 0.1)), 0.02)
    vertices = np.array(box.vertices)
    inner = np.flatnonzero((np.abs(vertices[:, :2]) < 0.03).all(axis=1) & (vertices[:, 2] > 0.0499))
    dented = trimesh.Trimesh(vertices, box.faces, process=False)
    vertices[inner, 2] -= 1e-3
    missing = 1 - trimesh.Trimesh(vertices, box.faces, process=False).volume / 1e-3
    vertices[inner, 2] += 1e-3 - 1e-3 * excess / missing
    dented = trimesh.Trimesh(vertices, box.faces, process=False)
    assert choice._is_convex(dented) == convex
    assert not choice._is_convex(trimesh.Trimesh(box.vertices, box.faces[3:], process=False))


def test_a_template_may_take_half_an_hour_and_is_cut_finer_where_few_parts_are_not_close(monkeypatch) -> None:
    asked: list[DecomposeConfig] = []
    near_m = 0.0005 * diagonal_m(np.asarray(BODY.vertices))
    for count, error_m, thresholds in (
        (31, 1.01 * near_m, [0.02, 0.01]),
        (31, 0.99 * near_m, [0.02]),
        (32, 1.01 * near_m, [0.02]),
    ):

        def decompose(mesh, *, config, count=count, error_m=error_m):
            asked.append(config)
            return CollisionMesh((l_parts() * 20)[:count], (error_m, 9.0, 9.0), "coacd", 0.0, {})

        asked.clear()
        monkeypatch.setattr(decomposition, "decompose", decompose)
        monkeypatch.setattr(decomposition, "levels_of", lambda parts, mesh: len(parts))
        assert decomposition.part_levels(BODY) == count
        assert asked == [DecomposeConfig(threshold=threshold, time_limit_s=1800.0) for threshold in thresholds]


def test_a_shape_whose_primitive_is_another_is_not_carried() -> None:
    shape = completed(CUP, primitive(trimesh.creation.box((0.1, 0.1, 0.1)), ()))
    assert choice._deformed(shape, CollisionConfig()) is None
    assert choice._deformed(completed(CUP, replace(TEMPLATE, parts=())), CollisionConfig()) is None
    assert choice._deformed(completed(CUP, None), CollisionConfig()) is None
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = choice._deformed(completed(CUP, TEMPLATE), CollisionConfig(max_parts=4))
    assert found is not None
    assert found.notes["level"] == 4
    assert diagonal_m(CUP.vertices) == pytest.approx(float(np.linalg.norm(CUP.extents)))


def test_a_hull_tells_its_volume_and_that_nothing_was_dropped() -> None:
    found = decomposition.hull(BODY, max_vertices=4)
    (part,) = found.parts
    assert len(part.vertices) == 4
    ratio = part.to_trimesh().volume / BODY.volume
    assert found.notes == {
        "dropped": 0,
        "volume_ratio": pytest.approx(ratio),
        "union_volume_ratio": pytest.approx(ratio),
    }
    assert found.error_m == union_error_m(found.parts, BODY, rng=_rng())
    assert (found.made_by, 0 <= found.seconds < 5) == ("hull", True)
    with pytest.raises(InvalidOption, match="at least 4"):
        decomposition.hull(BODY, max_vertices=3)


def test_notes_of_a_decomposition_are_those_of_its_attempt_and_its_repair(monkeypatch: pytest.MonkeyPatch) -> None:
    hulls = [(np.asarray(part.vertices), np.asarray(part.faces)) for part in PARTS]
    said = {"memory_limit": True, "unknown_options": []}
    monkeypatch.setattr(attempts, "run_guarded", lambda *_, **__: (hulls, said))
    stages: list[str] = []
    config = DecomposeConfig(cache=False, seed=5, threshold=0.07)
    found = decomposition.decompose(BODY, config=config, progress=stages.append)
    assert stages == ["checking", "repairing", "decomposing, attempt 1", "measuring"]
    ratio, union_ratio = volume_ratios(found.parts, BODY, rng=_rng())
    assert found.notes == {
        "attempts": 1,
        "lost": (),
        "dropped": 0,
        "volume_ratio": pytest.approx(ratio),
        "union_volume_ratio": pytest.approx(union_ratio),
        "threshold": 0.07,
        "preprocess_mode": "off",
        "memory_limit": True,
        "cached": False,
        "repair_m": 0.0,
    }
    assert found.error_m == pytest.approx(union_error_m(found.parts, BODY, rng=_rng(5)))
    assert found.made_by == "coacd"
    free = decomposition.decompose(BODY, config=replace(config, memory_limit_mb=None, engine="vhacd"))
    assert (free.notes["memory_limit"], free.notes["vhacd_resolution"], free.made_by) == (False, 400_000, "vhacd")
    assert "threshold" not in free.notes


def test_a_stream_stops_when_it_is_closed_or_its_caller_says_so() -> None:
    sign = threading.Event()
    stop = decomposition._Stop(sign)
    assert not stop.is_set()
    sign.set()
    assert stop.is_set()
    closed = decomposition._Stop(None)
    assert not closed.is_set()
    closed.called_off.set()
    assert closed.is_set()


@pytest.mark.parametrize(("offset_m", "is_coarse"), [(9.0, False), (11.0, True)])
def test_points_beyond_ten_metres_are_what_float32_leaves_of_them(offset_m: float, is_coarse: bool) -> None:
    points = _ball_points() + offset_m
    assert (np.abs(attempts.in_float32(points) - points).max() > 0) == is_coarse
    assert len(attempts.in_float32(np.zeros((0, 3)))) == 0


def test_every_name_of_the_room_leads_to_what_bears_it() -> None:
    assert {*collision.__all__} <= {*dir(collision)}
    for name in collision.__all__:
        found = getattr(collision, name)
        if callable(found):
            assert found.__name__ == name
            assert found.__module__.startswith("gfp_grasp.collision")
    with pytest.raises(AttributeError, match="nothing"):
        collision.nothing  # noqa: B018  # pyright: ignore[reportAttributeAccessIssue]
