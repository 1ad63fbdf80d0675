"""One look at an object: what the network is given, and that its answer moves with the object."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gfp_grasp.detect import Look, ProposalNet, features, look, seen_frame, size_of, turned_cloud, with_surface
from gfp_grasp.level import make_level_view, move_detection
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import make_starts
from gfp_grasp.register.starts import proposed_starts
from gfp_grasp.transforms import apply_T, invert_T, make_T, rotation_about
from gfp_grasp.types import Detection, OrientedBox, PointCloud, Proposal, SupportPlane

UP = np.array([0.0, 0.0, 1.0])
TABLE = SupportPlane(UP, 0.0)
EYE = np.array([0.5, 0.3, 0.4])


def _tube(rng: np.random.Generator) -> np.ndarray:
    angle, z = rng.uniform(0, np.pi, 900), rng.uniform(0.01, 0.12, 900)
    return np.column_stack([0.04 * np.cos(angle) + 0.2, 0.03 * np.sin(angle), z])


class _Says(ProposalNet):
    """Says the same of every cloud: lying, with its axis along the seen frame's x, front up, box a little off."""

    def forward(self, features: torch.Tensor) -> Look[torch.Tensor]:
        rows = (
            [[1.0, 0.0]],
            [[0.0, 0.0, 2.0]],
            [[0.9, 0.0, 0.0]],
            [[0.0, 0.0, 0.7]],
            [[0.0, -1.0, 0.5]],
            [[0.3, 0.1, 0.2]],
        )
        return Look(*(torch.tensor(row).expand(len(features), -1) for row in rows))


def test_the_seen_frame_stands_on_the_table_and_looks_at_the_viewer():
    points = _tube(np.random.default_rng(0))
    T = seen_frame(points, UP, TABLE, EYE)
    eye = apply_T(invert_T(T), EYE)
    assert eye[0] > 0.3
    assert abs(eye[1]) < 0.05
    local = apply_T(invert_T(T), points)
    assert local[:, 2].min() == pytest.approx(points[:, 2].min())
    low, high = np.percentile(local[:, :2], (1, 99), axis=0)
    np.testing.assert_allclose(low + high, 0, atol=1e-9)
    unknown = apply_T(invert_T(seen_frame(points, UP, None, EYE)), points)
    assert np.percentile(unknown[:, 2], 1) == pytest.approx(0.006)


