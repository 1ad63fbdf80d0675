"""Deformation to the number: what networks are told and answer, where contours end, which points are mirrored."""

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch
from moments import assert_known
from toy_bodies import detection_of, fit_of, l_body, moved_view, primitive_of
from toy_primitive import toy_cup_primitive
from toy_wedge import wedge_primitive

from gfp_grasp.deform import (
    BELIEF,
    DeformConfig,
    PaperNet,
    PatchAnswer,
    PatchNet,
    SnakeConfig,
    deform,
    evolve,
    fit_features,
    make_levers,
    make_network,
    make_patches,
    patch_layout,
    patch_unit_m,
    shape,
    solve_change,
    template_points,
)
from gfp_grasp.deform.gfpnet import change_field
from gfp_grasp.deform.patches import blend
from gfp_grasp.deform.shape import _blend_sigma, _offsets_to, damp_until_solid, diffuse, patch_tensors
from gfp_grasp.errors import InvalidOption
from gfp_grasp.level import make_level_view
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import apply_T, invert_T
from gfp_grasp.types import FittedPrimitive, LevelView

EYE = np.array([0.5, 0.3, 0.3])


@pytest.fixture(scope="module")
def fit() -> FittedPrimitive:
    return replace(
        fit_of(toy_cup_primitive(), scale=(1.2, 0.9, 1.1)), coefficients=np.array([0.6, -0.4, 0.2, 0.1, -0.3])
    )


@pytest.fixture(scope="module")
def seen_level(fit: FittedPrimitive) -> LevelView:
    """The side of the fitted cup that faces the eye, pushed out by up to 4 mm, in the level frame."""
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    normals = vertex_normals(vertices, fit.primitive.faces)
    seen = np.einsum("vi,vi->v", EYE - vertices, normals) > 0.3 * np.linalg.norm(EYE - vertices, axis=1)
    pushed = vertices + 0.002 * (1 + np.sin(60 * vertices[:, 2:])) * normals
    return make_level_view(detection_of(pushed[seen], EYE))


@pytest.fixture(scope="module")
def view(seen_level: LevelView) -> LevelView:
    """The same in the frame of the fit."""
    return moved_view(seen_level, seen_level.T_world_level)


def _patches(fit: FittedPrimitive, view: LevelView):
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    return make_patches(fit.primitive, vertices, template_points(fit, view), np.array([0.4, 0.2, 0.3]))


def test_options_are_those_that_the_committed_figures_were_measured_with() -> None:
    snake = {"steps": 12, "elastic": 0.3, "bending": 0.3, "pull": 1.0, "reach": 0.5, "tangential": 0.0, "smooth": 4}
    assert asdict(DeformConfig()) == {"method": "gfpnet", "symmetry": True, "iterations": None, "snake": snake}
    assert BELIEF == 0.75


@pytest.mark.parametrize("edge", [{"steps": 1}, {"smooth": 1}, {"elastic": 0.0}, {"bending": 0.0}, {"pull": 0.0}])
def test_energies_at_the_edge_of_what_can_be_are_some(edge: dict) -> None:
    assert SnakeConfig(**edge)
    assert DeformConfig(iterations=1)


def test_patches_hold_what_they_have_held(fit: FittedPrimitive, view: LevelView) -> None:
    patches = _patches(fit, view)
    for name, part in vars(patches).items():
        assert_known(f"patches {name}", part)
    index, weights = patch_layout(wedge_primitive())
    assert_known("patch layout", np.hstack([index, weights]))
    moved = 0.1 * np.sin(np.arange(patches.source.size)).reshape(patches.source.shape)
    assert_known("blend", np.column_stack(blend(patches, moved, len(fit.primitive.vertices))))


def test_vertices_that_no_patch_holds_stay_and_are_of_unknown_place(fit: FittedPrimitive, view: LevelView) -> None:
    patches, num_vertices = _patches(fit, view), len(fit.primitive.vertices)
    moved, weight = blend(patches, np.ones(patches.source.shape), num_vertices + 3)
    assert moved.shape == (num_vertices + 3, 3)
    assert not moved[-3:].any()
    assert not weight[-3:].any()
    sigma_m = _blend_sigma(patches, np.zeros(patches.index.shape), num_vertices + 3)
    assert np.isnan(sigma_m[-3:]).all()
    np.testing.assert_allclose(sigma_m[:-3], patches.unit_m)


