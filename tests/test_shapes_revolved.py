"""Glasses, bowls, plates, cans, jars, vases, tubes and flasks: facts that tell them from each other and from inside."""

from itertools import chain

import numpy as np
import pytest
import trimesh

from gfp_grasp.shapes import Shape, make_shape
from gfp_grasp.shapes.loft import rounded_off, rows
from gfp_grasp.shapes.matched import cut, matched, stepped
from gfp_grasp.shapes.vessel import Vessel

FAMILIES = ("glass", "wine_glass", "bowl", "plate", "can", "jar", "vase", "tube", "flask")
SEEDS = range(12)


@pytest.fixture(scope="module")
def shapes() -> dict[str, list[Shape]]:
    return {family: [make_shape(family, seed) for seed in SEEDS] for family in FAMILIES}


@pytest.mark.parametrize("family", FAMILIES)
def test_members_have_no_hole(family: str, shapes: dict[str, list[Shape]]) -> None:
    for shape in shapes[family]:
        assert shape.mesh.euler_number == 2, shape.name


@pytest.mark.parametrize("family", FAMILIES)
def test_members_of_one_make_are_one_mesh_in_several_shapes(family: str, shapes: dict[str, list[Shape]]) -> None:
    made = [shape for shape in shapes[family] if shape.kind not in ("open", "laboratory", "hip", "sardine")]
    assert len(made) >= 6
    for shape in made[1:]:
        np.testing.assert_array_equal(shape.mesh.faces, made[0].mesh.faces)


def test_open_vessels_are_empty_above_their_floor_and_closed_things_are_full(shapes: dict[str, list[Shape]]) -> None:
    for shape in chain(*(shapes[family] for family in ("glass", "bowl", "vase", "jar", "flask"))):
        tall = shape.mesh.bounds[1, 2]
        axis = np.array([[1e-5, 2e-5, share * tall] for share in (0.55, 0.6, 0.8, 0.95)])
        assert (shape.mesh.contains(axis) == (shape.wall_m == 0)).all(), shape.name


def test_the_walls_of_glasses_bowls_and_vases_are_as_thick_as_they_say(shapes: dict[str, list[Shape]]) -> None:
    for shape in chain(*(shapes[family] for family in ("glass", "bowl", "vase"))):
        assert 0.001 <= shape.wall_m <= 0.008, shape.name
        if not np.isclose(*shape.mesh.extents[:2], rtol=0.01):
            continue  # the wall of an oval one is measured along x
        middle = shape.mesh.triangles_center
        side = (np.abs(shape.mesh.face_normals[:, 2]) < 0.3) & _within(middle[:, 2] / shape.mesh.bounds[1, 2], 0.5, 0.8)
        if side.sum() < 50:
            continue
        points, inward = middle[side], -shape.mesh.face_normals[side]
        start = points + 1e-6 * inward
        hits, ray, _ = shape.mesh.ray.intersects_location(start, inward, multiple_hits=False)
        thick = np.linalg.norm(hits - points[ray], axis=1)
        assert np.median(thick) == pytest.approx(shape.wall_m, rel=0.2), shape.name


def test_a_wine_glass_has_a_stem_thinner_than_its_foot_and_a_bowl_that_is_empty(
    shapes: dict[str, list[Shape]],
) -> None:
    for shape in shapes["wine_glass"]:
        mesh, tall = shape.mesh, float(shape.mesh.bounds[1, 2])
        radius = np.hypot(mesh.vertices[:, 0], mesh.vertices[:, 1])
        foot = radius[mesh.vertices[:, 2] < 0.003].max()
        levels = np.linspace(0.03, 0.6, 40) * tall
        width = [_half_width(mesh, level) for level in levels]
        stem = float(min(width))
        assert stem < 0.012 < 0.019 < foot, shape.name
        assert radius.max() > 1.5 * stem, shape.name
        thinnest = levels[int(np.argmin(width))]
        inside = mesh.contains([[1e-5, 2e-5, thinnest], [1e-5, 2e-5, 0.93 * tall]])
        assert inside.tolist() == [True, False], shape.name


def test_a_plate_is_flat_and_its_edge_is_higher_than_its_well(shapes: dict[str, list[Shape]]) -> None:
    for shape in shapes["plate"]:
        high = shape.mesh.bounds[1]
        down = _heights(shape.mesh, (1e-5, 2e-5))
        well = down.max()
        assert well < 0.6 * high[2], shape.name
        assert high[2] < 0.5 * high[0], shape.name
        assert 0.001 < np.ptp(down) < 0.008, shape.name
        assert down.min() > 0.0004, shape.name  # it stands on a foot ring, not on its middle


def test_a_can_is_full_and_its_lid_lies_below_its_seam(shapes: dict[str, list[Shape]]) -> None:
    for shape in shapes["can"]:
        low, high = _heights(shape.mesh, (1e-5, 2e-5))
        tall = shape.mesh.bounds[1, 2]
        assert low > 0.0005, shape.name
        assert tall - high > (0.0003 if shape.kind == "spray" else 0.0008), shape.name


def test_drinks_cans_are_narrower_at_both_ends_than_food_tins(shapes: dict[str, list[Shape]]) -> None:
    ends = {"drink": [], "food": []}
    for shape in shapes["can"]:
        if shape.kind in ends:
            tall, half = shape.mesh.bounds[1, 2], shape.mesh.bounds[1, 0]
            ends[shape.kind].append([_half_width(shape.mesh, z) / half for z in (0.001, tall - 0.002)])
    assert np.max(ends["drink"]) < 0.95 < np.min(ends["food"])


