"""What the paper's two networks learn from, their loss, and one run from end to end."""

import json
from dataclasses import asdict, replace
from functools import partial
from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from moments import assert_known
from torch import Tensor, nn
from toy_primitive import toy_cup_primitive

from gfp_grasp.assets import data_dir
from gfp_grasp.deform import WEIGHTS, PaperNet, Variant, patch_unit_m, read_network
from gfp_grasp.errors import FitDiverged, InvalidOption
from gfp_grasp.meshes import sample_surface
from gfp_grasp.metrics import chamfer_m
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.register import FitConfig, pcrnet_config, size_of_extents
from gfp_grasp.scenes import ObjectSource
from gfp_grasp.train import (
    LoopConfig,
    ViewsConfig,
    looped_back,
    looped_loss,
    paper_loss,
    render_views,
    shape_source,
    train_paper,
)
from gfp_grasp.train import paper_data as module
from gfp_grasp.train.paper import PAPER_CONFIGS, _lap, measure_paper
from gfp_grasp.train.paper_data import _rows, _turned, paper_patches
from gfp_grasp.transforms import apply_T, make_T, rotation_about
from gfp_grasp.types import Symmetry

CUP = PrimitiveLibrary.shipped().primitive("cup")
SMALL = LoopConfig(steps=2, batch=8, rate=1e-3, bf16=False)


class _Moves(nn.Module):
    def __init__(self, shift: Tensor) -> None:
        super().__init__()
        self.shift = shift

    def forward(self, source: Tensor, template: Tensor) -> Tensor:
        return source + self.shift


def test_the_loss_weighs_distance_and_laplacian() -> None:
    source = torch.tensor(np.random.default_rng(0).normal(size=(2, 30, 3)), dtype=torch.float32)
    batch = (source, source, source, torch.ones(2))
    assert paper_loss(_Moves(torch.zeros(3)), batch).item() == pytest.approx(0, abs=1e-3)
    # All points far off by the same way: both directions of the Chamfer distance, and the same Laplacian.
    assert paper_loss(_Moves(torch.tensor([300.0, 400.0, 0.0])), batch).item() == pytest.approx(0.7 * 2 * 500, rel=0.01)
    assert_known("paper loss", [paper_loss(_Moves(0.3 * torch.sin(7 * source)), batch).item()])
    # Other readings: the way to T, and the mean place of the neighbours, which is that of all of three points.
    still = (source, source + torch.tensor([300.0, 400.0, 0.0]), source, torch.ones(2))
    assert paper_loss(_Moves(torch.zeros(3)), still, reading="CD to T").item() == pytest.approx(700, rel=0.01)
    line = torch.tensor([[[1.0 + 9 * n, 0, 0] for n in range(9)]])
    printed = paper_loss(_Moves(torch.zeros(3)), (line, line, line, torch.ones(1)), reading="eq. 3 as printed")
    assert printed.item() == pytest.approx(0.3 * 37, rel=1e-4)  # of nine points each has the other eight around it
    near = torch.tensor([[[1, 2], [0, 2], [0, 1]]])
    points = torch.tensor([[[0.0, 0, 0], [2, 0, 0], [0, 4, 0]]])
    assert _lap(points, near)[0].tolist() == [[-1, -2, 0], [2, -2, 0], [-1, 4, 0]]


@pytest.mark.parametrize("bf16", [False, True])
def test_a_set_that_is_looped_back_has_the_gradient_of_its_last_iteration(bf16: bool) -> None:
    torch.manual_seed(0)
    network = PaperNet((8, 16), iterations=3, hidden=(16, 8)).eval()
    source, template, target = (torch.randn(4, 64, 3) for _ in range(3))
    batch, seen = (source, template, target, torch.ones(4)), set()
    for seed in range(8):
        before = int(torch.randint(3, (), generator=torch.Generator().manual_seed(seed)))
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=bf16):
            with torch.no_grad():
                start = network(source, template, iterations=before)
            expected = paper_loss(lambda _, t, s=start: network(s, t, iterations=1), batch)
        torch.manual_seed(seed)
        with torch.autocast("cpu", dtype=torch.bfloat16, enabled=bf16):
            found = looped_loss(network, batch)
        assert found.item() == pytest.approx(expected.item(), rel=1e-5)
        for mine, its in zip(_gradients(network, found), _gradients(network, expected), strict=True):
            assert mine.any()
            assert torch.allclose(mine, its, rtol=1e-4, atol=1e-7)
        seen.add(before)
    assert seen == {0, 1, 2}
    once = PaperNet((8, 16), iterations=1).eval()
    assert torch.equal(looped_back(once, source, template), once(source, template))


