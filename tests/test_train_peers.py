"""Training of the peers: what they learn from, their losses, and one run from end to end."""

import json
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree

from gfp_grasp.assets import data_dir
from gfp_grasp.camera import cast_rays
from gfp_grasp.errors import InvalidOption, NotTrained, UnknownCategory
from gfp_grasp.peers import PEERS, AmortisedFit, ShapePrior, likelihood_loss, make_network, read_network, weights_stem
from gfp_grasp.peers.sc import corrupted, log_distance, shape_channels
from gfp_grasp.shapes import FAMILIES, HOUSEHOLD, IN_PAPER
from gfp_grasp.train import PEER_CONFIGS, PeerConfig, peer_config, peers, render_views, shape_source, train_peer
from gfp_grasp.train.peer_data import PeerView, cached_truth, in_cube, peer_views
from gfp_grasp.train.peer_losses import chamfer, lesson_batches, lesson_of, make_batch, prior_lesson
from gfp_grasp.train.peers import CLASSES, measure_peer
from gfp_grasp.transforms import apply_T, invert_T

SMALL = PeerConfig(steps=2, batch=2, members=1, views=2, bf16=False)
SHIPPED = [
    (name, true_box)
    for name in PEERS
    for true_box in (False, True)
    if (data_dir("weights") / f"{weights_stem(name, true_box=true_box)}.json").is_file()
]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("truths")


@pytest.fixture(scope="module", params=[False, True], ids=["seen", "true box"])
def view(request: pytest.FixtureRequest, folder: Path) -> PeerView:
    """A kettle, which is like no mirror image or turn of itself."""
    source = shape_source("kettle", 5)
    (seen,) = render_views(source, num_views=1)
    return in_cube(seen, cached_truth(source, folder), true_box=request.param)


def test_classes_are_households_and_those_of_the_papers_table() -> None:
    assert set(HOUSEHOLD) < set(CLASSES) <= set(FAMILIES)
    assert set(CLASSES) - set(HOUSEHOLD) == {"car", "pedestrian"}
    assert IN_PAPER == ("cup", "bottle", "car", "pedestrian")


def test_every_peer_has_a_schedule_and_all_learn_from_the_same_views() -> None:
    assert list(PEER_CONFIGS) == list(PEERS)
    assert len({(config.members, config.views) for config in PEER_CONFIGS.values()}) == 1
    assert [name for name, config in PEER_CONFIGS.items() if config.prior_share] == ["3d-sc"]


@pytest.mark.parametrize(("name", "true_box"), SHIPPED)
def test_the_shipped_weights_of_a_peer_were_trained_with_the_schedule_of_today(name: str, true_box: bool) -> None:
    path = data_dir("weights") / f"{weights_stem(name, true_box=true_box)}.json"
    card = json.loads(path.read_text(encoding="utf-8"))
    assert card["config"] == asdict(peer_config(name, true_box=true_box))
    assert card["data"]["true_box"] is true_box
    assert card["data"]["classes"] == list(CLASSES)


def test_nonsense_schedules_are_refused() -> None:
    for wrong in ({"members": 0}, {"views": 0}, {"prior_share": 1.0}):
        with pytest.raises(InvalidOption, match="members and views"):
            replace(SMALL, **wrong)


def test_the_truth_is_made_once_and_lies_where_the_object_stands(view: PeerView, folder: Path) -> None:
    again = cached_truth(view.view.source, folder)
    np.testing.assert_array_equal(again.distance, view.truth.distance)
    points = apply_T(view.view.T_world_object, view.truth.points)
    assert np.median(KDTree(points).query(view.view.points)[0]) < 0.02 * view.truth.box(np.eye(4)).extents.max()
    assert np.abs(view.truth.distances(view.truth.points, view.truth.grid.cell_m)).max() < 2
    near = KDTree(view.view.points).query(view.cube.outward(view.seen.points))[0]
    np.testing.assert_allclose(near, 0, atol=1e-9)


