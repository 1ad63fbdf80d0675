"""Things told apart by votes: what the network looks at, how votes become labels, and how those meet the geometry."""

import hashlib
import json

import numpy as np
import pytest
import trimesh
from placed_boxes import box, together

from gfp_grasp.assets import data_file
from gfp_grasp.camera import SensorModel, apply_sensor, intrinsics, render_mesh_view
from gfp_grasp.detect import DetectConfig, InstanceNet, Votes, detect_objects, gather_votes, level_picture, vote
from gfp_grasp.detect import instance_features as features_of
from gfp_grasp.detect.instances import PITCH_M, load_instances
from gfp_grasp.detect.learned import label_by_votes
from gfp_grasp.detect.tables import Table
from gfp_grasp.transforms import look_at, make_T, rotation_about
from gfp_grasp.types import TABLETOP, DepthImage, SupportPlane

WHOLE_OUTLINE = np.array([[1.0, 0.0, -9.0], [-1.0, 0.0, -9.0], [0.0, 1.0, -9.0], [0.0, -1.0, -9.0]])
TABLE = SupportPlane(np.array([0.0, 0.0, 1.0]), 0.2)
WHOLE = Table(TABLE, WHOLE_OUTLINE, 0.015, 0.15)
UP = np.array([0.0, 0.0, 1.0])
EYE = np.array([0.1, -0.6, 0.75])


def iou(a: np.ndarray, b: np.ndarray) -> float:
    return float((a & b).sum() / (a | b).sum())


def moved(support: SupportPlane, T: np.ndarray) -> SupportPlane:
    normal = T[:3, :3] @ support.normal
    return SupportPlane(normal, support.height_m + float(normal @ T[:3, 3]))


def picture(*things: trimesh.Trimesh, eye=EYE) -> tuple[DepthImage, np.ndarray]:
    """What a camera sees of things on the table, and the number (h, w) of the thing in each pixel, from 1 on."""
    image, index = render_mesh_view(
        things,
        T_world_camera=look_at(eye, (0.0, 0.0, 0.22)),
        K=intrinsics(320, 240, 45.0),
        width=320,
        height=240,
        table_height=0.2,
    )
    image = apply_sensor(image, SensorModel.gaussian(0.0005), np.random.default_rng(0))
    return image, np.where(index < len(things), index + 1, 0)


def test_level_picture_has_z_from_the_support_and_y_away_from_the_camera() -> None:
    image, labels = picture(box((0.2, 0.1, 0.06), (0.05, 0.0, 0.2), 20))
    turn = make_T(rotation_about((1, 2, 0.5), 0.8), (3.0, -2.0, 1.0))
    for view, support in ((image, TABLE), (image.moved(turn), moved(TABLE, turn))):
        level = level_picture(view, support)
        top = level[labels == 1]
        assert np.median(level[labels == 0][:, 2]) == pytest.approx(0.0, abs=5e-4)
        assert np.quantile(top[:, 2], 0.95) == pytest.approx(0.06, abs=1.5e-3)
        # The camera's way over the ground is (-0.1, 0.6) m long, and the box's middle is (-0.05, 0.6) m from it.
        assert top[top[:, 2] > 0.055][:, :2].mean(axis=0) == pytest.approx((0.0493, 0.6001), abs=0.008)


def test_level_picture_of_a_camera_that_looks_straight_down_has_y_up_in_the_picture() -> None:
    image, _ = picture(box((0.2, 0.1, 0.06), (0.0, 0.0, 0.2)), eye=np.array([0.0, -1e-4, 0.9]))
    level = level_picture(image, TABLE)
    assert level[20, 160, 1] > 0.15 > -0.15 > level[220, 160, 1]
    assert level[120, 300, 0] > 0.15 > -0.15 > level[120, 20, 0]


def test_features_are_positions_in_decimetres_normals_and_pitch() -> None:
    image, labels = picture(box((0.2, 0.14, 0.06), (0.05, 0.0, 0.2), 20))
    level = level_picture(image, TABLE)
    level[:30] = np.nan
    features, above = features_of(level, 2 * PITCH_M)
    assert features.shape == (8, 240, 320)
    assert features.dtype == np.float32
    middle = level[above][:, :2].mean(axis=0)
    assert features[:2, 150, 40] == pytest.approx((level[150, 40, :2] - middle) / 0.1, abs=1e-4)
    assert features[2, 150, 40] == pytest.approx(level[150, 40, 2] / 0.1, abs=1e-5)
    assert (features[:7, :30] == 0).all()
    assert (features[6, 30:] == 1).all()
    assert np.allclose(features[7], np.log(2.0))
    table = (labels == 0) & (np.arange(240)[:, None] > 40)
    assert np.median(features[5][table]) > 0.98  # up
    assert np.median(features[4][(labels == 1) & (features[5] < 0.3)]) < -0.8  # the front looks at the camera
    inside = np.zeros_like(above)
    inside[5:-5, 5:-5] = True
    assert (above == (labels == 1))[inside & (np.arange(240)[:, None] > 40)].mean() > 0.99