def _gradients(network: nn.Module, loss: Tensor) -> list[Tensor]:
    return list(torch.autograd.grad(loss, [p for name, p in network.named_parameters() if "weight" in name]))


@pytest.mark.parametrize("variant", list(PAPER_CONFIGS))
def test_the_shipped_weights_were_trained_with_the_schedule_of_today(variant: Variant) -> None:
    card = json.loads((data_dir("weights") / f"{WEIGHTS[variant]}.json").read_text(encoding="utf-8"))
    assert card["config"] == asdict(PAPER_CONFIGS[variant])


def test_distances_of_sets_are_measured_in_millimetres_both_ways() -> None:
    source = torch.tensor([[[0.0, 0, 0], [1, 0, 0]]]).repeat(600, 1, 1)
    target = source + torch.tensor([0.0, 0.3, 0.4])
    unit_m = torch.linspace(0.01, 0.03, 600)

    class Half(nn.Module):
        def forward(self, s, t):
            assert len(s) <= 512
            return s[:, :1].expand_as(s) + torch.tensor([0.0, 0.15, 0.2])  # both near the first label only

    found = measure_paper(Half(), (source.half(), source.half(), target, unit_m))
    assert found == {
        "val_samples": 600,
        "cd_before_mm": pytest.approx(20.0, abs=4e-3),
        "cd_after_mm": pytest.approx(20 * (0.25 + (0.25 + np.hypot(1, 0.25)) / 2), abs=4e-3),
    }


def _cup_view(seed: int = 3):
    (view,) = render_views(
        shape_source("cup", seed), num_views=1, config=ViewsConfig(width=160, height=120, fallen_share=0.0)
    )
    return view


def test_a_label_leads_the_fit_onto_the_true_surface() -> None:
    view = _cup_view()
    verdict, label = module._label(view.source.load_mesh(), CUP, 3)
    assert verdict == "kept"
    surface = sample_surface(view.source.load_mesh(), 4000, np.random.default_rng(0))[0]
    # The vertices are on the surface, and cover it.
    assert chamfer_m(label, surface) < 0.08 * patch_unit_m(CUP) + chamfer_m(CUP.vertices, CUP.vertices + 1e-9) + 0.004
    sizes = ((1.0, 1.0, 1.0), size_of_extents(CUP, np.ptp(np.asarray(view.source.load_mesh().vertices), axis=0)))
    off = []
    for size in sizes:
        config = replace(pcrnet_config(size=size), hypotheses=(view.resting,))
        verdict, (source, template, target, unit_m) = _rows(view, CUP, config, label)
        assert verdict == "kept"
        assert source.shape == template.shape == target.shape == (len(unit_m), 64, 3)
        assert unit_m == pytest.approx(patch_unit_m(CUP))
        off.append(np.linalg.norm(target.astype(float) - source, axis=2).mean(axis=1))
        assert off[-1].max() < 1.0
    assert off[1].mean() < 0.7 * off[0].mean()  # what has the true size is nearer to its label


def test_a_fit_of_the_wrong_pose_teaches_nothing_and_one_that_fails_neither(monkeypatch) -> None:
    view = _cup_view()
    label = CUP.vertices + np.array([0.0, 0.0, 3.0])
    assert _rows(view, CUP, pcrnet_config(), label) == ("far", ())

    def lost(*_, config):
        assert config is told
        raise FitDiverged("no")

    told = pcrnet_config(size=(1.0, 1.0, 2.0))
    monkeypatch.setattr(module, "fit_best", lost)
    assert _rows(view, CUP, told, label) == ("not fitted", ())


def test_a_view_is_fitted_in_its_own_size_in_the_true_one_and_by_default(monkeypatch, tmp_path: Path) -> None:
    view, asked = replace(_cup_view(), resting="upside_down"), []
    monkeypatch.setattr(module, "_cached_label", lambda *_, **__: ("kept", CUP.vertices))
    monkeypatch.setattr(module, "_rows", lambda *given: (asked.append(given[2]), ("far", ()))[1])
    found = module._cached_rows(view, primitive=CUP, folder=tmp_path)
    assert found == [("far", ())] * 3
    true = size_of_extents(CUP, np.ptp(np.asarray(view.source.load_mesh().vertices), axis=0))
    wanted = pcrnet_config(), pcrnet_config(size=true), FitConfig()
    assert asked == [replace(config, hypotheses=("upside_down",)) for config in wanted]