def test_signed_distances_in_the_cube_are_those_of_the_true_mesh(view: PeerView) -> None:
    cells, mesh = view.distances(32), view.view.source.load_mesh()
    inside = np.argwhere(cells < -0.8)
    assert len(inside) > 50
    own = apply_T(invert_T(view.view.T_world_object), view.cube.outward((inside + 0.5) / 32 - 0.5))
    up = np.tile([0.0, 0.0, 1.0], (len(own), 1))
    assert np.isfinite(cast_rays([(np.asarray(mesh.vertices), np.asarray(mesh.faces))], own, up)[0]).all()
    to_surface = 32 * KDTree(view.points()).query((inside + 0.5) / 32 - 0.5)[0]
    assert np.abs(to_surface + cells[tuple(inside.T)]).mean() < 0.6
    far = cells[0, 0, 0]
    assert far == pytest.approx(32 * KDTree(view.points()).query([[-0.484, -0.484, -0.484]])[0][0], rel=0.1)


@pytest.mark.parametrize("resolution", [32, 40])
@pytest.mark.parametrize("true_box", [False, True])
def test_a_thin_wall_is_thick_enough_for_each_peers_own_grid(folder: Path, resolution: int, true_box: bool) -> None:
    """A drinking glass: hardly a place of its surface is without a cell of the inside near it."""
    source = shape_source("glass", 5)
    view = in_cube(render_views(source, num_views=1)[0], cached_truth(source, folder), true_box=true_box)
    distance = view.distances(resolution)
    inside = (np.argwhere(distance < 0) + 0.5) / resolution - 0.5
    away = resolution * KDTree(inside).query(view.points())[0]
    assert (away > 1.2).mean() < 0.002
    solid = view.view.source.load_mesh().volume * (resolution / view.cube.side_m) ** 3
    assert len(inside) < 2.1 * solid  # and it is not thicker than it need be


def test_a_mirrored_batch_is_the_mirror_image(view: PeerView) -> None:
    for name, axis in (("pcn", None), ("scrg", 1)):
        batches = [
            make_batch([view], lesson_of(name), np.random.default_rng(0), mirrored=np.array([flip]))
            for flip in (False, True)
        ]
        (given, truth), (given_mirrored, truth_mirrored) = batches
        if axis is None:
            flip = torch.tensor([1.0, -1.0, 1.0])
            torch.testing.assert_close(given * flip, given_mirrored)
            torch.testing.assert_close(truth * flip, truth_mirrored)
        else:
            torch.testing.assert_close(truth.flip(2), truth_mirrored)
            assert (given.flip(3) != given_mirrored).float().mean() < 1e-3


def test_chamfer_distance_of_two_known_sets() -> None:
    a = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0]]])
    b = torch.tensor([[[0.0, 0, 3.0]]])
    assert float(chamfer(a, b)) == pytest.approx((3 + np.sqrt(10)) / 2 + 3)
    assert float(chamfer(a, a)) < 1e-5


@pytest.fixture(scope="module")
def bowl(folder: Path) -> list[PeerView]:
    """Two views of one bowl."""
    seen = render_views(shape_source("bowl", 3), num_views=2)
    return [in_cube(view, cached_truth(view.source, folder), true_box=False) for view in seen]


@pytest.mark.parametrize(
    ("name", "share"), [("pcn", 0.5), ("foldingnet", 0.7), ("topnet", 0.7), ("3d-epn", 0.7), ("scrg", 0.5)]
)
def test_thirty_steps_on_two_views_bring_the_loss_down(name: str, share: float, bowl: list[PeerView]) -> None:
    torch.manual_seed(0)
    lesson = lesson_of(name)
    before, after = _losses(make_network(name).train(), lesson, make_batch(bowl, lesson, np.random.default_rng(0)))
    assert after < share * before


def test_thirty_steps_bring_the_loss_of_the_prior_down_and_then_that_of_the_fit(bowl: list[PeerView]) -> None:
    torch.manual_seed(0)
    prior, network = ShapePrior().train(), AmortisedFit().train()
    shapes = make_batch(bowl, prior_lesson(), np.random.default_rng(0))
    assert shapes[0].shape == (2, 0)  # it sees nothing of what was seen
    before, after = _losses(prior, prior_lesson(), shapes)
    assert after < 0.5 * before
    network.decode.load_state_dict(prior.decode.state_dict())
    seen = make_batch(bowl, lesson_of("3d-sc"), np.random.default_rng(0))
    assert seen[1].shape == (2, 0)  # it never sees a true shape
    before, after = _losses(network, lesson_of("3d-sc"), seen)
    assert after < 0.9 * before


def _losses(network, lesson, batch) -> tuple[float, float]:
    """The loss of one batch before and after thirty steps on it."""
    optimiser = torch.optim.Adam([p for p in network.parameters() if p.requires_grad], lr=2e-3)
    losses = []
    for _ in range(30):
        value = lesson.loss_of_batch(network, batch)
        optimiser.zero_grad()
        value.backward()
        optimiser.step()
        losses.append(float(value.detach()))
    return losses[0], losses[-1]


