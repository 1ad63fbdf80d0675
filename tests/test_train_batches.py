"""What the proposal network sees in training, number by number: clouds, and what they are said to be."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from moments import assert_known
from toy_examples import EXAMPLES, OTHERS

from gfp_grasp.detect import POOL_POINTS, seen_frame, size_of
from gfp_grasp.errors import InvalidOption
from gfp_grasp.train import Example, ProposalConfig, above_table
from gfp_grasp.train.proposal_batches import (
    Targets,
    _augmented,
    _fronts,
    _is_usable,
    augmented_batches,
    make_targets,
    placed_in_seen_frame,
    seen_cloud,
)
from gfp_grasp.train.proposal_data import TABLE, UP, Placed
from gfp_grasp.transforms import apply_T, rotation_about

EYE = np.array([0.4, 0.0, 0.3])


def _flat(points: np.ndarray, category: str = "a", subcategory: str = "") -> Example:
    return Example(points, EYE, category, subcategory, (category,), (category,), "upright", None)


def test_a_view_needs_thirty_points_above_the_table() -> None:
    points = np.zeros((60, 3))
    for count, usable in ((29, False), (30, True)):
        points[:count, 2] = 0.05
        points[count:, 2] = 0.001
        example = _flat(points.copy())
        assert _is_usable(example) is usable
        assert len(above_table(example)) == count
    assert len(above_table(_flat(np.zeros((5, 3))))) == 5


def test_targets_number_classes_and_kinds_in_their_order(tmp_path: Path) -> None:
    low = _flat(np.zeros((40, 3)), "cup", "flat")
    targets = make_targets([*EXAMPLES, low], OTHERS, ProposalConfig(), tmp_path)
    assert targets.num_views == 5
    assert targets.classes.tolist() == [
        [1, 0, 0, 0], [0.5, 0.5, 0, 0], [0, 1, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1],
    ]  # fmt: skip
    assert targets.kind.tolist() == [0, -1, 1, 2, 0, 3, 4]
    assert targets.class_of.tolist() == [0, 1, 0, 2, 3]
    assert targets.rests.tolist() == [0, 2, 0, 2, 0, 2, 0]
    assert targets.order.tolist() == [0, 1, 1, 4, 0, 0, 0]
    assert targets.pool.shape == (7, POOL_POINTS, 9)
    assert targets.pool.dtype == np.float16
    assert_known("pool", targets.pool)
    assert_known("pool units", targets.unit_m)


def test_an_answer_that_no_view_is_of_is_not_taught(tmp_path: Path) -> None:
    either = replace(EXAMPLES[2], answers=("mug", "bowl", "cup"))
    targets = make_targets([EXAMPLES[0], either], OTHERS, ProposalConfig(), tmp_path)
    assert targets.classes[:2].tolist() == [[1, 0, 0, 0], [0.5, 0.5, 0, 0]]
    assert targets.kind[:2].tolist() == [0, -1]


def test_pooled_clouds_are_the_points_above_the_table_in_the_seen_frame_and_their_own_unit(tmp_path: Path) -> None:
    targets = make_targets(EXAMPLES, OTHERS, ProposalConfig(), tmp_path)
    for example, cloud, unit_m in zip([*EXAMPLES, *OTHERS], targets.pool, targets.unit_m, strict=True):
        above = example.points[example.points[:, 2] > 0.006]
        T_world_seen = seen_frame(above, UP, TABLE, example.viewpoint)
        world = apply_T(T_world_seen, unit_m * cloud[:, :3].astype(float))
        distance = np.linalg.norm(world[:, None] - above, axis=2)
        assert distance.min(axis=1).max() < 1e-3 * unit_m
        assert set(distance.argmin(axis=1)) == set(range(len(above)))  # fewer than POOL_POINTS, so all are in
        away = np.sort(np.linalg.norm(cloud[:, :3].astype(float), axis=1))
        assert 0.9 * away[1079] + 0.1 * away[1080] == pytest.approx(1.0, rel=1e-3)  # nine tenths of 1199 is 1079.1
        normals = cloud[:, 6:].astype(float) @ T_world_seen[:3, :3].T
        assert ((normals * (example.viewpoint - world)).sum(axis=1) > -1e-2).all()
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1, atol=2e-3)


def test_the_pose_of_an_object_is_told_in_the_seen_frame(tmp_path: Path) -> None:
    points = np.array([[1.0, 2.0, 0.1], [1.2, 2.0, 0.1], [1.0, 2.4, 0.1], [1.2, 2.4, 0.1]])
    placed = Placed(rotation_about(UP, np.pi / 2), np.array([0.1, 0.2, 0.3]), np.array([1.2, 2.1, 0.15]), 3)
    viewer_along_y = np.array([1.1, 5.0, 0.5])
    example = replace(_flat(np.repeat(points, 30, axis=0)), viewpoint=viewer_along_y, placed=placed)
    truth = placed_in_seen_frame(example)
    # The seen frame's x is the world's y, its y the world's -x, and its zero is (1.1, 2.2, 0).
    np.testing.assert_allclose(truth.R, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(truth.centre, [-0.1, -0.1, 0.15], atol=1e-12)
    assert (truth.extents is placed.extents, truth.order) == (True, 3)
    targets = make_targets([example], OTHERS, ProposalConfig(), tmp_path)
    np.testing.assert_allclose(targets.R[0], np.eye(3), atol=1e-12)
    np.testing.assert_allclose(targets.box[0], [[-0.1, -0.1, 0.15], [0.1, 0.2, 0.3]], atol=1e-12)
    np.testing.assert_array_equal(targets.R[1], np.eye(3))
    assert np.isnan(targets.box[1:]).all()


def test_a_cloud_whose_viewpoint_or_table_is_unknown_says_so() -> None:
    example, rng = EXAMPLES[0], np.random.default_rng(0)
    known = seen_cloud(example, rng)
    assert known.shape == (POOL_POINTS, 9)
    assert known[:, 2].min() == pytest.approx(above_table(example)[:, 2].min())
    blind = seen_cloud(example, rng, viewpoint_known=False)
    assert not blind[:, 6:].any()
    np.testing.assert_allclose(np.ptp(blind[:, :3], axis=0), np.ptp(above_table(example), axis=0))  # not turned
    lifted = seen_cloud(replace(example, points=example.points + np.array([0, 0, 0.1])), rng, table_known=False)
    assert np.percentile(np.unique(lifted[:, 2]), 1) == pytest.approx(0.006, abs=1e-4)


def test_clouds_are_computed_once_for_the_same_examples_and_seed(tmp_path: Path) -> None:
    first = make_targets(EXAMPLES, OTHERS, ProposalConfig(), tmp_path)
    (file,) = tmp_path.glob("pool_*.npz")
    assert len(file.stem) == len("pool_") + 16
    np.savez(file, clouds=first.pool + 1, units=2 * first.unit_m)
    again = make_targets(EXAMPLES, OTHERS, ProposalConfig(), tmp_path)
    np.testing.assert_array_equal(again.pool, first.pool + 1)
    np.testing.assert_array_equal(again.unit_m, 2 * first.unit_m)
    assert not np.array_equal(make_targets(EXAMPLES, OTHERS, ProposalConfig(seed=1), tmp_path).pool, first.pool + 1)
    make_targets(EXAMPLES[1:], OTHERS, ProposalConfig(), tmp_path)
    assert len(list(tmp_path.glob("pool_*.npz"))) == 3


@pytest.mark.parametrize(("unknown_table", "unknown_viewpoint"), [(0.0, 1.0), (1.0, 0.0), (0.3, 0.2)])
def test_clouds_are_turned_stretched_cropped_and_thinned_as_ever(
    tmp_path: Path, unknown_table: float, unknown_viewpoint: float
) -> None:
    targets = make_targets(EXAMPLES, OTHERS, ProposalConfig(), tmp_path)
    config = ProposalConfig(batch=5, share=0.61, unknown_table=unknown_table, unknown_viewpoint=unknown_viewpoint)
    stream = augmented_batches(targets, config)(torch.Generator().manual_seed(2))
    batches = [next(stream) for _ in range(9)]
    for clouds, classes, kind, rests, fronts, poses in batches:
        assert (clouds.shape, clouds.dtype) == ((5, 256, 12), torch.float32)
        assert (fronts.shape, fronts.dtype) == ((5, 6, 3), torch.float32)
        assert (poses.shape, poses.dtype) == ((5, 3, 3), torch.float32)
        # Three of five are views of classes, each at most once.
        assert (classes[:3, :2].sum(dim=1) == 1).all()
        assert (kind[3:] >= 3).all()
        # Those have a box; of other things it is not known.
        assert poses[:3].isfinite().all()
        assert poses[3:, 1:].isnan().all()
        assert fronts[3:].isnan().all()
        assert ((rests == 0) | (rests == 2)).all()
    known = [bool(cloud[0, 11]) for cloud in torch.cat([clouds for clouds, *_ in batches])]
    assert np.mean(known) == pytest.approx(1 - unknown_viewpoint, abs=0.2 if 0 < unknown_viewpoint < 1 else 0)
    clouds, _, kinds, _, fronts, poses = (torch.stack(column).numpy() for column in zip(*batches, strict=True))
    assert_known(f"augmented clouds {unknown_table}", clouds, rel=1e-4)
    assert_known(f"augmented kinds {unknown_table}", kinds)
    assert_known(f"augmented fronts {unknown_table}", np.nan_to_num(fronts), rel=1e-4)
    assert_known(f"augmented poses {unknown_table}", np.nan_to_num(poses), rel=1e-4)


def _one_sample(order: float = 1) -> Targets:
    """One thing of which each point's place, in units of its size, is told again where its surface should be."""
    rng = np.random.default_rng(8)
    points = rng.uniform([-0.9, -0.5, 0.1], [1.1, 0.7, 1.5], (POOL_POINTS, 3))
    points /= size_of(points)
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    R = rotation_about((0.5, -0.2, 1.0), 0.8)
    return Targets(
        pool=np.column_stack([points, points, normals])[None],
        unit_m=np.array([0.2]),
        classes=np.ones((1, 1), dtype=np.float32),
        kind=np.array([0]),
        class_of=torch.tensor([0]),
        rests=np.array([0]),
        R=R[None],
        box=np.array([[[0.02, -0.03, 0.11], [0.3, 0.2, 0.5]]]),
        order=np.array([order]),
        num_views=1,
        floor_m=0.006,
    )