def test_the_unit_is_the_distance_within_which_nine_in_ten_points_lie():
    rng = np.random.default_rng(0)
    away = rng.normal(size=(101, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    points = rng.permutation(101)[:, None] * away  # at 0, 1, .. 100 m from zero
    assert size_of(points) == pytest.approx(90.0)
    several = np.stack([points, 0.5 * points, points @ rotation_about((1, 2, 3), 0.7).T])
    np.testing.assert_allclose(size_of(several), [90.0, 45.0, 90.0])
    assert size_of(several[:, None, :1]).shape == (3, 1)
    half, level = np.array([[0.0, 0, 0], [0, 0, 0], [0, 3, 4]]), 0.8  # between the points it is linear
    assert size_of(half) == pytest.approx(5 * level)


@pytest.mark.parametrize("far_m", [0.4, 3.0, 50.0])
def test_a_few_flying_points_do_not_move_the_unit(far_m: float):
    rng = np.random.default_rng(0)
    away = rng.normal(size=(500, 3))
    away /= np.linalg.norm(away, axis=1, keepdims=True)
    shell, tube = 0.07 * away, _tube(rng) - np.array([0.2, 0.0, 0.0])
    assert size_of(shell) == pytest.approx(0.07)
    for cloud, tolerance in ((shell, 1e-9), (tube, 0.03)):
        flying = cloud.copy()
        flying[:20] *= far_m / np.linalg.norm(flying[:20], axis=1, keepdims=True)
        assert size_of(flying) == pytest.approx(size_of(cloud), rel=tolerance)
        # Nor do they move what the network is told of all the others.
        rows = with_surface(cloud, None)
        left = np.column_stack([flying, rows[:, 3:]])
        np.testing.assert_allclose(features(left)[20:], features(rows)[20:], rtol=max(tolerance, 1e-5), atol=tolerance)


def test_features_hold_size_apart_from_shape_and_say_whether_the_viewpoint_is_known():
    points = _tube(np.random.default_rng(0))
    cloud = with_surface(points, EYE)
    large = np.column_stack([7 * cloud[:, :3], cloud[:, 3:]])
    small, big = features(cloud), features(large)
    np.testing.assert_allclose(big[:, :10], small[:, :10], rtol=1e-5)
    np.testing.assert_allclose(big[:, 10] - small[:, 10], np.log(7), rtol=1e-5)
    np.testing.assert_allclose(small[0, :3], cloud[0, :3] / size_of(points), rtol=1e-5)
    assert (small[:, 11] == 1).all()
    assert (features(with_surface(points, None))[:, 11] == 0).all()


def test_normals_look_at_the_viewer_and_turn_with_the_cloud():
    points = _tube(np.random.default_rng(1))
    cloud = with_surface(points, EYE)
    towards = EYE - points
    assert ((cloud[:, 6:] * towards).sum(axis=1) >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(cloud[:, 6:], axis=1), 1)
    mirror = np.diag([1.0, -1.0, 1.0])
    again = with_surface(points @ mirror.T, mirror @ EYE)
    np.testing.assert_allclose(turned_cloud(cloud, mirror)[:, :6], again[:, :6], atol=1e-9)
    assert not with_surface(points, None)[:, 6:].any()


def test_the_proposal_is_what_the_network_says_in_the_world():
    points = _tube(np.random.default_rng(2))
    network = _Says(2, width=2)
    seen = look(points, UP, TABLE, viewpoint=EYE, network=network)
    T = seen_frame(points, UP, TABLE, EYE)
    size = float(size_of(apply_T(invert_T(T), points)))
    np.testing.assert_allclose(seen.box.extents, size * np.exp([0.0, -1.0, 0.5]), rtol=0.02)
    np.testing.assert_allclose(seen.box.T_world_box[:3, 2], T[:3, 0], atol=1e-6)
    np.testing.assert_allclose(seen.box.T_world_box[:3, 0], UP, atol=1e-6)
    np.testing.assert_allclose(seen.box.T_world_box[:3, 3], apply_T(T, size * np.array([0.3, 0.1, 0.2])), atol=2e-3)
    assert seen.sure_of_front == pytest.approx(0.7)
    assert seen.rests == {
        "upright": pytest.approx(np.exp(0) / (2 + np.exp(2))),
        "upside_down": pytest.approx(np.exp(0) / (2 + np.exp(2))),
        "lying": pytest.approx(np.exp(2) / (2 + np.exp(2))),
    }


def test_the_look_moves_with_the_object_and_its_viewer():
    points = _tube(np.random.default_rng(3))
    torch.manual_seed(0)
    network = ProposalNet(16, width=8).eval()
    here = look(points, UP, TABLE, viewpoint=EYE, network=network)
    assert np.linalg.norm(here.embedding) == pytest.approx(1.0)
    T = make_T(rotation_about(UP, 1.1), (0.3, -0.2, 0.0))
    there = look(apply_T(T, points), UP, TABLE, viewpoint=apply_T(T, EYE), network=network)
    np.testing.assert_allclose(there.embedding, here.embedding, atol=1e-5)
    np.testing.assert_allclose(there.box.T_world_box, T @ here.box.T_world_box, atol=1e-4)
    np.testing.assert_allclose(there.box.extents, here.box.extents, rtol=1e-4)


def test_without_a_viewpoint_a_quarter_turn_is_not_seen():
    points = _tube(np.random.default_rng(4))
    torch.manual_seed(0)
    network = ProposalNet(16, width=8).eval()
    turned = points @ np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])
    here, there = (look(p, UP, TABLE, network=network).embedding for p in (points, turned))
    np.testing.assert_allclose(there, here, atol=1e-5)


def _detection(points: np.ndarray, proposal: Proposal | None) -> Detection:
    box = OrientedBox(make_T(None, points.mean(axis=0)), np.ptp(points, axis=0))
    return Detection(PointCloud(points, EYE), UP, TABLE, "mug", {}, box, proposal=proposal)


def test_a_proposal_moves_with_its_detection():
    box = OrientedBox(make_T(rotation_about(UP, 0.4), (0.1, 0.0, 0.05)), np.array([0.1, 0.08, 0.09]))
    proposal = Proposal(box, {"upright": 1.0}, 0.9, ("mug",), np.zeros(2))
    T = make_T(rotation_about((1, 0, 0), 0.7), (0.0, 0.4, 0.1))
    moved = move_detection(_detection(_tube(np.random.default_rng(5)), proposal), T).proposal
    assert moved is not None
    np.testing.assert_allclose(moved.box.T_world_box, T @ box.T_world_box)
    assert (moved.sure_of_front, moved.classes) == (0.9, ("mug",))