def test_what_is_seen_is_likelier_under_a_shape_that_has_it() -> None:
    """A plane that was seen, empty cells before it: the half-space behind it is likelier than that before it."""

    class Says(torch.nn.Module):
        def __init__(self, sign: float) -> None:
            super().__init__()
            depth = sign * (torch.arange(32.0) - 15.5)[None, :, None, None].expand(1, 32, 32, 32)
            self.decoded = torch.stack([-depth, log_distance(depth)], dim=1)

        def forward(self, given):
            return torch.zeros(1, 64), self.decoded

    given = torch.zeros(1, 2, 32, 32, 32)
    given[:, 0, 15], given[:, 1, 17:] = 1, 1
    right, wrong = (float(likelihood_loss(Says(sign), given)) for sign in (1.0, -1.0))
    assert np.isfinite([right, wrong]).all()
    assert right < 0.05 * wrong


def test_log_distances_keep_their_sign_and_are_cut_off_at_five_cells() -> None:
    distance = torch.tensor([[[[-9.0, -1.0, 0.0, 1.0, 9.0]]]])
    channels = shape_channels(distance)
    np.testing.assert_allclose(channels[0, 0].ravel(), [1, 1, 1, 0, 0])
    np.testing.assert_allclose(channels[0, 1].ravel(), np.log([1 / 6, 1 / 2, 1, 2, 6]), rtol=1e-6)
    disturbed = corrupted(shape_channels(torch.full((1, 16, 16, 16), 3.0)))
    assert 0.05 < float(disturbed[:, 0].mean()) < 0.15
    assert float(disturbed[:, 1].std()) == pytest.approx(np.sqrt(0.05), rel=0.1)


def test_the_decoder_of_the_prior_stays_as_it_is() -> None:
    network = AmortisedFit().train()
    assert network.encode.training
    assert not any(module.training for module in network.decode.modules())
    assert not any(weights.requires_grad for weights in network.decode.parameters())


def test_batches_go_on_without_end_and_are_the_same_for_a_seed(view: PeerView) -> None:
    streams = [lesson_batches([view] * 3, lesson_of("topnet"), 2)(torch.Generator().manual_seed(4)) for _ in range(2)]
    for _ in range(4):
        a, b = (next(stream) for stream in streams)
        assert a[0].shape == (2, 1024, 3)
        torch.testing.assert_close(a, b)