def test_a_round_label_is_turned_onto_the_fit_and_another_by_its_symmetry_only() -> None:
    cup = replace(toy_cup_primitive(), symmetry=Symmetry(np.array([0.0, 0.0, 1.0]), 2))
    label = cup.vertices
    turned = apply_T(make_T(rotation_about((0, 0, 1), 2.0), None), label)
    np.testing.assert_allclose(_turned(label, turned, cup), turned, atol=1e-3)  # it is round, whatever its class is
    box = replace(cup, vertices=label * [1.0, 0.4, 1.0])
    for yaw, wanted in ((0.3, 0.0), (2.8, np.pi)):
        fit = apply_T(make_T(rotation_about((0, 0, 1), yaw), None), box.vertices)
        expected = apply_T(make_T(rotation_about((0, 0, 1), wanted), None), box.vertices)
        np.testing.assert_allclose(_turned(box.vertices, fit, box), expected, atol=1e-9)


def test_patches_come_from_the_cache_once_made_and_are_counted(tmp_path: Path, monkeypatch) -> None:
    made, counts = paper_patches("val", classes=["cup", "pedestrian"], members=1, num_views=1, runs=tmp_path)
    assert [sum(tally.values()) for tally in counts.values()] == [3, 3]  # a view has three fits
    assert len(made[0]) > 30
    assert [part.dtype for part in made] == [torch.float16] * 3 + [torch.float32]

    def again(*_):
        raise AssertionError("made again")

    monkeypatch.setattr(module, "_rows", again)
    monkeypatch.setattr(module, "_label", again)
    cached, _ = paper_patches("val", classes=["cup", "pedestrian"], members=1, num_views=1, runs=tmp_path)
    assert all(torch.equal(a, b) for a, b in zip(made, cached, strict=True))
    monkeypatch.setattr(module, "_content", lambda weights: b"another")
    with pytest.raises(AssertionError, match="made again"):
        paper_patches("val", classes=["cup"], members=1, num_views=1, runs=tmp_path)


def test_files_of_one_name_have_labels_of_their_own_and_shapes_those_of_their_seeds(
    tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setattr(module, "_label", lambda mesh, primitive, seed: ("kept", np.array([mesh.extents])))
    find = partial(module._cached_label, primitive=CUP, folder=tmp_path / "labels")
    folders = tmp_path / "one", tmp_path / "other"
    for folder, height_m in zip(folders, (0.08, 0.1), strict=True):
        folder.mkdir()
        trimesh.creation.box((0.06, 0.05, height_m)).export(folder / "cup__a.ply")
    sources = [ObjectSource("a", "cup", path=folder / "cup__a.ply") for folder in folders]
    for _ in range(2):
        assert [find(source)[1][0, 2] for source in sources] == pytest.approx([0.08, 0.1])
    trimesh.creation.box((0.06, 0.05, 0.09)).export(folders[0] / "cup__a.ply")
    assert find(sources[0])[1][0, 2] == pytest.approx(0.09)
    find(shape_source("cup", 42))
    assert f"label_000042_{module._shape_id(CUP)}.npz" in {path.name for path in (tmp_path / "labels").iterdir()}


def test_a_split_without_a_label_is_refused(monkeypatch, tmp_path: Path) -> None:
    monkeypatch.setattr(module, "_label", lambda *_: ("folded", np.zeros((1, 3))))
    with pytest.raises(InvalidOption, match=r"no label could be made: \{'cup': \{'folded': 3\}\}"):
        paper_patches("val", classes=["cup"], members=1, num_views=1, runs=tmp_path)


def test_a_run_writes_weights_that_load_and_a_card_with_its_curve(tmp_path: Path) -> None:
    told: list[int] = []
    out = tmp_path / "own.safetensors"
    how = {"classes": ["cup"], "config": SMALL, "num_views": 1, "limit": 1, "runs": tmp_path}
    path = train_paper("paper-oneshot", out=out, report=lambda step, _: told.append(step), **how)
    card = json.loads(path.read_text(encoding="utf-8"))
    assert told == [point[0] for point in card["learning_curve"]] == [1, 2]
    assert card["config"] == asdict(SMALL)
    assert card["data"]["shapes_a_class"] == 1
    assert card["data"]["labels"]["cup"]["kept"] > 0
    held_out, _ = paper_patches("val", classes=["cup"], members=1, num_views=1, runs=tmp_path)
    assert card["metrics"] == measure_paper(read_network("paper-oneshot", out), held_out)
    gone_on = train_paper("paper-oneshot", out=tmp_path / "on.safetensors", start=out, **how)
    assert json.loads(gone_on.read_text(encoding="utf-8"))["start"]["sha256"] == card["sha256"]
    with pytest.raises(InvalidOption, match="variant is 'patch'; one of paper-iterative, paper-oneshot"):
        train_paper("patch", **how)