def test_template_points_are_mirrored_as_ever(fit: FittedPrimitive, view: LevelView) -> None:
    found = template_points(fit, view)
    assert_known("template points", np.hstack([found.points, found.normals, found.mirrored[:, None]]))
    blind = replace(view, cloud=replace(view.cloud, viewpoint=None))
    assert_known("template points of no viewpoint", template_points(fit, blind).normals)


@pytest.mark.parametrize("method", ["gfpnet", "gfpnet-paper", "gfpnet-oneshot", "gfs"])
def test_methods_end_where_they_have_ended(
    monkeypatch: pytest.MonkeyPatch, fit: FittedPrimitive, seen_level: LevelView, method
) -> None:
    """Deformed in the level frame; without its feet on the floor, and with them."""
    T = seen_level.T_world_level
    level = replace(fit, T_world_object=invert_T(T) @ fit.T_world_object)
    found = deform(level, seen_level, config=DeformConfig(method=method))
    monkeypatch.setattr(shape, "stood", lambda vertices, faces, view: vertices)
    free = deform(level, seen_level, config=DeformConfig(method=method))
    assert_known(f"deformed {method}", apply_T(T, free.vertices), rel=1e-4)
    assert_known(f"deformed {method} sigma", np.nan_to_num(found.sigma_m, nan=1.0), rel=1e-3)
    assert_known(f"deformed {method} kept", [found.kept], rel=1e-4)
    assert_known(f"deformed {method} standing", apply_T(T, found.vertices), rel=1e-4)
    foot = fit.primitive.shape(fit.coefficients, fit.scale)[:, 2] < 1e-9
    np.testing.assert_allclose(found.vertices[~foot], free.vertices[~foot], atol=1e-12)
    lowered = (free.vertices - found.vertices)[foot]
    np.testing.assert_allclose(lowered[:, :2], 0.0, atol=1e-12)
    assert lowered[:, 2].min() > -1e-12
    assert 1e-4 < lowered[:, 2].max() < (2e-3 if method == "gfpnet-oneshot" else 1.1e-3)


def test_contours_end_where_they_have_ended() -> None:
    body = l_body(0.012)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    normals = vertex_normals(vertices, faces)
    points = vertices[::2] + (0.002 + 0.02 * vertices[::2, 2:]) * normals[::2]
    for name, config in (
        ("default", SnakeConfig()),
        ("other", SnakeConfig(steps=3, elastic=1.0, bending=0.1, pull=0.7, reach=0.3, tangential=0.4, smooth=2)),
    ):
        moved = evolve(vertices, faces, points, normals[::2], unit_m=0.02, config=config)
        assert_known(f"evolve {name}", moved - vertices)


def test_a_wild_wish_is_damped_as_ever() -> None:
    body = l_body(0.012)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    for size_m in (0.004, 0.012, 0.05):
        wish = size_m * np.sin(300 * vertices[:, [1, 2, 0]])
        moved, kept = damp_until_solid(vertices, faces, wish)
        assert_known(f"damped {size_m}", np.append(moved - vertices, kept), rel=1e-4)
    primitive = primitive_of(body)
    sure = (vertices[:, 2] > 0.06).astype(float) * 0.7
    assert_known("diffused", diffuse(primitive, 0.01 * np.sin(90 * vertices), sure), rel=1e-4)
    rng = np.random.default_rng(0)
    assert_known("offsets to sets", _offsets_to(rng.normal(size=(2, 30, 3)), rng.normal(size=(2, 30, 3))))


def test_what_the_network_is_told_of_a_fit_is_what_it_has_been_told(fit: FittedPrimitive) -> None:
    assert_known("fit features", fit_features(fit))
    wild = replace(fit_of(wedge_primitive(), scale=(4.0, 0.2, 1.0)), coefficients=np.array([1.0, 2.0, -3.0]))
    told = fit_features(wild)
    assert_known("fit features of a wedge", told)
    assert told[3] == 4.0
    assert told[4] == -4.0
    still = replace(primitive_of(l_body()), log_scale_cov=np.zeros((3, 3)))
    np.testing.assert_allclose(fit_features(fit_of(still))[6:9], np.log(0.01))
    assert fit_features(fit_of(primitive_of(l_body())))[-2:].tolist() == [0.0, 0.0]


