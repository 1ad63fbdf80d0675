"""Training of the network that tells things apart: its loss, its data, and one short run from beginning to end."""

import json

import numpy as np
import pytest
import torch
from safetensors.torch import load_file

from gfp_grasp.detect import InstanceNet
from gfp_grasp.errors import InvalidOption
from gfp_grasp.train import InstancesConfig, train_instances
from gfp_grasp.train.instances import CROP, _augmented, _lovasz, _render_room, instance_loss, read_rooms


def test_lovasz_is_the_lost_share_of_the_union_for_certain_answers() -> None:
    truth = torch.tensor([True] * 6 + [False] * 6)
    right = torch.where(truth, 1.0, -1.0)
    assert float(_lovasz(right, truth)) == 0.0
    # Two of six are missed and one is too many: 4 / 7 of the union is right. Each wrong answer has the error 2.
    wrong = right.clone()
    wrong[:2], wrong[6] = -1.0, 1.0
    assert float(_lovasz(wrong, truth)) == pytest.approx(2 * (1 - 4 / 7))


class Says(torch.nn.Module):
    """Stands for a network with one answer."""

    def __init__(self, answer: torch.Tensor) -> None:
        super().__init__()
        self.answer = answer

    def forward(self, features: torch.Tensor) -> torch.Tensor:
        return self.answer


def test_loss_is_low_where_each_thing_votes_for_its_own_place_and_high_where_two_vote_for_one() -> None:
    labels = torch.zeros(1, 16, 16, dtype=torch.long)
    labels[:, 2:8, 2:8], labels[:, 9:14, 9:14] = 1, 2
    features = torch.randn(1, 8, 16, 16, generator=torch.Generator().manual_seed(0))
    middles = torch.tensor([[9.0, 9, 9], [0.0, 0, 0], [2.0, 0, 0]])

    def answer(middles: torch.Tensor, seed: torch.Tensor) -> torch.Tensor:
        offset = middles[labels[0]].permute(2, 0, 1) - features[0, :3]
        return torch.cat([offset, torch.full((1, 16, 16), np.log(0.3)), seed])[None]

    batch = (features, labels, torch.ones(1, 16, 16, dtype=torch.bool))
    told = 10.0 * (2.0 * (labels > 0).float() - 1.0)
    good = float(instance_loss(Says(answer(middles, told)), batch))
    joined = float(instance_loss(Says(answer(middles * torch.tensor([[1.0], [1.0], [0.0]]), told)), batch))
    untold = float(instance_loss(Says(answer(middles, -told)), batch))
    assert good == pytest.approx(0.0, abs=1e-3)
    # Thing 1 (36 pixels) and thing 2 (25) are one: 1 - 36 / 61 and 1 - 25 / 61 of the union are wrong, at error 2.
    assert joined == pytest.approx((2 * (25 / 61) + 2 * (36 / 61)) / 2, abs=2e-3)
    assert untold == pytest.approx(4.0, abs=2e-3)  # each pixel is told the opposite


def test_a_room_is_rendered_once_and_its_views_are_level(tmp_path) -> None:
    path = _render_room(("val", 3), num_views=2, folder=tmp_path)
    stamp = path.stat().st_mtime_ns
    assert _render_room(("val", 3), num_views=2, folder=tmp_path) == path
    assert path.stat().st_mtime_ns == stamp
    views = list(read_rooms(path))
    assert len(views) == 2
    for view in views:
        assert view.level.shape == (240, 320, 3)
        assert view.labels.max() >= 1
        things = view.level[view.labels > 0]
        assert np.isfinite(things).all()
        assert -0.02 < np.quantile(things[:, 2], 0.01) < np.quantile(things[:, 2], 0.99) < 0.5
        assert things[:, 1].mean() > abs(things[:, 0].mean())  # before the camera
        assert 0.001 < view.pitch_m < 0.008


def test_augmented_crop_keeps_labels_with_their_surface(tmp_path) -> None:
    view = next(iter(read_rooms(_render_room(("val", 3), num_views=2, folder=tmp_path))))
    for seed in range(4):
        features, labels, above = _augmented(view, np.random.default_rng(seed))
        assert features.shape == (8, *CROP)
        assert labels.shape == above.shape == CROP
        assert (labels > 0).any()
        assert features[6][labels > 0].all()
        assert above[labels > 0].mean() > 0.7


@pytest.mark.parametrize("name", ["width", "rooms", "views"])
def test_counts_below_one_are_refused(name: str) -> None:
    with pytest.raises(InvalidOption, match="width, rooms and views must be at least 1"):
        InstancesConfig(**{name: 0})  # pyright: ignore[reportArgumentType]


def test_a_short_run_writes_weights_that_load_and_a_card(tmp_path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("gfp_grasp.train.instances._VAL_ROOMS", 1)
    told = []
    config = InstancesConfig(steps=2, batch=2, width=4, rooms=5, views=2, checkpoint_s=0.0)
    card_path = train_instances(
        config=config,
        out=tmp_path / "net.safetensors",
        runs=tmp_path,
        report=lambda step, loss: told.append((step, loss)),
    )
    card = json.loads(card_path.read_text())
    assert card["config"]["width"] == 4
    assert card["data"] == {"rooms": 5, "views_a_room": 2, "split": "train"}
    assert card["metrics"]["things"] >= 1
    assert 0 <= card["metrics"]["found"] <= card["metrics"]["mean_iou"] + 1
    assert [step for step, _ in told] == [1, 2]
    assert all(np.isfinite(loss) for _, loss in told)
    InstanceNet(4).load_state_dict(load_file(tmp_path / "net.safetensors"))