@pytest.mark.parametrize("unknown_table", [0.0, 1.0])
@pytest.mark.parametrize("unknown_viewpoint", [0.0, 1.0])
def test_a_turned_or_mirrored_cloud_has_turned_or_mirrored_targets(
    unknown_viewpoint: float, unknown_table: float
) -> None:
    targets = _one_sample()
    config = ProposalConfig(unknown_viewpoint=unknown_viewpoint, unknown_table=unknown_table)
    rng, found = np.random.default_rng(1), []
    unit_m, R, (centre_m, extents_m) = 0.2, targets.R[0], targets.box[0]
    for _ in range(60):
        cloud, fronts, (up, log_extents, centre) = _augmented(targets, 0, rng, config)
        assert cloud.shape == (256, 9)
        own = np.unique(cloud, axis=0)
        # Each point says where it was, so the move is known from the cloud alone, up to the noise that was added.
        was = np.column_stack([own[:, 3:6], np.ones(len(own))])
        affine = np.linalg.lstsq(was, own[:, :3], rcond=None)[0]
        scale_m = abs(np.linalg.det(affine[:3])) ** (1 / 3)
        move, size_m = affine[:3].T / scale_m, size_of(own[:, :3])
        assert 0.92 < scale_m / unit_m < 1.08
        noise = own[:, :3] - was @ affine
        assert 0 <= noise.std() / scale_m < 0.013
        np.testing.assert_allclose(move @ move.T, np.eye(3), atol=0.02)
        np.testing.assert_allclose(up, move @ R[:, 2], atol=0.01)
        np.testing.assert_allclose(fronts[0], move @ R[:, 0], atol=0.01)
        assert np.isnan(fronts[1:]).all()
        np.testing.assert_allclose(size_m * np.exp(log_extents), scale_m / unit_m * extents_m, rtol=0.01)
        np.testing.assert_allclose(size_m * centre, np.append(centre_m / unit_m, 1) @ affine, atol=0.01 * scale_m)
        if unknown_viewpoint:
            assert not own[:, 6:].any()
        else:  # normals have no noise: the move to the last digit
            was_normals = own[:, 3:6] / np.linalg.norm(own[:, 3:6], axis=1, keepdims=True)
            exact = np.linalg.lstsq(was_normals, own[:, 6:], rcond=None)[0].T
            np.testing.assert_allclose(exact @ exact.T, np.eye(3), atol=1e-9)
            np.testing.assert_allclose(exact @ R[:, [0, 2]], np.column_stack([fronts[0], up]), atol=1e-9)
            assert exact[0, 0] > 0.9  # the viewer stays where x is
            assert exact[2, 2] == pytest.approx(1.0)
        if unknown_table:
            assert np.percentile(own[:, 2], 1) == pytest.approx(0.006 * scale_m / unit_m, rel=0.1)
        else:
            assert abs(affine[3, 2]) < 0.08 * scale_m
        found.append(move)
    mirrored = np.array([np.linalg.det(move) for move in found]) < 0
    assert 15 < mirrored.sum() < 45
    headings = np.array([np.arctan2(move[1, 0], move[0, 0]) for move in found])
    if unknown_viewpoint:
        assert np.ptp(headings) > 5.0
        assert np.histogram(headings, 4, (-np.pi, np.pi))[0].min() > 5
    else:
        assert 0.05 < headings.std() < 0.12