def test_changes_of_a_fit_are_those_of_old(fit: FittedPrimitive, view: LevelView) -> None:
    patches, rng = _patches(fit, view), np.random.default_rng(0)
    shape = (1, *patches.index.shape)

    def some(*of: int) -> torch.Tensor:
        return torch.tensor(rng.normal(size=of), dtype=torch.float32)

    answer = PatchAnswer(some(*shape, 3), some(*shape), some(*shape), some(*shape), some(1, 3), torch.tensor([0.3]))
    assert_known("change field", change_field(fit, patches, answer), rel=1e-4)
    primitive = fit.primitive
    parts = (
        primitive.vertices,
        primitive.modes.transpose(1, 2, 0),
        fit.scale,
        fit.coefficients,
        primitive.log_scale_cov,
    )
    first, modes, scale, coefficients, covariance = (torch.tensor(np.array(p))[None] for p in parts)
    unit_m = torch.tensor([patch_unit_m(primitive)])
    levers = make_levers(first, modes, scale, coefficients, covariance, unit_m)
    assert_known("levers", levers.moves.numpy())
    assert_known("state of the levers", levers.state.numpy())
    normals = torch.tensor(rng.normal(size=(1, len(primitive.vertices), 3)))
    wide = answer._replace(
        advance=some(1, 1, len(primitive.vertices)).double(),
        log_weight=some(1, 1, len(primitive.vertices)).double(),
        log_ridge=answer.log_ridge.double(),
        recall=answer.recall.double(),
    )
    assert_known("solved change", solve_change(levers, normals, wide).numpy(), rel=1e-4)


def test_networks_answer_as_they_have_answered(fit: FittedPrimitive, view: LevelView) -> None:
    patches = _patches(fit, view)
    torch.manual_seed(0)
    network = PatchNet(16, layers=1).eval()
    first = [network.decode[-1], network.whole[-1]]
    assert [layer.bias.tolist() for layer in first] == [[0, 0, 0, 0, -0.5, 0, 0], [-1, -1, -1, -4]]  # type: ignore[union-attr]
    assert not any(layer.weight.any() for layer in first)  # type: ignore[union-attr, operator]
    for layer in first:
        torch.nn.init.normal_(layer.weight, std=12.0)  # type: ignore[arg-type]
    features = torch.tensor(fit_features(fit)[None], dtype=torch.float32)
    with torch.inference_mode():
        answer = network(*(part[None] for part in patch_tensors(patches)), features)
    for name, part in answer._asdict().items():
        assert_known(f"patch network {name}", part.numpy(), rel=1e-3)
    assert answer.log_weight.abs().max() == 4.0
    torch.manual_seed(0)
    paper = PaperNet((8, 1024), iterations=2, num_source=64).eval()
    source, _, template, *_ = patch_tensors(patches)
    with torch.inference_mode():
        assert_known("paper network", paper(source, template).numpy(), rel=1e-3)
        assert_known("paper network once", paper(source, template, iterations=1).numpy(), rel=1e-3)


def test_the_decoder_of_the_papers_network_follows_the_widths_of_its_encoders() -> None:
    network = PaperNet((8, 16), hidden=(32, 12), num_source=10).eval()
    layers = [(m.in_features, m.out_features) for m in network.decode if isinstance(m, torch.nn.Linear)]
    assert layers == [(32, 32), (32, 12), (12, 30)]
    assert network(torch.zeros(3, 10, 3), torch.zeros(3, 20, 3)).shape == (3, 10, 3)
    default = [m.in_features for m in PaperNet().decode if isinstance(m, torch.nn.Linear)]
    assert default == [2048, 1024, 512, 256]


def test_networks_have_the_sizes_of_their_variants() -> None:
    patch, iterative, oneshot = (make_network(name) for name in ("patch", "paper-iterative", "paper-oneshot"))
    assert isinstance(iterative, PaperNet)
    assert isinstance(oneshot, PaperNet)
    assert (iterative.iterations, oneshot.iterations) == (5, 1)
    dropouts = [m.p for net in (iterative, oneshot) for m in net.modules() if isinstance(m, torch.nn.Dropout)]
    assert dropouts == [0.3, 0.0]
    assert_known("sizes", [p.numel() for net in (patch, iterative, oneshot) for p in net.parameters()])
    assert not any(m.bias.any() for m in iterative.modules() if isinstance(m, torch.nn.Linear))
    with pytest.raises(InvalidOption, match="'patch'"):
        make_network("other")  # pyright: ignore[reportArgumentType]