def test_votes_for_one_place_are_one_thing_wherever_their_pixels_lie() -> None:
    labels = np.zeros((30, 60), dtype=int)
    labels[5:20, 4:20] = 1
    labels[5:20, 40:56] = 1  # the same bar, beyond what stands before it
    labels[5:20, 20:40] = 2
    middles = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.02], [0.3, 0.05, 0.02]])
    rng = np.random.default_rng(0)
    places = middles[labels] + rng.normal(scale=0.002, size=(*labels.shape, 3))
    votes = Votes(places, np.full(labels.shape, 0.015), np.where(labels > 0, rng.uniform(0.6, 0.9, labels.shape), 0.1))
    found = gather_votes(votes, np.ones(labels.shape, dtype=bool))
    assert set(np.unique(found)) == {0, 1, 2}
    for k in (1, 2):
        own = labels == k
        assert len(np.unique(found[own])) == 1
        assert (found == found[own][0]).sum() == own.sum()


def test_a_few_pixels_and_what_is_left_of_another_thing_are_no_thing() -> None:
    labels = np.zeros((20, 20), dtype=int)
    labels[2:12, 2:12] = 1
    labels[15:17, 15:18] = 2  # six pixels
    places = np.array([[0.0, 0.0, 0.0], [0.3, 0.0, 0.0], [0.0, 0.3, 0.0]])[labels]
    places[6, 4] = (0.296, 0.0, 0.0)
    places[2:12, 9:12] = (0.315, 0.0, 0.0)  # beyond the best seed's bell, which reaches 17.7 mm
    seed = np.where(labels > 0, 0.6, 0.0)
    seed[6, 4] = 0.9
    found = gather_votes(Votes(places, np.full(labels.shape, 0.015), seed), labels > 0)
    assert found[6, 4] == 1
    assert (found == 1).sum() == 70
    assert (found[labels == 2] == 0).all()
    # The bell of the thirty beside it holds seventy of the first thing: they are its leftover.
    assert (found[2:12, 9:12] == 0).all()


def labelled(image: DepthImage, table: Table) -> np.ndarray:
    points = image.points()
    return label_by_votes(image, points, table, table.beyond_m(np.nan_to_num(points)), sensor=TABLETOP)


def say(monkeypatch: pytest.MonkeyPatch, labels: np.ndarray, *, seed: np.ndarray | None = None) -> None:
    """The network's votes: pixels of thing k vote for a place 0.2 m from that of thing k - 1, if seed says so."""
    seed = np.where(labels > 0, 0.9, 0.1) if seed is None else seed
    votes = Votes(0.2 * labels[..., None] * [1.0, 0.0, 0.0], np.full(labels.shape, 0.03), seed)

    def answer(image: DepthImage, support: SupportPlane, window: tuple[slice, slice], pitch_m: float):
        return Votes(votes.places[window], votes.spread_m[window], votes.seed[window]), labels[window]

    monkeypatch.setattr("gfp_grasp.detect.learned._votes", answer)