@pytest.mark.parametrize(("order", "known"), [(0, 0), (1, 1), (2, 2), (4, 4), (6, 6)])
def test_samples_have_as_many_fronts_as_their_symmetry_says(order: int, known: int) -> None:
    _, fronts, _ = _augmented(_one_sample(order), 0, np.random.default_rng(0), ProposalConfig())
    assert np.isfinite(fronts).all(axis=1).tolist() == [k < known for k in range(6)]


def test_fronts_are_the_x_axis_and_its_turns_about_the_z_axis_of_the_object() -> None:
    R = rotation_about((1.0, 0.0, 0.0), np.pi / 2)  # lies: its x along x, its y along z, its z along -y
    x, y = np.eye(3)[0], np.eye(3)[2]
    nothing = [np.nan] * 3
    for order, wanted in ((0, []), (1, [x]), (2, [x, -x]), (4, [x, y, -x, -y])):
        found = _fronts(R, order)
        assert found.shape == (6, 3)
        np.testing.assert_allclose(found, [*wanted, *[nothing] * (6 - len(wanted))], atol=1e-12)
    # Mirrored, they turn the other way about.
    np.testing.assert_allclose(
        _fronts(np.diag([1.0, -1.0, 1.0]), 4)[:4], [x, -np.eye(3)[1], -x, np.eye(3)[1]], atol=1e-12
    )