def test_a_tube_stands_on_its_cap_and_its_crimp_is_above_wide_and_flat(shapes: dict[str, list[Shape]]) -> None:
    for shape in shapes["tube"]:
        vertices, tall = shape.mesh.vertices, shape.mesh.bounds[1, 2]
        crimp = vertices[vertices[:, 2] > tall - 0.002]
        cap = vertices[vertices[:, 2] < 0.004]
        assert np.ptp(crimp[:, 0]) > 10 * np.ptp(crimp[:, 1]), shape.name
        assert 0.0008 < np.ptp(crimp[:, 1]) < 0.003, shape.name
        assert np.ptp(cap[:, 0]) == pytest.approx(np.ptp(cap[:, 1]), rel=0.01), shape.name
        assert np.ptp(cap[:, 0]) < np.ptp(crimp[:, 0]), shape.name


def test_a_tube_is_round_below_its_crimp() -> None:
    for seed in range(4):
        mesh = make_shape("tube", seed).mesh
        heights = np.unique(mesh.vertices[:, 2].round(6))
        height = heights[np.abs(heights - 0.3 * mesh.extents[2]).argmin()]
        ring = mesh.vertices[np.abs(mesh.vertices[:, 2] - height) < 1e-6]
        assert len(ring) == 56
        assert np.degrees(np.diff(np.sort(np.arctan2(ring[:, 1], ring[:, 0])))).max() < 10, seed


def test_a_hip_flask_is_flat_along_y_and_its_cap_is_round() -> None:
    flask = next(made for made in (make_shape("flask", seed) for seed in range(80)) if made.kind == "hip")
    assert flask.mesh.extents[1] < 0.5 * flask.mesh.extents[0]
    cap = flask.mesh.vertices[flask.mesh.vertices[:, 2] > flask.mesh.bounds[1, 2] - 0.008]
    assert np.ptp(cap[:, 0]) == pytest.approx(np.ptp(cap[:, 1]), rel=0.01)


def test_a_laboratory_flask_is_widest_below_and_open_through_a_narrow_neck() -> None:
    flask = next(made for made in (make_shape("flask", seed) for seed in range(80)) if made.kind == "laboratory")
    tall = flask.mesh.bounds[1, 2]
    assert _half_width(flask.mesh, 0.9 * tall) < 0.7 * _half_width(flask.mesh, 0.25 * tall)
    assert not flask.mesh.contains([[1e-5, 2e-5, 0.5 * tall], [1e-5, 2e-5, 0.97 * tall]]).any()


def test_a_matched_vessel_is_the_vessel_with_the_rings_that_were_asked_for() -> None:
    height = np.linspace(0.0, 0.1, 400)
    vessel = Vessel(height, 0.03 + 0.1 * height, wall=0.003, floor=0.006, dent=0.002)
    found = vessel.matched_mesh((8, 10, 30, 6, 40, 8), breaks_m=(0.02,))
    assert len(found.vertices) == 48 * (8 + 10 + 30 + 6 + 40 + 8 - 1) + 2
    assert found.is_volume
    assert found.volume == pytest.approx(vessel.mesh().volume, rel=0.01)
    assert found.bounds == pytest.approx(vessel.mesh().bounds, abs=2e-4)
    assert np.isclose(found.vertices[:, 2], 0.02, atol=2e-4).sum() >= 48  # the break is a ring


def test_a_profile_is_cut_at_its_landmarks_and_every_piece_has_an_edge() -> None:
    line = np.column_stack([np.linspace(0.0, 1.0, 11), np.zeros(11)])
    pieces = cut(line, [[0.31, 0.1], [0.31, 0.1], [5.0, 0.0]])
    assert [piece[-1, 0] for piece in pieces] == pytest.approx([0.3, 0.4, 0.9, 1.0])
    assert [piece[0, 0] for piece in pieces] == pytest.approx([0.0, 0.3, 0.4, 0.9])


def test_a_rounded_edge_takes_its_depth_off_at_the_bottom_and_nothing_above_its_reach() -> None:
    found = rounded_off(np.array([0.0, 0.004, 0.01, 0.02]), 0.01, 0.005)
    np.testing.assert_allclose(found, [0.005, 0.001, 0.0, 0.0], atol=1e-12)  # 3-4-5 triangle at 0.004


def test_steps_keep_the_ends_and_are_symmetric_and_closer_there() -> None:
    found = stepped(rows(np.full(9, 0.03), np.linspace(0.0, 0.08, 9)), 7)[:, 2]
    np.testing.assert_allclose(found[[0, 3, 6]], [0.0, 0.04, 0.08], atol=1e-12)
    steps = np.diff(found)
    np.testing.assert_allclose(steps, steps[::-1], atol=1e-12)
    assert steps[0] < steps[1] < steps[2]


def test_pieces_and_counts_of_unequal_number_are_a_mistake() -> None:
    with pytest.raises(ValueError, match="shorter"):
        matched([rows([1e-6, 0.03], [0, 0]), rows([0.03, 1e-6], [0.1, 0.1])], (3,))


def _within(values: np.ndarray, low: float, high: float) -> np.ndarray:
    return (values > low) & (values < high)


def _half_width(mesh: trimesh.Trimesh, height: float) -> float:
    """Greatest distance m from the axis where a horizontal plane meets the mesh."""
    section = np.reshape(trimesh.intersections.mesh_plane(mesh, [0, 0, 1], [0, 0, height + 1e-7]), (-1, 3))  # pyright: ignore
    return float(np.hypot(section[:, 0], section[:, 1]).max())


def _heights(mesh: trimesh.Trimesh, at: tuple[float, float]) -> np.ndarray:
    """Rising heights m where a vertical line meets the mesh."""
    return np.sort(mesh.ray.intersects_location([[*at, -1.0]], [[0, 0, 1]])[0][:, 2])
