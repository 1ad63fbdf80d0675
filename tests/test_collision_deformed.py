"""Parts that ride along with a primitive, and the choice between ways to collision parts."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from bodies import AWAY, TURN
from scipy.spatial import KDTree

from gfp_grasp.collision import (
    DecomposeConfig,
    collision_of,
    convex_part,
    decompose,
    deform_parts,
    union_error_m,
    with_binding,
    within_parts,
)
from gfp_grasp.collision.deformed import _barycentric, _on_surface, _thinned
from gfp_grasp.collision.parts import PartFaces, volume_m3
from gfp_grasp.errors import DecompositionFailed, InvalidMesh
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.types import (
    CompletedShape,
    ConvexPart,
    FittedPrimitive,
    GenericPrimitive,
    PartBinding,
    Symmetry,
    Variant,
)

OUTER, INNER, FLOOR, HEIGHT = 0.04, 0.036, 0.004, 0.1


def square_cup() -> tuple[trimesh.Trimesh, tuple[ConvexPart, ...]]:
    """A square cup, 80 mm wide, walls of 4 mm, in triangles of at most 10 mm; and the five boxes it consists of."""
    solid = trimesh.boolean.difference(
        [
            trimesh.creation.box(bounds=[[-OUTER, -OUTER, 0], [OUTER, OUTER, HEIGHT]]),
            trimesh.creation.box(bounds=[[-INNER, -INNER, FLOOR], [INNER, INNER, 2 * HEIGHT]]),
        ]
    )
    for _ in range(4):
        solid = solid.subdivide()
    bounds = [
        [[-OUTER, -OUTER, 0], [OUTER, OUTER, FLOOR]],
        [[-OUTER, -OUTER, FLOOR], [-INNER, OUTER, HEIGHT]],
        [[INNER, -OUTER, FLOOR], [OUTER, OUTER, HEIGHT]],
        [[-INNER, -OUTER, FLOOR], [INNER, -INNER, HEIGHT]],
        [[-INNER, INNER, FLOOR], [INNER, OUTER, HEIGHT]],
    ]
    boxes = [trimesh.creation.box(bounds=bound) for bound in bounds]
    return solid, tuple(ConvexPart(box.vertices, box.faces) for box in boxes)


def primitive(
    mesh: trimesh.Trimesh, parts: tuple[ConvexPart, ...], variant: GenericPrimitive | None = None
) -> GenericPrimitive:
    v = len(mesh.vertices)
    return GenericPrimitive(
        category="cup",
        vertices=mesh.vertices,
        faces=mesh.faces,
        modes=np.zeros((0, v, 3)),
        explained=np.zeros(0),
        log_scale_cov=np.eye(3),
        coefficient_samples=np.zeros((1, 3)),
        symmetry=Symmetry(np.array([0, 0, 1.0]), 4),
        up=np.array([0, 0, 1.0]),
        regions=np.zeros(v),
        parts=parts,
        region_names=("outside", "inside", "handle"),
        variants=() if variant is None else (Variant(("handle",), variant, np.arange(len(variant.vertices))),),
    )


def completed(mesh: trimesh.Trimesh, template: GenericPrimitive | None) -> CompletedShape:
    v = len(mesh.vertices)
    fit = None
    if template is not None:
        fit = FittedPrimitive(template, np.eye(4), np.ones(3), np.zeros(0), residual_m=0.0)
    return CompletedShape(mesh, np.zeros(v, bool), np.zeros(v), fit)


CUP, BOXES = square_cup()
TEMPLATE = primitive(CUP, BOXES)


def tapered(vertices: np.ndarray) -> np.ndarray:
    """Wider towards the top, by half at the rim, and slightly taller."""
    share = vertices[:, 2:] / HEIGHT
    return np.column_stack([vertices[:, :2] * (1 + 0.5 * share), vertices[:, 2] * 1.1])


def test_an_undeformed_primitive_has_its_own_parts():
    found = deform_parts(TEMPLATE, CUP.vertices)
    assert [volume_m3(part) for part in found] == pytest.approx([volume_m3(box) for box in BOXES])
    for part, box in zip(found, BOXES, strict=True):
        np.testing.assert_allclose(np.ptp(part.vertices, axis=0), np.ptp(box.vertices, axis=0), atol=1e-8)


def test_parts_go_where_a_similarity_goes():
    turn = trimesh.transformations.random_rotation_matrix(np.array([0.2, 0.5, 0.9]))[:3, :3]
    there = deform_parts(TEMPLATE, tapered(CUP.vertices))
    moved = deform_parts(TEMPLATE, 1.3 * tapered(CUP.vertices) @ turn.T + [1, 2, 3])
    assert [volume_m3(part) for part in moved] == pytest.approx([1.3**3 * volume_m3(part) for part in there])
    for one, other in zip(there, moved, strict=True):
        assert within_parts(1.3 * one.vertices @ turn.T + [1, 2, 3], [other], margin_m=1e-8).all()


def test_parts_of_a_deformed_cup_follow_its_walls_and_leave_it_hollow():
    deformed = trimesh.Trimesh(tapered(CUP.vertices), CUP.faces, process=False)
    found = deform_parts(TEMPLATE, deformed.vertices)
    mean, _, largest = union_error_m(found, deformed, rng=np.random.default_rng(0))
    assert mean < 2e-4
    assert largest < 3e-3
    assert sum(map(volume_m3, found)) == pytest.approx(deformed.volume, rel=0.02)
    assert within_parts(deformed.vertices, found, margin_m=1e-4).any(axis=1).all()
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.03)
    assert not within_parts(np.add(ball.vertices, [0, 0, 0.05]), found).any()


def test_a_part_bulges_with_the_surface_between_its_corners():
    vertices = np.array(CUP.vertices)
    side = np.isclose(vertices[:, 0], OUTER)
    vertices[side, 0] += 0.01 * np.sin(np.pi * vertices[side, 2] / HEIGHT)
    found = deform_parts(TEMPLATE, vertices)
    assert found[2].vertices[:, 0].max() == pytest.approx(OUTER + 0.01, abs=1e-3)


def test_points_off_the_surface_keep_their_height_in_proportion():
    solid = trimesh.creation.box((0.1, 0.1, 0.1))
    for _ in range(2):
        solid = solid.subdivide()
    inner = trimesh.creation.box((0.09, 0.09, 0.09))
    found = deform_parts(primitive(solid, (ConvexPart(inner.vertices, inner.faces),)), 2 * solid.vertices)
    np.testing.assert_allclose(np.ptp(found[0].vertices, axis=0), 0.18, rtol=1e-6)


def test_the_corners_of_a_fine_ring_are_thinned_but_no_point_is_far_from_one_that_stays():
    angle = np.linspace(0, 2 * np.pi, 64, endpoint=False)
    ring = 0.0125 * np.column_stack([np.cos(angle), np.sin(angle), 0 * angle])
    cloud = np.vstack([ring, np.add(ring, [0, 0, 0.03])]) @ TURN.T + AWAY
    kept = _thinned(cloud, 0.2)
    assert len(kept) <= 80
    part = convex_part(kept)
    assert part is not None
    assert PartFaces.of([part]).height(cloud, 0).max() <= 1e-4
    flat = np.array([[x, y, 0.0] for x in range(11) for y in range(21)]) * 0.002
    wall = np.vstack([flat, np.add(flat, [0, 0, 0.001])])
    kept = _thinned(wall, 0.2)
    assert np.linalg.norm(wall[:, None] - kept, axis=2).min(axis=1).max() <= 0.005
    assert len(kept) < len(wall) / 4


def test_a_vehicle_gets_the_parts_of_a_cup_that_is_as_large():
    large = replace(TEMPLATE, vertices=30 * TEMPLATE.vertices, parts=tuple(map(scaled, TEMPLATE.parts)))
    there = deform_parts(large, 30 * tapered(CUP.vertices))
    for one, other in zip(deform_parts(TEMPLATE, tapered(CUP.vertices)), there, strict=True):
        np.testing.assert_allclose(30 * one.vertices, other.vertices, rtol=1e-6, atol=1e-6)
    whole = trimesh.Trimesh(large.vertices, large.faces, process=False)
    small = collision_of(completed(trimesh.Trimesh(CUP.vertices, CUP.faces, process=False), TEMPLATE))
    found = collision_of(completed(whole, large))
    assert found.made_by == small.made_by == "carried"
    assert len(found.parts) == len(small.parts)
    assert found.notes["ball_m"] == pytest.approx(30 * small.notes["ball_m"], rel=1e-6)  # pyright: ignore


def scaled(part: ConvexPart) -> ConvexPart:
    return ConvexPart(30 * part.vertices, part.faces)


def test_the_order_of_merges_is_the_primitives_own_where_it_has_one():
    own = replace(TEMPLATE, part_merges=np.array([[3, 4], [5, 0], [6, 1], [7, 2]]))
    volumes = [volume_m3(part) for part in deform_parts(own, CUP.vertices, count=4)]
    assert volumes[:3] == pytest.approx([volume_m3(box) for box in BOXES[:3]])
    across = volume_m3(ConvexPart(*hull_of(np.concatenate([BOXES[3].vertices, BOXES[4].vertices]))))
    assert volumes[3] == pytest.approx(across)
    wrong = replace(TEMPLATE, part_merges=np.array([[3, 4]]))
    assert max(volume_m3(part) for part in deform_parts(wrong, CUP.vertices, count=4)) < 0.9 * across


def test_a_stored_binding_moves_the_parts_and_the_gap_as_one_that_is_found(monkeypatch):
    stored = with_binding(TEMPLATE)
    assert stored.binding is not None
    assert stored.binding.gap_m is not None
    expected = {count: deform_parts(TEMPLATE, tapered(CUP.vertices), count=count) for count in (None, 2)}
    mesh = trimesh.Trimesh(tapered(CUP.vertices), CUP.faces, process=False)
    ball = collision_of(completed(mesh, TEMPLATE)).notes["ball_m"]
    monkeypatch.setattr("gfp_grasp.collision.choice.widest_gap", lambda mesh: pytest.fail("it is stored"))
    for count, parts in expected.items():  # of two parts no binding is stored: it is found
        for part, other in zip(parts, deform_parts(stored, tapered(CUP.vertices), count=count), strict=True):
            np.testing.assert_array_equal(part.vertices, other.vertices)
    assert collision_of(completed(mesh, stored)).notes["ball_m"] == ball
    cut = replace(stored.binding, weights=stored.binding.weights[::-1] * 0 + [1, 0, 0])
    moved = deform_parts(replace(stored, binding=cut), tapered(CUP.vertices))
    on_corners = np.concatenate([part.vertices for part in moved])
    assert KDTree(tapered(CUP.vertices)).query(on_corners)[0].max() < 1e-7


@pytest.mark.parametrize(
    "wrong", [{"weights": np.ones((3, 2))}, {"ends": [2]}, {"ends": [2, 1, 3]}, {"gap_m": [0, 1]}, {"ends": []}]
)
def test_a_binding_whose_arrays_do_not_fit_is_refused(wrong):
    right = {"corners": [[0, 1, 2]] * 3, "weights": [[1, 0, 0]] * 3, "height_m": [0] * 3, "ends": [1, 3]}
    assert PartBinding(**right, gap_m=None).ends.tolist() == [1, 3]
    with pytest.raises(InvalidMesh):
        PartBinding(**{**right, "gap_m": None, **wrong})


def test_a_binding_to_vertices_that_are_not_there_is_refused():
    far = PartBinding(np.array([[0, 1, len(CUP.vertices)]]), np.eye(3)[:1], np.zeros(1), np.ones(1), None)
    with pytest.raises(InvalidMesh, match=f"has vertex {len(CUP.vertices)}"):
        replace(TEMPLATE, binding=far)
    with pytest.raises(InvalidMesh, match="the primitive 2: other parts need another binding"):
        replace(with_binding(TEMPLATE), parts=TEMPLATE.parts[:2])


def hull_of(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    found = trimesh.convex.convex_hull(points)
    return found.vertices, found.faces


def test_weights_on_a_triangle_give_the_point_back_and_on_a_needle_the_nearest_corner():
    triangle = np.array([[0, 0, 0], [0.03, 0, 0.01], [0.01, 0.02, 0]]) + AWAY
    needle = np.array([[0, 0, 0], [0.01, 0, 0], [0.03, 0, 0]]) + AWAY
    share = np.array([0.2, 0.5, 0.3])
    point = share @ triangle
    found = _barycentric(np.stack([triangle, needle]), np.stack([point, np.add(AWAY, [0.028, 0, 0])]))
    np.testing.assert_allclose(found, np.stack([share, [0, 0, 1]]), atol=1e-9)
    outside = _barycentric(triangle[None], (triangle[0] - 0.001 * (triangle[1] - triangle[0]))[None])
    assert (outside >= 0).all()
    assert outside.sum() == pytest.approx(1)


def test_a_point_on_a_large_face_beside_many_small_ones_finds_its_own():
    plate = trimesh.creation.box(bounds=[[0, 0, -0.1], [1, 1, 0]])
    ball = trimesh.creation.icosphere(subdivisions=2, radius=0.005).apply_translation([0.05, 0.05, 0.01])
    both = trimesh.Trimesh(
        np.vstack([plate.vertices, ball.vertices]), np.vstack([plate.faces, ball.faces + len(plate.vertices)])
    )
    places = np.array([[0.05, 0.045, 0.0], [0.05, 0.05, 0.015]])
    feet, face = _on_surface(both, places, 0.2)
    np.testing.assert_allclose(feet, places, atol=2e-4)
    assert (face < 12).tolist() == [True, False]


def test_the_variant_stands_in_where_the_vertices_are_its_own():
    handle = trimesh.creation.box(bounds=[[0.035, -0.005, 0.03], [0.07, 0.005, 0.07]])
    with_handle = trimesh.util.concatenate([CUP, handle])
    whole = primitive(with_handle, (*BOXES, ConvexPart(handle.vertices, handle.faces)), variant=TEMPLATE)  # pyright: ignore
    assert len(deform_parts(whole, with_handle.vertices)) == 6  # pyright: ignore
    assert len(deform_parts(whole, CUP.vertices)) == 5
    assert collision_of(completed(CUP, whole)).made_by == "carried"


@pytest.mark.parametrize("vertices", [np.zeros((5, 3)), np.full_like(CUP.vertices, np.nan), CUP.vertices[:, :2]])
def test_vertices_that_are_not_the_primitives_are_refused(vertices):
    with pytest.raises(InvalidMesh):
        deform_parts(TEMPLATE, vertices)


def test_a_primitive_without_parts_and_a_flattening_are_refused():
    with pytest.raises(InvalidMesh, match="gps parts"):
        deform_parts(primitive(CUP, ()), CUP.vertices)
    with pytest.raises(InvalidMesh, match="flat"):
        deform_parts(TEMPLATE, CUP.vertices * [1, 1, 0])


def test_a_fitted_shape_gets_carried_parts_with_their_error():
    mesh = trimesh.Trimesh(tapered(CUP.vertices), CUP.faces, process=False)
    found = collision_of(completed(mesh, TEMPLATE))
    assert found.made_by == "carried"
    assert 0 < found.error_m[0] < found.error_m[2] < 3e-3
    assert found.notes["dropped"] == 0
    assert found.notes["volume_ratio"] == pytest.approx(1, abs=0.02)


def test_a_convex_shape_gets_its_hull():
    found = collision_of(completed(trimesh.creation.icosphere(subdivisions=2, radius=0.05), None))
    assert found.made_by == "hull"
    assert len(found.parts) == 1


def test_any_other_shape_goes_through_coacd():
    bars = [[[0, 0, 0], [0.1, 0.02, 0.02]], [[0, 0, 0], [0.02, 0.1, 0.02]]]
    mesh = trimesh.boolean.union([trimesh.creation.box(bounds=bound) for bound in bars])
    for template in (None, TEMPLATE):
        found = collision_of(completed(mesh, template))
        assert found.made_by == "coacd"
        assert len(found.parts) == 2


def test_carried_parts_that_miss_the_shape_give_way_to_better_ones(monkeypatch):
    filled = primitive(CUP, (ConvexPart(CUP.convex_hull.vertices, CUP.convex_hull.faces),))
    monkeypatch.setattr("gfp_grasp.collision.choice._ERROR_LIMIT", 1e-3)
    called = []

    def five_boxes(mesh, config):
        called.append(mesh)
        return collision_of(completed(mesh, TEMPLATE))

    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", five_boxes)
    found = collision_of(completed(CUP, filled))
    assert len(called) == 1
    assert len(found.parts) == 5


def test_carried_parts_are_kept_with_a_warning_where_coacd_fails(monkeypatch):
    def lost(_, config):
        raise DecompositionFailed("no luck")

    filled = primitive(CUP, (ConvexPart(CUP.convex_hull.vertices, CUP.convex_hull.faces),))
    monkeypatch.setattr("gfp_grasp.collision.choice._ERROR_LIMIT", 1e-3)
    monkeypatch.setattr("gfp_grasp.collision.choice.decompose", lost)
    with pytest.warns(RuntimeWarning, match=r"mm on average.*no luck"):
        found = collision_of(completed(CUP, filled))
    assert found.made_by == "carried"
    assert "warning" in found.notes


def shipped(category: str) -> GenericPrimitive:
    found = PrimitiveLibrary.shipped().primitive(category)
    assert found.parts
    return found


@pytest.mark.parametrize("category", ["cup", "mug", "bottle"])
def test_parts_of_shipped_primitives_follow_the_members_they_were_built_from(category):
    template = shipped(category)
    num_modes = len(template.modes)
    errors = []
    for sample in template.coefficient_samples[:8]:
        vertices = template.shape(sample[:num_modes], np.exp(sample[num_modes:]))
        mesh = trimesh.Trimesh(vertices, template.faces, process=False)
        errors.append(union_error_m(deform_parts(template, vertices), mesh, rng=np.random.default_rng(0))[0])
    assert np.median(errors) < 1.5e-3


@pytest.mark.parametrize("category", ["cup", "mug"])
def test_a_ball_of_10_mm_fits_between_the_parts_of_shipped_primitives(category):
    template = shipped(category)
    inside = template.vertices[template.regions == 1]
    ball = trimesh.creation.icosphere(subdivisions=3, radius=0.01)
    found = deform_parts(template, template.vertices)
    for height in (inside[:, 2].min() + 0.015, inside[:, 2].mean()):
        assert not within_parts(np.add(ball.vertices, [0, 0, height]), found).any()


@pytest.mark.slow
def test_carried_parts_are_as_true_as_coacd_run_afresh():
    deformed = trimesh.Trimesh(tapered(CUP.vertices), CUP.faces, process=False)
    fresh = decompose(deformed, config=DecomposeConfig(mcts_iterations=60, mcts_nodes=10))
    carried = collision_of(completed(deformed, TEMPLATE))
    assert carried.error_m[0] <= fresh.error_m[0] + 1e-4
    assert carried.seconds < fresh.seconds / 10