@pytest.fixture(scope="module")
def mug():
    return PrimitiveLibrary.shipped().primitive("mug")


def _proposal(**changes) -> Proposal:
    box = OrientedBox(make_T(rotation_about(UP, 2.0), (0.2, 0.01, 0.06)), np.array([0.12, 0.09, 0.1]))
    return replace(
        Proposal(box, {"upright": 0.97, "upside_down": 0.02, "lying": 0.01}, 0.95, ("mug",), np.zeros(2)), **changes
    )


def test_a_sure_proposal_is_the_only_start_and_fills_its_box_on_the_table(mug):
    proposal = _proposal()
    evidence = make_level_view(_detection(_tube(np.random.default_rng(6)), proposal))
    (state,) = proposed_starts(mug, evidence, ("upright", "upside_down", "lying"))
    world = apply_T(evidence.T_world_level, state.world(mug.vertices))
    assert world[:, 2].min() == pytest.approx(0.0, abs=1e-9)
    local = apply_T(invert_T(proposal.box.T_world_box), world)
    np.testing.assert_allclose(np.ptp(local, axis=0), [0.12, 0.09, 0.1], rtol=1e-6)
    np.testing.assert_allclose((local.min(axis=0) + local.max(axis=0))[:2], 0, atol=1e-9)
    assert local[mug.on_part][:, 0].min() > 0.01  # the handle is at the box's front
    assert state.hypothesis == "upright"


def test_what_the_proposal_leaves_open_is_tried(mug):
    points, ways = _tube(np.random.default_rng(7)), ("upright", "upside_down", "lying")

    def starts(proposal: Proposal | None) -> list:
        return proposed_starts(mug, make_level_view(_detection(points, proposal)), ways)

    assert len(starts(_proposal(sure_of_front=0.5))) == 8
    doubtful = starts(_proposal(rests={"upright": 0.7, "upside_down": 0.26, "lying": 0.04}))
    assert [state.hypothesis for state in doubtful] == ["upright"] + 8 * ["upside_down"]
    everything = make_starts(mug, make_level_view(_detection(points, None)), ways)
    assert len(starts(None)) == len(starts(_proposal(classes=("cup",)))) == len(everything)


def test_what_is_cut_off_starts_as_long_as_its_class_in_the_ways_that_are_proposed(mug):
    evidence = make_level_view(
        _detection(
            _tube(np.random.default_rng(7)), _proposal(rests={"upright": 0.7, "upside_down": 0.26, "lying": 0.04})
        )
    )
    cut = replace(evidence, cut=np.array([0.0, 0.0, 1.0]))
    ways = ("upright", "upside_down", "lying")
    found, expected = proposed_starts(mug, cut, ways), make_starts(mug, cut, ways[:2])
    assert [state.hypothesis for state in found] == 8 * ["upright"] + 8 * ["upside_down"]
    for state, other in zip(found, expected, strict=True):
        np.testing.assert_array_equal(state.log_scale, other.log_scale)


def test_a_lying_object_is_proposed_with_its_axis_level_and_starts_from_its_boxes_too(mug):
    box = OrientedBox(
        make_T(rotation_about((0, 1, 0), np.radians(80.0)), (0.2, 0.01, 0.05)), np.array([0.12, 0.09, 0.1])
    )
    proposal = _proposal(box=box, rests={"upright": 0.01, "upside_down": 0.0, "lying": 0.99})
    evidence = make_level_view(_detection(_tube(np.random.default_rng(8)), proposal))
    state, *boxes = proposed_starts(mug, evidence, ("upright", "upside_down", "lying"))
    assert {start.hypothesis for start in (state, *boxes)} == {"lying"}
    for start, other in zip(boxes, make_starts(mug, evidence, ("lying",)), strict=True):
        np.testing.assert_array_equal(start.R, other.R)
    np.testing.assert_allclose(evidence.T_world_level[:3, :3] @ state.R[:, 2], [1.0, 0.0, 0.0], atol=1e-9)
    assert (state.world(mug.vertices) @ evidence.up).min() == pytest.approx(evidence.floor_m, abs=1e-9)
