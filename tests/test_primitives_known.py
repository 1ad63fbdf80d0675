"""Statistics, frame, labels and figures of a primitive, to the number."""

import math
from dataclasses import asdict, replace
from typing import Any

import numpy as np
import pytest
import trimesh
from moments import assert_known, bent
from revolved import cup, mug
from toy_bodies import l_body, refined
from toy_primitive import random_cup, toy_cup_primitive
from toy_wedge import wedge_primitive

from gfp_grasp.meshes import vertex_normals
from gfp_grasp.primitives import BuildConfig, bring_into_one_pose, detect_symmetry, fit_full_surface, measure_primitive
from gfp_grasp.primitives.evaluate import _yaws, specificity_m
from gfp_grasp.primitives.pose import _body, _circle, stand_up
from gfp_grasp.primitives.procrustes import align, centroid_size, choose_template, generalized, shape_model
from gfp_grasp.primitives.regions import _fill, enclosed, label_regions, without_part
from gfp_grasp.primitives.remesh import refine
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import BODY_REGIONS, INSIDE, Symmetry


def _rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


def _members(count: int = 9, *, odd: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Corresponded members (s, v, 3) of an L with three ways to differ, the last few far from the rest; faces."""
    rng, body = _rng(1), bent(l_body(0.025))
    x, y, z = np.asarray(body.vertices).T
    ways = np.stack([np.column_stack([z * z, 0 * y, x * z]), np.column_stack([0 * x, x * x, y * z]),
                     np.column_stack([y * y, x * z, z * z])])  # fmt: skip
    size = np.exp(0.1 * rng.normal(size=(count, 1, 3)))
    amount = rng.normal(size=(count, 3)) * [1.5, 0.6, 0.2]
    amount[count - odd :] += [1.0, 14.0, -8.0]
    return size * (body.vertices + np.einsum("sk,kvc->svc", amount, ways)), np.asarray(body.faces)


def test_options_of_a_build_are_those_that_the_shipped_primitives_were_built_with() -> None:
    """Whoever changes one of them builds the primitives again."""
    assert asdict(BuildConfig()) == {
        "orientation": "placed",
        "rounds": 2,
        "variance": 0.99,
        "max_modes": 24,
        "smoothing": 0.75,
        "max_residual": 0.015,
        "min_covered": 0.93,
        "max_flipped": 0.03,
        "min_members": 5,
        "symmetry_share": 0.9,
        "optional_parts": True,
        "parts": True,
        "licence": "",
        "correspondence": {
            "stiff": 0.5,
            "soft": 0.02,
            "steps": 12,
            "rounds": 5,
            "normal_weight": 0.12,
            "sliding": 0.35,
            "binding": 0.3,
            "num_samples": 3000,
        },
        "remesh": {"tolerance": 0.0012, "min_edge": 0.015, "max_edge": 0.05, "iterations": 6},
        "resample": {"max_error_m": 0.0005, "max_error": 0.0016, "mode_error": 2.0, "max_edge": 0.09},
    }


def test_the_template_is_the_most_central_of_a_few_candidates() -> None:
    members, faces = _members(30)
    meshes = [trimesh.Trimesh(vertices, faces, process=False) for vertices in members]
    rows = [choose_template(meshes, _rng(seed), num_candidates=count) for seed in range(6) for count in (1, 2, 8)]
    assert_known("choose template", np.array([*rows, choose_template(meshes, _rng())]))


def test_alignment_weighs_points_and_turns_about_an_axis_as_ever() -> None:
    members, _ = _members(5)
    weights = np.linspace(1.0, 3.0, members.shape[1])
    ways: dict[str, dict[str, Any]] = {
        "free": {},
        "unscaled": {"scaling": False},
        "axis": {"axis": np.array([3, 1, 8])},
    }
    for name, knobs in ways.items():
        found = align(members[0], members[1], weights=weights, **knobs)
        assert_known(f"align {name}", found.matrix())
        np.testing.assert_allclose(found.matrix()[:3, :3] @ members[0, 7] + found.t, found.apply(members[0, 7]))
        every = generalized(members, weights=weights, **knobs)
        assert_known(f"generalized {name}", np.append(every.mean, every.iterations))
        assert_known(f"generalized {name} aligned", every.aligned)
    assert generalized(members, max_iterations=2, tolerance=0.0).iterations == 2
    assert generalized(members, tolerance=1e-3).iterations < generalized(members).iterations
    assert centroid_size(np.eye(3), centre=False) == pytest.approx(1.0)
    assert centroid_size(np.eye(3), weights=np.array([2.0, 0.0, 2.0])) == pytest.approx(math.sqrt(0.5))


@pytest.mark.parametrize(
    ("name", "odd", "knobs", "num_modes", "outliers"),
    [
        ("usual", 0, {}, 2, 0),
        ("all", 0, {"variance": 1.0}, 4, 0),
        ("one", 0, {"max_modes": 1}, 1, 0),
        ("odd", 2, {"variance": 0.95}, 4, 2),
        ("odd few", 2, {"max_modes": 2}, 2, 2),
        ("far", 2, {"outlier_beyond": 1e3}, 2, 0),
    ],
)
def test_modes_of_a_class_and_of_its_outliers_are_those_of_old(name, odd, knobs, num_modes, outliers) -> None:
    members, _ = _members(14, odd=odd)
    model = shape_model(members, np.linspace(1.0, 2.0, members.shape[1]), **knobs)
    assert_known(f"shape model {name}", model.mean)
    assert_known(f"shape model {name} modes", model.modes)
    assert_known(f"shape model {name} scores", np.hstack([model.coefficients, model.log_scale]))
    assert_known(f"shape model {name} variance", np.append(model.explained, 1e3 * model.variance_m2**0.5))
    assert (len(model.modes), int(model.outlier.sum())) == (num_modes, outliers)


def test_members_that_are_alike_have_no_outlier_and_rounding_has_no_mode() -> None:
    members, _ = _members(1)
    size = float(np.sqrt((members[0] ** 2).sum(axis=1).mean()))
    weights = np.ones(members.shape[1])
    noise = _rng(4).normal(size=(8, *members.shape[1:])) * size / math.sqrt(3)
    for share, outliers in ((0.004, 0), (0.007, 1)):  # one is off, the others are the same: 2.5 times 0.002 of the size
        one = np.repeat(members, 8, axis=0) + np.eye(8)[0][:, None, None] * share * noise[:1]
        assert shape_model(one, weights).outlier.sum() == outliers
    assert len(shape_model(members + 0.5e-7 * noise, weights).modes) == 0
    assert len(shape_model(members + 2e-7 * noise, weights).modes) > 0


def test_a_weak_direction_is_kept_down_to_a_hundred_thousandth_of_the_variance() -> None:
    members, _ = _members(1)
    a, b = _rng(6).normal(size=(2, *members.shape[1:])) * 1e-3
    first, second = np.array([1, -1, 1, -1.0]), np.array([1, 1, -1, -1.0])
    for share, modes in ((0.6e-5, 1), (1.6e-5, 2)):
        shapes = members + first[:, None, None] * a + math.sqrt(share) * second[:, None, None] * b
        found = shape_model(shapes, np.ones(members.shape[1]), variance=1.0)
        assert (found.explained > 0.5e-5).sum() == modes


@pytest.mark.parametrize("orientation", ["any", "upright"])
def test_members_are_turned_onto_the_most_central_one_as_ever(orientation: str) -> None:
    members, faces = _members(3)
    turns = [rotation_about((0, 0, 1), 0.9 * k) for k in range(3)]
    if orientation == "any":
        turns = [rotation_about((1.0, 2.0, 0.5 - k), 0.7 * k) for k in range(3)]
    meshes = [trimesh.Trimesh(v @ R.T + 0.3, faces, process=False) for v, R in zip(members, turns, strict=True)]
    posed = bring_into_one_pose(meshes, orientation, _rng())
    for number, (mesh, before) in enumerate(zip(posed, meshes, strict=True)):
        assert_known(f"pose {orientation} {number}", mesh.vertices)
        np.testing.assert_allclose(mesh.volume, before.volume)


def _turned(vertices: np.ndarray) -> np.ndarray:
    return vertices @ rotation_about((2.0, -1.0, 0.4), 2.2).T + [0.2, 0.1, -0.4]


@pytest.mark.parametrize(
    ("name", "mesh"),
    [
        ("L", bent(l_body(0.025))),
        ("mug", mug()),
        ("cup", cup(sections=24)),
        ("can", trimesh.creation.cone(radius=0.04, height=0.12, sections=24)),
    ],
)
def test_a_class_stands_up_as_ever(name: str, mesh: trimesh.Trimesh) -> None:
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.faces)
    stretched = np.stack([vertices, 1.2 * vertices * [1.0, 1.05, 0.9]])
    moved = np.stack([_turned(member) for member in stretched])
    assert_known(f"stand up {name}", stand_up(moved, moved.mean(axis=0), faces, upright=False), rel=1e-4)
    spun = stretched @ rotation_about((0, 0, 1), 2.0).T + 0.3
    assert_known(f"stand up {name} upright", stand_up(spun, spun.mean(axis=0), faces, upright=True), rel=1e-4)


def test_the_body_of_a_mug_is_what_lies_near_its_circle() -> None:
    mesh = mug()
    centre, radius = _circle(np.asarray(mesh.vertices)[:, :2], vertex_normals(mesh.vertices, mesh.faces))
    assert_known("circle", np.append(centre, radius))
    assert_known("body of a mug", np.flatnonzero(~_body(np.asarray(mesh.vertices), np.asarray(mesh.faces))))


def test_labels_are_where_they_have_been() -> None:
    mesh = bent(refine(mug(), 0.012))
    regions, names = label_regions(mesh)
    assert names == (*BODY_REGIONS, "handle")
    assert_known("regions inside", np.flatnonzero(regions == INSIDE))
    assert_known("regions handle", np.flatnonzero(regions == 2))
    assert_known("enclosed", np.flatnonzero(enclosed(bent(cup()))))


def test_a_part_is_cut_off_where_it_has_been() -> None:
    mesh = refine(mug(), 0.01)
    vertices = np.asarray(mesh.vertices)
    kept, faces = without_part(vertices, np.asarray(mesh.faces), vertices[:, 0] > 0.05)
    assert_known("without part", kept)
    assert_known("without part faces", np.sort(faces, axis=None))
    grown, _ = without_part(vertices, np.asarray(mesh.faces), (vertices[:, 0] > 0.0445) & (vertices[:, 2] > 0.03))
    assert_known("without part that grows", grown)


def test_a_hole_is_filled_with_the_least_area() -> None:
    corners = np.array([[0, 0, 0], [2, 0, 0.3], [3, 1, 0], [1.2, 1.1, 0.2], [1, 3, 0], [-0.5, 1.5, 0.4]])
    found = {tuple(sorted(face)) for face in _fill(corners, list(range(6))).tolist()}
    assert found == {(0, 1, 3), (1, 2, 3), (0, 3, 5), (3, 4, 5)}
    assert _fill(corners, [0, 1, 2]).tolist() in ([[2, 1, 0]], [[1, 0, 2]], [[0, 2, 1]])


@pytest.mark.parametrize(
    ("depth", "order"), [(0.02, math.inf), (0.2, 5)]
)  # flutes of a share of the radius: within the tolerance, or not
def test_a_class_is_as_round_as_its_waves_are_small(depth: float, order: float) -> None:
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    reach = 0.04 * (1 + depth * np.cos(5 * angle + 0.3))
    outline = np.column_stack([reach * np.cos(angle), reach * np.sin(angle)])
    body = refined(trimesh.creation.extrude_polygon(_polygon(outline), 0.09), 0.02)
    assert detect_symmetry([body], _rng()).order == order


def test_symmetry_needs_the_tolerance_and_the_share_that_it_is_given() -> None:
    slab = trimesh.creation.box((0.08, 0.077, 0.1))
    found = {t: detect_symmetry([slab], _rng(), tolerance=t).order for t in (0.005, 0.012)}
    assert found == {0.005: 2, 0.012: 4}
    turned = slab.copy()
    turned.apply_transform(trimesh.transformations.rotation_matrix(np.radians(30), (0, 0, 1)))
    normal = detect_symmetry([turned], _rng(), tolerance=0.005).mirror_normal
    np.testing.assert_allclose(np.asarray(normal), [math.sqrt(0.75), 0.5, 0.0], atol=1e-9)
    assert detect_symmetry([bent(l_body())], _rng()).mirror_normal is None
    two = [slab, bent(l_body())]
    assert detect_symmetry(two, _rng(), tolerance=0.005, share=0.5).order == 2
    assert detect_symmetry(two, _rng(), tolerance=0.005, share=0.6).order == 1


def test_whole_surfaces_are_fitted_as_ever() -> None:
    placed = random_cup(_rng(5))
    placed.apply_translation((0.1, -0.2, 0.3))
    vertices, error_m = fit_full_surface(toy_cup_primitive(), placed)
    assert_known("fit full surface", np.append(vertices, error_m), rel=1e-4)
    wedge = wedge_primitive()
    turned = wedge.shape(np.array([0.8, -0.5, 0.3]), np.array([1.1, 0.9, 1.05])) @ rotation_about((0, 0, 1), 2.2).T
    found, error_m = fit_full_surface(wedge, trimesh.Trimesh(turned, wedge.faces, process=False), seed=2)
    assert_known("fit full surface wedge", np.append(found, error_m), rel=1e-4)


@pytest.mark.parametrize(
    ("order", "degrees"), [(1, range(0, 360, 45)), (2, range(0, 180, 45)), (3, (0, 45, 90)), (12, [0]), (math.inf, [0])]
)
def test_starts_of_a_whole_fit_cover_what_the_symmetry_leaves_open(order: float, degrees) -> None:
    primitive = replace(wedge_primitive(), symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), order))
    np.testing.assert_allclose(np.degrees(_yaws(primitive)), list(degrees), atol=1e-9)


def test_figures_of_a_primitive_are_those_of_old() -> None:
    primitive, rng = toy_cup_primitive(), _rng(3)
    held_out = [random_cup(rng) for _ in range(2)]
    assert_known("specificity", np.array([specificity_m(primitive, _rng()), specificity_m(primitive, _rng(), count=7)]))
    seen: list[int] = []
    report = measure_primitive(
        primitive, held_out, seed=1, progress=lambda stream, total: (seen.append(total), stream)[1]
    )
    figures = report.figures()
    assert seen == [2]
    assert (figures["vertices"], figures["modes"], figures["held_out"]) == (len(primitive.vertices), 5, 2)
    errors = [1e3 * fit_full_surface(primitive, mesh, seed=1)[1] for mesh in held_out]
    assert figures["generalization_mm"] == round(float(np.mean(errors)), 3)
    assert figures["generalization_median_mm"] == round(float(np.median(errors)), 3)
    assert figures["generalization_worst_mm"] == round(max(errors), 3)
    assert figures["specificity_mm"] == round(1e3 * specificity_m(primitive, _rng(1)), 3)
    assert figures["variance_kept"] == round(float(primitive.explained.sum()), 3)


def _polygon(outline: np.ndarray):
    from shapely.geometry import Polygon

    return Polygon(outline)