def test_pieces_that_vote_for_one_place_are_one_thing_and_edges_are_those_of_the_surface(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    # A wedge behind a post: the faces of its two sides lie in two planes, so geometry leaves them two.
    sides = [box((0.12, 0.02, 0.08), (0.06 * side, 0.1, 0.2), 35 * side) for side in (-1, 1)]
    post = box((0.03, 0.03, 0.2), (0.01, -0.02, 0.2))
    image, labels = picture(together(sides), post)
    assert len(detect_objects(image, up=UP, config=DetectConfig(classify=False))) == 3
    edge = int(np.flatnonzero((labels == 2).any(axis=0))[-2])  # the votes take the post's right edge for the wedge's
    said = np.where((labels == 2) & (np.arange(320) >= edge), 1, labels)
    say(monkeypatch, said)
    found = labelled(image, WHOLE)
    assert found.max() == 2
    # The lowest 6 mm of a thing are the table's.
    for k in (1, 2):
        assert max(iou(labels == k, found == n) for n in (1, 2)) > 0.88


def test_a_piece_that_nobody_voted_for_is_an_object_of_its_own(monkeypatch: pytest.MonkeyPatch) -> None:
    image, labels = picture(box((0.1, 0.08, 0.05), (0.1, 0.0, 0.2)), box((0.06, 0.05, 0.14), (-0.1, -0.02, 0.2)))
    say(monkeypatch, np.where(labels == 1, 1, 0))
    found = labelled(image, WHOLE)
    assert found.max() == 2
    assert max(iou(labels == 2, found == n) for n in (1, 2)) > 0.9


def test_one_surface_of_two_things_is_parted_where_their_votes_meet(monkeypatch: pytest.MonkeyPatch) -> None:
    image, labels = picture(box((0.2, 0.1, 0.05), (0.0, 0.0, 0.2)))
    columns = np.arange(labels.shape[1])
    truth = np.where(labels == 1, np.where(columns < 150, 1, 2), 0)
    say(monkeypatch, np.where(np.abs(columns - 150) < 4, 0, truth), seed=np.where(truth > 0, 0.9, 0.1))
    found = labelled(image, WHOLE)
    assert found.max() == 2
    assert all(max(iou(truth == k, found == n) for n in (1, 2)) > 0.9 for k in (1, 2))


@pytest.mark.parametrize(("sure", "count"), [(0.9, 1), (0.4, 0)])
def test_a_flat_thing_is_kept_where_the_network_is_sure_of_it(
    sure: float, count: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    image, labels = picture(box((0.12, 0.1, 0.0085), (0.0, 0.0, 0.2)), eye=np.array([0.2, -1.2, 1.4]))
    say(monkeypatch, labels, seed=np.where(labels > 0, sure, 0.1))
    assert labelled(image, WHOLE).max() == count


def test_what_stands_beyond_the_seen_table_is_kept_where_it_meets_something_and_a_chair_is_not(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    near = Table(
        TABLE, np.array([[0.0, 1.0, -0.02], [0.0, -1.0, -9.0], [1.0, 0.0, -9.0], [-1.0, 0.0, -9.0]]), 0.015, 0.15
    )
    thing = box((0.08, 0.05, 0.1), (-0.1, 0.1, 0.2))  # on the table, behind its outline
    image, labels = picture(thing)
    say(monkeypatch, labels)
    assert labelled(image, near).max() == 1
    table = box((1.0, 0.6, 0.02), (0.0, -0.28, 0.18))
    chair = box((0.3, 0.03, 0.8), (0.0, 0.12, -0.4))  # its back rises behind the table's edge
    view, index = render_mesh_view(
        [chair, table],
        T_world_camera=look_at(EYE, (0.0, 0.0, 0.22)),
        K=intrinsics(320, 240, 45.0),
        width=320,
        height=240,
    )
    say(monkeypatch, np.where((index == 0) & (view.points()[..., 2] > 0.206), 1, 0))
    assert labelled(view, near).max() == 0


def test_votes_of_any_size_of_picture_come_back_in_that_size() -> None:
    level = np.random.default_rng(0).normal(size=(37, 50, 3))
    votes, above = vote(level, PITCH_M, network=InstanceNet(8).eval())
    assert votes.places.shape == (37, 50, 3)
    assert votes.seed.shape == votes.spread_m.shape == above.shape == (37, 50)
    assert ((votes.seed > 0) & (votes.seed < 1)).all()
    assert (votes.spread_m > 0).all()


def test_shipped_network_finds_a_box_and_a_bar_behind_it() -> None:
    bar, front = box((0.3, 0.04, 0.05), (0.0, 0.1, 0.2)), box((0.06, 0.05, 0.14), (0.0, -0.02, 0.2))
    image, labels = picture(bar, front)
    found = detect_objects(image, up=np.array([0.0, 0.0, 1.0]), config=DetectConfig(classify=False, votes=True))
    assert len(found) == 2
    for k in (1, 2):
        own = labels == k
        assert max(iou(own, d.mask) for d in found if d.mask is not None) > 0.9


def test_shipped_weights_are_small_and_the_network_is_loaded_once() -> None:
    network = load_instances()
    assert network is load_instances()
    assert not network.training
    weights = data_file("weights", "instances.safetensors")
    card = json.loads(data_file("weights", "instances.json").read_text(encoding="utf-8"))
    assert weights.stat().st_size < 10e6
    assert hashlib.sha256(weights.read_bytes()).hexdigest() == card["sha256"]
    assert (card["command"], card["hours"] < 2) == ("gfp-grasp train instances", True)
    assert card["metrics"]["found"] > 0.8