def test_the_true_box_goes_on_for_a_quarter_at_a_quarter_of_the_rate() -> None:
    metric, boxed = (peer_config("3d-sc", true_box=true_box) for true_box in (False, True))
    assert metric == PEER_CONFIGS["3d-sc"]
    assert boxed == replace(metric, steps=metric.steps // 4, rate=metric.rate / 4)
    with pytest.raises(InvalidOption, match="no peer 'magic'"):
        peer_config("magic", true_box=True)


def test_the_true_box_starts_from_the_weights_of_the_metric_way(tmp_path: Path, monkeypatch) -> None:
    torch.manual_seed(7)
    metric, asked = make_network("pcn").eval(), []

    def load(name: str, *, true_box: bool):
        asked.append((name, true_box))
        return metric

    monkeypatch.setattr(peers, "load_network", load)
    config = replace(SMALL, steps=1, rate=1e-9)
    path = train_peer(
        "pcn", true_box=True, config=config, classes=["bowl"], out=tmp_path / "own.safetensors", runs=tmp_path
    )
    assert asked == [("pcn", False)]
    assert json.loads(path.read_text(encoding="utf-8"))["data"]["start"] == "peer_pcn"
    for key, tensor in read_network("pcn", tmp_path / "own.safetensors").state_dict().items():
        torch.testing.assert_close(tensor, metric.state_dict()[key], atol=1e-3, rtol=1e-3)


def test_in_the_true_box_the_prior_goes_on_too_before_the_encoder_does(tmp_path: Path, monkeypatch) -> None:
    torch.manual_seed(7)
    metric = make_network("3d-sc").eval()
    monkeypatch.setattr(peers, "load_network", lambda name, *, true_box: metric)
    config = replace(SMALL, steps=4, rate=1e-2, prior_share=0.5)
    path = train_peer(
        "3d-sc", true_box=True, config=config, classes=["bowl"], out=tmp_path / "own.safetensors", runs=tmp_path
    )
    card = json.loads(path.read_text(encoding="utf-8"))
    assert [len(card[key]) for key in ("learning_curve_of_prior", "learning_curve")] == [2, 2]
    own, before = read_network("3d-sc", tmp_path / "own.safetensors").state_dict(), metric.state_dict()
    for part in ("encode.last.bias", "decode.last.bias"):  # Adam's steps: at most the rate each
        moved = (own[part] - before[part]).abs().max()
        assert 5e-3 < float(moved) < 2.5e-2


def test_a_training_of_other_weights_or_views_is_another_one(tmp_path: Path, monkeypatch) -> None:
    torch.manual_seed(7)
    metric = make_network("topnet").eval()
    monkeypatch.setattr(peers, "load_network", lambda name, *, true_box: metric)
    how = {"true_box": True, "config": replace(SMALL, steps=1), "classes": ["bowl"], "runs": tmp_path}
    kept = lambda: len(list((tmp_path / "peers").glob("*.pt")))  # noqa: E731
    train_peer("topnet", out=tmp_path / "a.safetensors", **how)
    train_peer("topnet", out=tmp_path / "a.safetensors", **how)
    assert kept() == 1
    with torch.no_grad():
        next(iter(metric.parameters())).add_(0.25)
    train_peer("topnet", out=tmp_path / "b.safetensors", **how)
    assert kept() == 2
    for path in (tmp_path / "truths").rglob("*.npz"):
        with np.load(path) as stored:
            parts = dict(stored)
        np.savez(path, **{**parts, "points": parts["points"] + np.float32(0.001)})
    train_peer("topnet", out=tmp_path / "c.safetensors", **how)
    assert kept() == 3


def test_the_true_box_needs_the_weights_of_the_metric_way(tmp_path: Path, monkeypatch) -> None:
    def load(name: str, *, true_box: bool):
        raise NotTrained("none")

    monkeypatch.setattr(peers, "load_network", load)
    with pytest.raises(NotTrained):
        train_peer("pcn", true_box=True, runs=tmp_path)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("name", ["topnet", "3d-sc"])
def test_a_run_writes_weights_that_load_and_a_card_that_says_how(name: str, tmp_path: Path) -> None:
    told: list[int] = []
    config, true_box = replace(SMALL, steps=4, prior_share=PEER_CONFIGS[name].prior_share), False
    how = {"true_box": true_box, "config": config, "classes": ["bowl", "car"], "runs": tmp_path}
    out = tmp_path / "own.safetensors"
    path = train_peer(name, out=out, report=lambda step, loss: told.append(step), **how)
    card = json.loads(path.read_text(encoding="utf-8"))
    assert told == [1, 2, 3, 4]
    assert card["config"] == asdict(config)
    assert card["data"] == {"classes": ["bowl", "car"], "split": "train", "true_box": False, "views": 4, "start": None}
    steps = {key: [point[0] for point in points] for key, points in card.items() if key.startswith("learning_curve")}
    both = {"learning_curve": [1, 2], "learning_curve_of_prior": [1, 2]}
    assert steps == (both if name == "3d-sc" else {"learning_curve": [1, 2, 3, 4]})
    assert all(np.isfinite(point).all() for point in card["learning_curve"])
    assert card["metrics"]["val"]["views"] == 2
    assert ("points_cd_m" in card["metrics"]["val"]) == (name == "topnet")
    network = read_network(name, out)
    val = peer_views(["bowl", "car"], "val", members=1, num_views=1, true_box=true_box, runs=tmp_path)
    assert measure_peer(name, network, val, true_box=true_box) == card["metrics"]["val"]
    again = train_peer(name, out=tmp_path / "again.safetensors", **how)  # goes on from the end
    assert json.loads(again.read_text(encoding="utf-8"))["sha256"] == card["sha256"]
    assert json.loads(again.read_text(encoding="utf-8"))["learning_curve"] == card["learning_curve"]


def test_unknown_peers_and_families_are_refused_before_anything_is_rendered(tmp_path: Path) -> None:
    with pytest.raises(InvalidOption, match="no peer 'magic'"):
        train_peer("magic", runs=tmp_path)
    with pytest.raises(UnknownCategory, match="no shape family 'magic'"):
        train_peer("pcn", classes=["magic"], runs=tmp_path)
    assert not list(tmp_path.iterdir())
