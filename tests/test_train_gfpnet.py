"""What a network learns is what the completion does with its answer."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from gfp_grasp.deform import (
    Levers,
    PatchAnswer,
    PatchNet,
    TemplatePoints,
    fit_features,
    make_levers,
    make_patches,
    solve_change,
)
from gfp_grasp.deform.gfpnet import NUM_FIT, change_field
from gfp_grasp.deform.shape import patch_tensors
from gfp_grasp.primitives import PrimitiveLibrary
from gfp_grasp.train import shuffled
from gfp_grasp.train.gfpnet import _field, point_loss
from gfp_grasp.train.labels import Label
from gfp_grasp.train.patch_data import Objects, PrimitiveTable, augmented, object_of
from gfp_grasp.types import FittedPrimitive, GenericPrimitive

LIBRARY = PrimitiveLibrary.shipped()
TABLE = PrimitiveTable.of(LIBRARY, LIBRARY.categories)


def _label(category: str, rng: np.random.Generator, *, without: tuple[str, ...] = ()) -> Label:
    primitive = TABLE.primitives[TABLE.number(category, without)]
    coefficients, scale = rng.normal(0, 0.5, len(primitive.modes)), np.exp(rng.normal(0, 0.1, 3))
    vertices = primitive.shape(coefficients, scale)
    points = vertices[vertices[:, 0] > 0]
    template = TemplatePoints(
        points, points / np.linalg.norm(points, axis=1, keepdims=True), np.zeros(len(points), bool)
    )
    target = vertices + np.array([0.001, 0.002, 0.003])
    return Label(category, without, vertices, target, template, np.array([1.0, 0, 0.5]), coefficients, scale)


def _objects(*labels: Label) -> Objects:
    columns = zip(*(object_of(label, TABLE) for label in labels), strict=True)
    parts = (torch.from_numpy(np.stack([np.asarray(part) for part in column])) for column in columns)
    return Objects(*(part.float() if part.is_floating_point() else part for part in parts))


def _answer(rng: np.random.Generator, num_objects: int, num_patches: int, num_points: int) -> PatchAnswer:
    shape = (num_objects, num_patches, num_points)

    def noise(*of: int) -> torch.Tensor:
        return torch.tensor(rng.normal(size=of), dtype=torch.float32)

    recall = torch.full((num_objects,), 0.1)
    return PatchAnswer(noise(*shape, 3), noise(*shape), noise(*shape), noise(*shape), noise(num_objects, 3), recall)


def _fit_of(label: Label) -> FittedPrimitive:
    primitive = TABLE.primitives[TABLE.number(label.primitive, label.without)]
    return FittedPrimitive(primitive, np.eye(4), label.scale, label.coefficients, 0.0)


def test_a_change_of_the_fit_moves_the_patches_of_training_as_it_moves_the_vertices_of_a_completion():
    rng = np.random.default_rng(0)
    names = ("cup", "cup.stemmed", "mug", "bottle", "bottle.jug")
    labels = [*(_label(name, rng) for name in names), _label("mug", rng, without=("handle",))]
    objects = _objects(*labels)
    answer = _answer(rng, *objects.source.shape[:3])
    patches = _field(objects, answer, torch.arange(objects.source.shape[2]), TABLE)
    for k, (label, moved) in enumerate(zip(labels, patches, strict=True)):
        fit = _fit_of(label)
        p = make_patches(fit.primitive, label.vertices, label.template, label.viewpoint)
        field = change_field(fit, p, PatchAnswer(*(part[k : k + 1] for part in answer)))
        wanted = np.einsum("bij,bni->bnj", p.frames, field[p.index]) / p.unit_m
        assert np.abs(moved.numpy() - wanted).max() < 2e-3 * np.abs(wanted).max()


def test_offsets_of_the_label_lead_from_the_source_to_the_target():
    label = _label("bottle", np.random.default_rng(1))
    objects = _objects(label)
    world = torch.einsum("opij,opnj->opni", objects.frames, objects.offset) * objects.unit_m[:, None, None, None]
    assert torch.allclose(world, torch.tensor([0.001, 0.002, 0.003]), atol=1e-6)


def _flat_levers(rng: np.random.Generator) -> tuple[Levers, torch.Tensor]:
    normals = rng.normal(size=(1, 200, 3))
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    moves = torch.tensor(rng.normal(size=(1, 200, 3, 9)))
    return Levers(moves, torch.tensor(rng.normal(size=(1, 9)))), torch.tensor(normals)


def _says(advance: torch.Tensor, *, log_ridge: float, recall: float = 0.0, log_weight: float = 0.0) -> PatchAnswer:
    nothing = torch.zeros(1, 1, 200, dtype=torch.float64)
    held = torch.full((1, 3), log_ridge, dtype=torch.float64)
    return PatchAnswer(
        nothing[..., None].expand(-1, -1, -1, 3),
        nothing,
        advance.view(1, 1, 200),
        nothing + log_weight,
        held,
        torch.full((1,), recall, dtype=torch.float64),
    )


def test_the_change_that_points_ask_for_is_found():
    levers, normals = _flat_levers(np.random.default_rng(0))
    change = torch.linspace(-1, 1, 9, dtype=torch.float64)
    advance = torch.einsum("oqi,oqiu,u->oq", normals, levers.moves, change)
    found = solve_change(levers, normals, _says(advance, log_ridge=-25.0))
    assert torch.allclose(found[0], change, atol=1e-6)


def test_a_fit_that_is_held_hard_goes_its_share_of_the_way_back_to_the_mean():
    levers, normals = _flat_levers(np.random.default_rng(1))
    found = solve_change(levers, normals, _says(torch.zeros(200), log_ridge=20.0, recall=0.25))
    assert torch.allclose(found, -0.25 * levers.state, atol=1e-6)


def test_points_without_weight_change_nothing():
    levers, normals = _flat_levers(np.random.default_rng(2))
    found = solve_change(levers, normals, _says(torch.ones(200), log_ridge=0.0, log_weight=-40.0))
    assert torch.allclose(found, torch.zeros_like(found), atol=1e-9)


def test_levers_are_the_derivative_of_the_shape():
    primitive = LIBRARY.primitive("mug")
    rng = np.random.default_rng(3)
    coefficients, scale = rng.normal(size=len(primitive.modes)), np.exp(rng.normal(0, 0.1, 3))
    levers = make_levers(
        torch.tensor(primitive.shape(coefficients, scale))[None],
        torch.tensor(primitive.modes.transpose(1, 2, 0))[None],
        torch.tensor(scale)[None],
        torch.tensor(coefficients)[None],
        torch.tensor(primitive.log_scale_cov)[None],
        torch.tensor([0.03], dtype=torch.float64),
    )
    change = 1e-5 * rng.normal(size=6 + len(primitive.modes))
    spread = np.linalg.cholesky(primitive.log_scale_cov + 1e-4 * np.eye(3))
    moved = primitive.shape(coefficients + change[6:], scale * np.exp(spread @ change[:3])) + 0.003 * change[3:6]
    wanted = (moved - primitive.shape(coefficients, scale)) / 0.003
    found = (levers.moves[0] @ torch.tensor(change)).numpy()
    assert np.abs(found - wanted).max() < 1e-3 * np.abs(wanted).max()
    # The state is where the levers stand: that much back, and the shape has the class's mean scale and modes.
    np.testing.assert_allclose(spread @ levers.state[0, :3].numpy(), np.log(scale), atol=1e-12)
    np.testing.assert_allclose(levers.state[0, 6:].numpy(), coefficients)


def _reordered(primitive: GenericPrimitive, order: np.ndarray) -> GenericPrimitive:
    samples = primitive.coefficient_samples
    return replace(
        primitive,
        modes=primitive.modes[order],
        explained=primitive.explained[order],
        coefficient_samples=np.hstack([samples[:, order], samples[:, -3:]]),
    )


@pytest.mark.parametrize("category", ["cup", "bottle"])
def test_the_order_of_modes_means_nothing(category):
    label = _label(category, np.random.default_rng(2))
    fit = _fit_of(label)
    order = np.random.default_rng(0).permutation(len(fit.coefficients))
    same = replace(fit, primitive=_reordered(fit.primitive, order), coefficients=fit.coefficients[order])
    torch.manual_seed(0)
    network = PatchNet(32, layers=1).eval()
    last = network.decode[1]
    assert isinstance(last, torch.nn.Linear)
    torch.nn.init.normal_(last.weight, std=0.1)
    fields = []
    for own in (fit, same):
        patches = make_patches(own.primitive, label.vertices, label.template, label.viewpoint)
        features = torch.tensor(fit_features(own)[None], dtype=torch.float32)
        with torch.inference_mode():
            answer = network(*(part[None] for part in patch_tensors(patches)), features)
        fields.append(change_field(own, patches, answer))
    assert np.abs(fields[0]).max() > 1e-5
    np.testing.assert_allclose(fields[0], fields[1], atol=1e-7)


def test_what_is_told_of_a_fit_has_no_unit():
    label = _label("cup", np.random.default_rng(2))
    fit = _fit_of(label)
    told = fit_features(fit)
    assert told.shape == (NUM_FIT,)
    primitive = fit.primitive
    large = replace(primitive, vertices=40 * primitive.vertices, modes=40 * primitive.modes)
    np.testing.assert_allclose(fit_features(replace(fit, primitive=large)), told, rtol=1e-9)


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
        loss = point_loss(network, batch, table=TABLE)
        loss.backward()
        optimiser.step()
        losses.append(float(loss.detach()))
    assert losses[-1] < 0.7 * losses[0]
