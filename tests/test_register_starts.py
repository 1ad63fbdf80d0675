"""Where the fit starts from a wedge that stands, lies or is cut off, and how PCRNet moves the starts."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from scipy.spatial.transform import Rotation
from standing_wedge import half_seen_wedge, posed_mesh, standing_wedge, surface_points, whole_view
from toy_wedge import UP, toy_evidence, wedge_primitive

from gfp_grasp.register import make_starts, pcrnet
from gfp_grasp.register.starts import _complete_ends, _cosine_in_picture
from gfp_grasp.transforms import rotation_about, rotation_between
from gfp_grasp.types import Symmetry


@pytest.mark.parametrize("hypothesis", ["upright", "upside_down"])
def test_a_standing_start_is_the_truth_where_the_whole_surface_is_seen(hypothesis):
    axis = UP if hypothesis == "upright" else -UP
    R = rotation_between((0, 0, 1), axis) @ rotation_about((0, 0, 1), 0.8)
    truth, primitive = standing_wedge(R), wedge_primitive()
    evidence = whole_view(truth, primitive, truth.t + 2 * R[:, 0] + UP)
    found = make_starts(primitive, evidence, (hypothesis,))
    assert len(found) == 8
    best = min(found, key=lambda state: np.abs(state.R - R).max())
    # The direction to the viewer is taken from the middle of the points, a few centimetres off the axis.
    assert np.abs(best.R - R).max() < 0.03
    assert np.abs(best.t - truth.t).max() < 0.003
    assert np.abs(best.log_scale).max() < 0.06
    assert not best.coefficients.any()
    turns = sorted(Rotation.from_matrix(best.R.T @ state.R).as_rotvec()[2] for state in found)
    assert np.diff(turns) == pytest.approx(np.pi / 4)
    for state in found:
        assert state.R[:, 2] == pytest.approx(axis)
        assert state.axis_world == pytest.approx(axis)
        assert state.axis_sigma_rad == pytest.approx(np.deg2rad(1))
        assert state.hypothesis == hypothesis


def test_a_standing_start_reaches_down_to_the_floor():
    R = rotation_between((0, 0, 1), UP)
    truth, primitive = standing_wedge(R), wedge_primitive()
    evidence = whole_view(truth, primitive, truth.t + 2 * R[:, 0])
    lower = replace(evidence, floor_m=evidence.floor_m - 0.01)
    for hypothesis in ("upright", "upside_down"):
        for near, far in zip(*(make_starts(primitive, e, (hypothesis,)) for e in (evidence, lower)), strict=True):
            ends = [np.quantile(posed_mesh(state, primitive).vertices @ UP, (0, 1)) for state in (near, far)]
            assert ends[0][0] == pytest.approx(evidence.floor_m, abs=0.001)
            assert ends[1][0] == pytest.approx(evidence.floor_m - 0.01, abs=0.001)
            assert ends[0][1] == pytest.approx(ends[1][1], abs=1e-6)


def test_the_near_side_of_a_start_is_the_near_side_of_the_points():
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    truth, primitive = standing_wedge(R), wedge_primitive()
    whole = whole_view(truth, primitive, truth.t + 2 * R[:, 0])
    half = whole.points @ R[:, 0] > np.median(whole.points @ R[:, 0])
    evidence = replace(whole, points=whole.points[half], normals=whole.normals[half])
    bound = 2 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    found = [s for s in make_starts(primitive, evidence, ("upright",)) if (np.abs(s.log_scale) < bound - 1e-9).all()]
    assert len(found) >= 2
    for state in found:
        nearest = float((posed_mesh(state, primitive).vertices @ R[:, 0]).max())
        assert nearest == pytest.approx(float((whole.points @ R[:, 0]).max()), abs=0.004)


def test_a_lying_start_is_the_truth_of_a_long_body():
    # The wedge's z is made its longest side, and it lies with x up.
    flat = np.cross(UP, (0.4, 1.0, 0.2))
    axis = flat / np.linalg.norm(flat)
    R = np.column_stack([UP, np.cross(axis, UP), axis])
    primitive = wedge_primitive()
    longer = replace(primitive, vertices=primitive.vertices * (0.5, 0.5, 4.0), modes=primitive.modes * 0.1)
    truth = replace(standing_wedge(R))
    evidence = whole_view(truth, longer, truth.t + 2 * np.cross(axis, UP) + UP)
    found = make_starts(longer, evidence, ("lying",))[:4]
    best = min(found, key=lambda state: np.abs(state.R - R).max())
    assert np.abs(best.R - R).max() < 0.1
    assert np.abs(best.t - truth.t).max() < 0.02
    assert np.abs(best.log_scale).max() < 0.1
    heights = posed_mesh(best, longer).vertices @ UP
    assert heights.min() == pytest.approx(evidence.floor_m, abs=1e-6)
    assert heights.max() == pytest.approx(float((evidence.points @ UP).max()), abs=0.004)
    assert best.axis_sigma_rad == pytest.approx(np.deg2rad(15))
    directions = np.array([state.R[:, 2] for state in found])
    assert directions @ UP == pytest.approx(np.zeros(4), abs=1e-12)
    assert directions.sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-12)
    assert np.sort(np.abs(directions @ axis)) == pytest.approx([0, 0, 1, 1], abs=0.1)


@pytest.mark.parametrize(("share", "num_flat"), [(1.8, 2), (1.1, 0)])
def test_a_body_that_lies_wider_than_high_has_flat_starts_too(share, num_flat):
    flat = np.cross(UP, (0.4, 1.0, 0.2))
    axis = flat / np.linalg.norm(flat)
    R = np.column_stack([UP, np.cross(axis, UP), axis])
    primitive = wedge_primitive()
    extent = np.ptp(primitive.vertices, axis=0)
    # It lies with x up; y is made wider than x, and z much longer than both.
    stretch = np.array([1.0, share * extent[0] / extent[1], 4 * extent[0] / extent[2]])
    spread = 0.3 * np.eye(3)  # a class whose members differ as much as that
    longer = replace(primitive, vertices=primitive.vertices * stretch, log_scale_cov=spread)
    truth = replace(standing_wedge(R))
    evidence = whole_view(truth, longer, truth.t + 2 * np.cross(axis, UP) + UP)
    found = make_starts(longer, evidence, ("lying",))
    # Across the long side the points are wider than high in any case.
    along = [state for state in found[4:] if abs(state.R[:, 2] @ axis) > 0.9]
    assert (len(along), len(found)) == (num_flat, 6 + num_flat)
    for state in along:
        own, seen = posed_mesh(state, longer).vertices @ state.R, evidence.points @ state.R
        assert state.R[:, 0] == pytest.approx(UP, abs=1e-9)
        assert np.ptp(own, axis=0) == pytest.approx(np.ptp(seen, axis=0), rel=0.05)
        assert own.max(axis=0) == pytest.approx(seen.max(axis=0), abs=0.01)
    for state in found[:4]:
        assert state.log_scale[0] == state.log_scale[1]


@pytest.mark.parametrize(
    ("order", "turns_deg"),
    [(np.inf, [0, 45]), (2, [0, 60, 120]), (4, [0, 30, 60]), (1, [0, 45, 90, 135, 180, 225, 270, 315])],
)
def test_starts_are_turned_by_what_the_symmetry_does_not_hide(order, turns_deg):
    primitive = replace(wedge_primitive(), symmetry=Symmetry(np.array([0.0, 0, 1]), order))
    truth = standing_wedge(rotation_between((0, 0, 1), UP))
    evidence = whole_view(truth, primitive, truth.t + np.array([2.0, 0.3, 1.0]))
    found = make_starts(primitive, evidence, ("upright",))
    turned = [Rotation.from_matrix(found[0].R.T @ state.R).as_rotvec(degrees=True)[2] % 360 for state in found]
    assert turned == pytest.approx(turns_deg, abs=1e-6)


def test_a_start_is_no_larger_or_smaller_than_twice_the_spread_of_the_class():
    primitive = wedge_primitive()
    truth = standing_wedge(rotation_between((0, 0, 1), UP))
    huge = replace(truth, log_scale=np.full(3, 2.0))
    bound = 2 * np.sqrt(np.diag(primitive.log_scale_cov) + 1e-4)
    for state, sign in ((huge, 1), (replace(truth, log_scale=np.full(3, -2.0)), -1)):
        for start in make_starts(primitive, whole_view(state, primitive, truth.t + 9.0), ("upright",)):
            assert start.log_scale == pytest.approx(sign * bound)


def test_seen_from_straight_above_the_shortest_side_of_the_points_faces_the_viewer():
    R = rotation_between((0, 0, 1), UP) @ rotation_about((0, 0, 1), 0.8)
    primitive = wedge_primitive()
    truth = standing_wedge(R)
    points, normals = surface_points(truth, primitive)
    for viewpoint in (None, points.mean(axis=0) + 2.0 * UP):
        view = toy_evidence(points, normals, viewpoint=viewpoint, oriented=viewpoint is not None)
        state = make_starts(primitive, view, ("upright",))[0]
        assert state.R[:, 2] == pytest.approx(UP)
        assert abs(state.R[:, 0] @ R[:, 1]) > 0.95  # the wedge is 12 cm along x and 8 along y


@pytest.mark.parametrize(
    ("up", "across", "height", "width"),
    [
        (0.1, 0.2, (0.0, 1.0), (-0.5, 0.5)),
        (0.9, 0.0, (0.0, 2.0), (-0.5, 0.5)),  # as high as it is wide, by the primitive's proportions
        (-0.9, 0.0, (-1.0, 1.0), (-0.5, 0.5)),
        (0.0, 0.6, (0.0, 1.0), (-0.5, 0.75)),
        (0.0, -0.6, (0.0, 1.0), (-0.75, 0.5)),
        (0.6, -0.6, (0.0, 2.0), (-2.0, 0.5)),  # nothing but the primitive's own size is known
    ],
)
def test_an_end_that_is_hidden_goes_on_to_the_proportions_of_the_primitive(up, across, height, width):
    own_height, own_width = 2.0, 2.5 if up and across and abs(up) > 0.5 and abs(across) > 0.5 else 1.0
    if abs(across) > 0.5 and abs(up) < 0.5:
        own_height, own_width = 0.8, 1.0
    found = _complete_ends((0.0, 1.0), own_height, up, (-0.5, 0.5), own_width, across)
    assert found[0] == pytest.approx(height)
    assert found[1] == pytest.approx(width)


def test_what_is_cut_off_was_never_seen_whole():
    """The primitive is shorter than what was seen: a seventh of the object is hidden all the same."""
    assert _complete_ends((0.0, 1.7), 1.0, 0.9, (-0.5, 0.5), 1.0, 0.0) == ((0.0, pytest.approx(2.0)), (-0.5, 0.5))


def test_a_start_of_what_is_cut_off_goes_on_beyond_the_cut_and_only_there():
    R = rotation_between((0, 0, 1), UP)
    truth, primitive = standing_wedge(R), wedge_primitive()
    viewpoint = truth.t + 2 * R[:, 0]
    whole = whole_view(truth, primitive, viewpoint)
    aside = whole.points @ R[:, 1]
    for sign in (1, -1):
        seen = sign * aside < np.median(sign * aside)
        half = replace(whole, points=whole.points[seen], normals=whole.normals[seen])
        tilted = sign * (R[:, 1] + 0.1 * UP)
        cut = replace(half, cut=tilted / np.linalg.norm(tilted))
        state = make_starts(primitive, cut, ("upright",))[0]
        found = np.quantile(posed_mesh(state, primitive).vertices @ R[:, 1], (0, 1))
        assert found == pytest.approx((aside.min(), aside.max()), abs=0.012)


def test_a_direction_is_compared_with_the_cut_as_it_is_seen():
    points = np.random.default_rng(0).normal(scale=0.01, size=(50, 3))
    points -= points.mean(axis=0)
    evidence = toy_evidence(points, viewpoint=np.array([2.0, 0, 0]), cut=np.array([0.0, 0.6, 0.8]))
    for direction, cosine in (((0.8, 0.6, 0.0), 0.6), ((-0.8, 0.6, 0.0), 0.6), ((0.6, 0.0, -0.8), -0.8)):
        assert _cosine_in_picture(evidence, np.array(direction)) == pytest.approx(cosine)


# ---- PCRNet


def test_the_network_moves_starts_in_its_own_upright_unit_frame(monkeypatch):
    _, evidence = half_seen_wedge()
    turn, shift, seen = Rotation.from_rotvec([0.1, -0.2, 0.3]).as_matrix(), np.array([0.2, -0.1, 0.05]), []

    def network(template, cloud):
        seen.extend([template.numpy(), cloud.numpy()])
        size = (len(template), 1, 1)
        return torch.tensor(turn, dtype=torch.float32).repeat(size), torch.tensor(shift).float().repeat(size[:2])

    monkeypatch.setattr(pcrnet, "load_pcrnet", lambda weights: network)
    states = make_starts(wedge_primitive(), evidence, ("upright",))[:2]
    moved = pcrnet.correct_starts(states, wedge_primitive(), evidence)
    template, cloud = seen
    assert template.shape == cloud.shape == (2, 128, 3)
    to_level = rotation_between(UP, (0, 0, 1))
    for i, (before, after) in enumerate(zip(states, moved, strict=True)):
        assert template[i].mean(axis=0) == pytest.approx(np.zeros(3), abs=1e-5)
        assert (template[i] ** 2).sum(axis=1).mean() == pytest.approx(1, rel=1e-5)
        _, _, centre, radius = pcrnet.network_input(before, wedge_primitive(), evidence.points)
        # The cloud is there in the units of the template, and points of it are points that were seen.
        back = centre + radius * cloud[i].astype(np.float64) @ to_level
        assert KDTree(evidence.points).query(back)[0].max() < 1e-6
        # What the network does to the template there, it does to the start here.
        vertices = wedge_primitive().vertices[::50]
        there = ((before.world(vertices) - centre) / radius) @ to_level.T
        expected = centre + radius * (there @ turn.T + shift) @ to_level
        assert after.world(vertices) == pytest.approx(expected, abs=1e-5)
        assert np.array_equal(after.log_scale, before.log_scale)
    assert pcrnet.correct_starts([], wedge_primitive(), evidence) == []


def test_poses_of_all_iterations_are_put_together():
    network = pcrnet.PCRNet()
    pose = np.array([0.9, 0.1, -0.2, 0.3, 0.05, -0.04, 0.1])
    seen = []

    class Encoder(torch.nn.Module):
        def forward(self, points):
            seen.append(points.detach().numpy())
            return torch.zeros(1, points.shape[1], 1024)

    class Decoder(torch.nn.Module):
        def forward(self, code):
            return torch.tensor(pose, dtype=torch.float32)[None]

    network.encode, network.decode = Encoder(), Decoder()  # type: ignore[assignment]
    template = torch.tensor(np.random.default_rng(0).normal(size=(1, 7, 3)), dtype=torch.float32)
    R, t = network(template, template + 1, iterations=3)
    turn = Rotation.from_quat(pose[:4], scalar_first=True).as_matrix()
    assert R[0].numpy() == pytest.approx(np.linalg.matrix_power(turn, 3), abs=1e-5)
    assert t[0].numpy() == pytest.approx(pose[4:] + turn @ pose[4:] + turn @ turn @ pose[4:], abs=1e-5)
    cloud, *moved = seen
    assert np.allclose(cloud, template.numpy() + 1)
    assert len(moved) == 3
    for before, after in pairwise(moved):
        assert after[0] == pytest.approx(before[0] @ turn.T + pose[4:], abs=1e-5)
