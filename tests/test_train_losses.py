"""Losses of GFPNet on hand-made errors, what its batches hold, and how it is measured."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from moments import assert_known
from torch import nn

from gfp_grasp.deform import BELIEF, PatchAnswer, PatchNet, TemplatePoints
from gfp_grasp.errors import InvalidOption
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train import gfpnet, shuffled
from gfp_grasp.train.gfpnet import _measure, _surface_error, _unlikelihood, mean_mm, point_loss
from gfp_grasp.train.labels import Label
from gfp_grasp.train.patch_data import Objects, PrimitiveTable, augmented, load_objects, object_of

LIBRARY = PrimitiveLibrary.shipped()
TABLE = PrimitiveTable.of(LIBRARY, ("cup", "mug"))


def _label(name: str, seed: int, *, without: tuple[str, ...] = ()) -> Label:
    rng = np.random.default_rng(seed)
    primitive = TABLE.primitives[TABLE.number(name, without)]
    coefficients, scale = rng.normal(0, 0.5, 3), np.exp(rng.normal(0, 0.1, 3))
    vertices = primitive.shape(np.append(coefficients, np.zeros(len(primitive.modes) - 3)), scale)
    points = vertices[vertices[:, 0] > 0.01]
    normals = points / np.linalg.norm(points, axis=1, keepdims=True)
    template = TemplatePoints(points, normals, np.arange(len(points)) % 3 == 0)
    target = vertices + 0.002 * np.sin(50 * vertices[:, [1, 2, 0]])
    return Label(name, without, vertices, target, template, np.array([1.0, 0, 0.5]), coefficients, scale)


@pytest.fixture(scope="module")
def objects() -> Objects:
    """Three objects as they are stored."""
    labels = [_label("cup", 0), _label("mug", 1), _label("mug", 2, without=("handle",))]
    found, counts = load_objects(
        lambda category: ([own for own in labels if own.primitive == category], {"kept": 1, "folded": len(category)}),
        TABLE,
    )
    assert counts == {"cup": {"kept": 1, "folded": 3}, "mug": {"kept": 1, "folded": 3}}
    return found


def test_the_table_holds_primitives_and_their_variants_row_by_row() -> None:
    names = [(p.name, sorted(w)) for p, w in zip(TABLE.primitives, TABLE.without, strict=True)]
    assert names == [(kind.name, []) for kind in LIBRARY.members_of("cup")] + [("mug", []), ("mug", ["handle"])]
    assert TABLE.categories == ("cup", "mug")
    mug, bare = TABLE.number("mug"), TABLE.number("mug", ["handle"])
    assert (mug, bare) == (len(names) - 2, len(names) - 1)
    primitive = TABLE.primitives[bare]
    own = TABLE.modes[bare, : len(primitive.vertices), :, : len(primitive.modes)].numpy()
    np.testing.assert_allclose(own.transpose(2, 0, 1), primitive.modes, atol=1e-7)
    assert not TABLE.modes[bare, len(primitive.vertices) :].any()
    assert not TABLE.modes[TABLE.number("cup"), :, :, len(TABLE.primitives[0].modes) :].any()
    np.testing.assert_allclose(TABLE.log_scale_cov[mug].numpy(), TABLE.primitives[mug].log_scale_cov, atol=1e-7)
    assert (TABLE.modes.dtype, TABLE.log_scale_cov.dtype) == (torch.float32, torch.float32)


def test_objects_are_stored_in_half_precision_as_ever(objects: Objects) -> None:
    kinds = dict(zip(Objects._fields, (part.dtype for part in objects), strict=True))
    assert kinds.pop("primitive") == torch.int64
    assert kinds.pop("unit_m") == torch.float32
    assert set(kinds.values()) == {torch.float16}
    assert objects.primitive.tolist() == [TABLE.number("cup"), TABLE.number("mug"), TABLE.number("mug", ["handle"])]
    for name, part in zip(Objects._fields, objects, strict=True):
        assert_known(f"objects {name}", part.double().numpy(), rel=1e-3)
    assert not objects.coefficients[:, 3:].any()


def test_offsets_lead_from_the_fit_to_the_label_in_the_patch_frame() -> None:
    label = _label("mug", 1)
    parts = dict(zip(Objects._fields, map(np.asarray, object_of(label, TABLE)), strict=True))
    index = TABLE.index[TABLE.number("mug")].numpy()
    world = np.einsum("pij,pnj->pni", parts["frames"], parts["offset"]) * parts["unit_m"]
    np.testing.assert_allclose(world, (label.target - label.vertices)[index], atol=1e-9)


def test_no_label_at_all_is_refused() -> None:
    with pytest.raises(InvalidOption, match="no label could be made"):
        load_objects(lambda category: ([], {"folded": 2}), TABLE)


def test_batches_are_thinned_and_shaken_as_ever(objects: Objects) -> None:
    *parts, some = next(augmented(shuffled(objects, 2))(torch.Generator().manual_seed(3)))
    batch = Objects(*parts)
    num_source, num_template = objects.source.shape[2], objects.template.shape[2]
    assert batch.source.shape[2] == len(some) == num_source // 4
    assert batch.template.shape[2] == num_template // 2
    for name in ("source", "source_normals", "template", "template_normals", "mirrored", "residuals", "offset"):
        assert_known(f"augmented {name}", getattr(batch, name).double().numpy(), rel=1e-3)
    order = [int((objects.unit_m == unit_m).nonzero()[0, 0]) for unit_m in batch.unit_m]
    for name in ("source", "source_normals", "residuals", "offset"):
        assert torch.equal(getattr(batch, name), getattr(objects, name)[order][:, :, some])
    # Noise of a sixtieth of a patch, on points whose normals and origin stay with them.
    drawn, before = batch.template.float(), objects.template[order].float()
    gap = torch.cdist(drawn.flatten(0, 1), before.flatten(0, 1)).amin(dim=2)
    assert 0.005 < gap.median() < 0.03


def test_a_far_outlier_counts_no_more_than_a_far_one() -> None:
    one = torch.tensor([2.0])
    assert _unlikelihood(one, torch.tensor([math.log(0.5)])).item() == pytest.approx(8.0 + math.log(0.5))
    assert _unlikelihood(100 * one, torch.tensor([0.0])).item() == pytest.approx(20.0)
    both = _unlikelihood(torch.tensor([0.0, 2.0]), torch.zeros(2))
    assert both.item() == pytest.approx(1.0)


def test_an_error_along_the_surface_counts_three_tenths() -> None:
    normal = torch.tensor([0.0, 0.0, 1.0])
    assert _surface_error(torch.tensor([3.0, 4.0, 0.0]), normal).item() == pytest.approx(1.5)
    assert _surface_error(torch.tensor([0.0, 0.0, -2.0]), normal).item() == pytest.approx(2.0)
    assert _surface_error(torch.tensor([10.0, 0.0, 4.0]), normal).item() == pytest.approx(5.0)
    assert mean_mm(torch.tensor([0.001, 0.0020004])) == 1.5


class _Says(nn.Module):
    """Says the same for every point: no change of the fit, an offset, a deviation."""

    def __init__(self, offset: float = 0.0, log_sigma: float = -2.0, advance: float = 0.1, log_weight: float = 0.4):
        super().__init__()
        self.said = (offset, log_sigma, advance, log_weight)

    def forward(self, source, source_normals, template, template_normals, mirrored, residuals, pose_features, fit):
        assert fit.shape == (len(source), fit.shape[1])
        offset, log_sigma, advance, log_weight = self.said
        one = torch.ones(source.shape[:3])
        return PatchAnswer(
            offset * source_normals,
            log_sigma * one,
            advance * one,
            log_weight * one,
            torch.full((len(source), 3), 30.0),  # held so hard that the fit does not change
            torch.full((len(source),), 0.0),
        )


def _floats(objects: Objects) -> Objects:
    return Objects(*(part.float() if part.is_floating_point() else part for part in objects))


def test_the_loss_is_the_error_and_a_fiftieth_of_two_likelihoods(objects: Objects) -> None:
    some = torch.arange(objects.source.shape[2])
    whole = _floats(objects)
    error = _surface_error(0.02 * whole.source_normals - whole.offset, whole.source_normals)
    for log_sigma, used in ((-2.0, -2.0), (-9.0, -7.0), (3.0, 2.0)):
        found = point_loss(_Says(0.02, log_sigma), (*whole, some), table=TABLE)
        ahead = (whole.offset * whole.source_normals).sum(dim=-1) / gfpnet.MISFIT_SHARE
        sure = _unlikelihood(error, torch.tensor(used))
        asked = _unlikelihood(ahead - 0.1, torch.tensor(-0.2))
        assert found.item() == pytest.approx((error.mean() + 0.02 * (sure + asked)).item(), rel=1e-3)


def test_sigma_does_not_excuse_the_error_of_an_offset(objects: Objects) -> None:
    torch.manual_seed(0)
    network = PatchNet(16, layers=1)
    batch = (*_floats(objects), torch.arange(objects.source.shape[2]))
    loss = point_loss(network, batch, table=TABLE)
    loss.backward()
    assert_known("point loss", [loss.item()], rel=1e-3)
    size = [parameter.grad.norm().item() for parameter in network.parameters() if parameter.grad is not None]
    assert_known("gradients of the point loss", size, rel=1e-2)


def test_errors_are_measured_of_all_of_what_was_hidden_and_of_each_primitive(objects: Objects) -> None:
    many = Objects(*(torch.cat([part] * 12) for part in objects))  # more than one batch
    found = _measure(_Says(0.02, -3.0), many, TABLE)
    whole = _floats(many)
    unit_m = whole.unit_m[:, None, None]
    before = unit_m * _surface_error(whole.offset, whole.source_normals)
    error = _surface_error(BELIEF * 0.02 * whole.source_normals - whole.offset, whole.source_normals)
    hidden = whole.pose_features[..., -1] == 0
    mug = whole.primitive >= TABLE.number("mug")
    expected = {
        "val_samples": 36,
        "mean_error_before_mm": mean_mm(before),
        "mean_error_after_mm": mean_mm(unit_m * error),
        "hidden_error_before_mm": mean_mm(before[hidden]),
        "hidden_error_after_mm": mean_mm((unit_m * error)[hidden]),
        "share_within_two_sigma": round(float((error < 2 * math.exp(-3.0)).float().mean()), 3),
        "cup_error_before_mm": mean_mm(before[~mug]),
        "cup_error_after_mm": mean_mm((unit_m * error)[~mug]),
        "mug_error_before_mm": mean_mm(before[mug]),
        "mug_error_after_mm": mean_mm((unit_m * error)[mug]),
    }
    assert found == {name: pytest.approx(value, abs=2e-3) for name, value in expected.items()}


def test_a_label_of_another_number_of_modes_has_the_rest_at_zero() -> None:
    label = _label("cup", 0)
    one = object_of(replace(label, coefficients=label.coefficients[:1]), TABLE)
    coefficients = np.asarray(one[Objects._fields.index("coefficients")])
    np.testing.assert_array_equal(coefficients[1:], 0.0)
    assert coefficients[0] == label.coefficients[0]