def test_few_views_of_classes_are_a_batch_of_fewer(tmp_path: Path) -> None:
    targets = make_targets(EXAMPLES[:2], OTHERS, ProposalConfig(), tmp_path)
    stream = augmented_batches(targets, ProposalConfig(batch=10, share=0.5))(torch.Generator().manual_seed(0))
    assert len(next(stream)[0]) == 2 + 5


@pytest.mark.parametrize(
    "knobs",
    [
        *({"width": 1}, {"kinds": 1}, {"share": 0.01}, {"limit": None}),
        *({"unknown_table": 0.0}, {"unknown_table": 1.0}, {"unknown_viewpoint": 0.0}, {"unknown_viewpoint": 1.0}),
    ],
)
def test_a_config_at_the_edge_is_one(knobs: dict) -> None:
    assert ProposalConfig(**knobs)


@pytest.mark.parametrize("name", ["width", "channels", "views", "kinds", "members", "proxies", "steps"])
def test_a_config_of_nothing_is_refused(name: str) -> None:
    with pytest.raises(InvalidOption):
        ProposalConfig(**{name: 0})  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("knobs", [{"share": 0.0}, {"share": 1.0}, {"unknown_table": -0.1}, {"unknown_viewpoint": 1.1}])
def test_shares_that_are_none_are_refused(knobs: dict) -> None:
    with pytest.raises(InvalidOption):
        ProposalConfig(**knobs)
