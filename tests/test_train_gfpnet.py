"""What a network learns is what the completion does with its answer."""

import numpy as np
import torch

from gfp_grasp.deform import make_patches, patch_unit_m
from gfp_grasp.deform.gfpnet import CHANGE, FIT, PatchNet, fit_features, mode_field
from gfp_grasp.deform.template import TemplatePoints
from gfp_grasp.primitives import load_primitive
from gfp_grasp.train.gfpnet import Objects, _field, _object, augmented, point_loss
from gfp_grasp.train.labels import Label
from gfp_grasp.train.loop import shuffled
from gfp_grasp.types import FittedPrimitive


def _label(category: str, rng: np.random.Generator, *, twin: bool = False) -> Label:
    primitive = load_primitive(category)
    if twin:
        assert primitive.twin is not None
        primitive = primitive.twin
    coefficients, scale = rng.normal(0, 0.5, len(primitive.modes)), np.exp(rng.normal(0, 0.1, 3))
    vertices = primitive.shape(coefficients, scale)
    points = vertices[vertices[:, 0] > 0]
    template = TemplatePoints(
        points, points / np.linalg.norm(points, axis=1, keepdims=True), np.zeros(len(points), bool)
    )
    target = vertices + np.array([0.001, 0.002, 0.003])
    return Label(category, twin, vertices, target, template, np.array([1.0, 0, 0.5]), coefficients, scale)


def _objects(*labels: Label) -> Objects:
    columns = zip(*(_object(label) for label in labels), strict=True)
    parts = (torch.from_numpy(np.stack([np.asarray(part) for part in column])) for column in columns)
    return Objects(*(part.float() if part.is_floating_point() else part for part in parts))


def test_a_change_of_the_fit_moves_the_patches_of_training_as_it_moves_the_vertices_of_a_completion():
    rng = np.random.default_rng(0)
    names = ("cup", "cup.stemmed", "mug", "bottle", "bottle.jug")
    labels = [*(_label(name, rng) for name in names), _label("mug", rng, twin=True)]
    objects = _objects(*labels)
    change = rng.normal(size=(len(labels), CHANGE))
    everything = torch.arange(objects.source.shape[2])
    patches = _field(objects, torch.tensor(change, dtype=torch.float32), everything)
    for label, own, moved in zip(labels, change, patches, strict=True):
        primitive = load_primitive(label.primitive)
        primitive = (primitive.twin if label.twin else primitive) or primitive
        fit = FittedPrimitive(primitive, np.eye(4), label.scale, label.coefficients, 0.0)
        field = mode_field(fit, own)
        p = make_patches(primitive, label.vertices, label.template, label.viewpoint)
        wanted = np.einsum("bij,bni->bnj", p.frames, field[p.index]) / p.unit_m
        assert np.abs(moved.numpy() - wanted).max() < 1e-3 * np.abs(wanted).max()


def test_offsets_of_the_label_lead_from_the_source_to_the_target():
    label = _label("bottle", np.random.default_rng(1))
    objects = _objects(label)
    unit_m = patch_unit_m(load_primitive("bottle"))
    world = torch.einsum("opij,opnj->opni", objects.frames, objects.offset) * unit_m
    assert torch.allclose(world, torch.tensor([0.001, 0.002, 0.003]), atol=1e-6)


def test_a_primitive_that_the_network_does_not_know_has_neither_modes_nor_class():
    label = _label("cup", np.random.default_rng(2))
    fit = FittedPrimitive(load_primitive("cup"), np.eye(4), label.scale, label.coefficients, 0.0)
    known, unknown = fit_features(fit), fit_features(fit, known=False)
    assert known.shape == unknown.shape == (FIT,)
    assert np.count_nonzero(unknown) == 3  # the scale
    change = np.ones(CHANGE)
    assert not np.allclose(mode_field(fit, change), mode_field(fit, change, known=False))


def test_a_step_of_training_lowers_the_loss_of_its_own_batch():
    torch.manual_seed(0)
    rng = np.random.default_rng(3)
    objects = _objects(*(_label(category, rng) for category in ("cup", "bottle")))
    network = PatchNet(32, layers=1)
    batch = next(augmented(shuffled(objects, 2))(torch.Generator().manual_seed(0)))
    optimiser = torch.optim.Adam(network.parameters(), lr=3e-3)
    losses = []
    for _ in range(30):
        optimiser.zero_grad()
        loss = point_loss(network, batch)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
