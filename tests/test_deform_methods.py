"""What `deform` makes of the answers of networks, which are known here: a cup in the level frame, turned about z."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from scipy.spatial import KDTree
from toy_bodies import T_WORLD_OBJECT, detection_of, fit_of, moved_view
from toy_primitive import toy_cup_primitive

from gfp_grasp.deform import DeformConfig, Method, deform, patch_layout, patch_unit_m
from gfp_grasp.deform import shape as methods
from gfp_grasp.deform import weights as networks
from gfp_grasp.level import make_level_view
from gfp_grasp.meshes import vertex_normals
from gfp_grasp.transforms import invert_T, make_T, rotation_about

EYE = np.array([0.5, 0.3, 0.3])  # in the cup's frame
SCALE = np.array([1.2, 0.9, 1.1])


@pytest.fixture(scope="module")
def view():
    """The side of the cup that faces the eye, pushed out by 1 mm."""
    cup = fit_of(toy_cup_primitive(), scale=SCALE)
    vertices = cup.primitive.shape(cup.coefficients, cup.scale)
    normals = vertex_normals(vertices, cup.primitive.faces)
    seen = np.einsum("vi,vi->v", EYE - vertices, normals) > 0.3 * np.linalg.norm(EYE - vertices, axis=1)
    return make_level_view(detection_of((vertices + 0.001 * normals)[seen], EYE))


@pytest.fixture(scope="module")
def fit(view):
    return fit_in(view)


def fit_in(view):
    """The cup where it is in the level frame of a view."""
    return fit_of(toy_cup_primitive(), T=invert_T(view.T_world_level) @ T_WORLD_OBJECT, scale=SCALE)


class Answering:
    """Stands for a network: keeps what it is asked and gives what `answer` makes of it."""

    def __init__(self, monkeypatch, answer):
        self.names, self.asked, self.answer = [], [], answer
        monkeypatch.setattr(networks, "load_network", self._load)

    def _load(self, name):
        self.names.append(name)
        return self

    def __call__(self, *parts, **options):
        self.asked.append((parts, options))
        return self.answer(*parts)


def answer_per_point(monkeypatch, offset, log_sigma: float | np.ndarray = 0.0, field=0.0):
    """Let the default method say this of every point of every patch (patch frame and unit), and of the fit as a whole.

    Returns:
        The patches that it was asked about, as they come.
    """
    asked = []

    def answer(patches, fit):
        asked.append(patches)
        return (
            np.broadcast_to(np.asarray(offset, dtype=float), patches.source.shape),
            np.broadcast_to(np.asarray(log_sigma, dtype=float), patches.index.shape),
            np.broadcast_to(np.asarray(field, dtype=float), fit.primitive.vertices.shape),
        )

    monkeypatch.setattr(methods, "_per_point", answer)
    return asked


def displacement_of(deformed, fit):
    """(v, 3) m in the frame of the object."""
    return (deformed.vertices - fit.vertices_world()) @ fit.T_world_object[:3, :3]


def test_no_method_leaves_the_fit_as_it_is(fit, view):
    deformed = deform(fit, view, config=DeformConfig(method="none"))
    np.testing.assert_allclose(deformed.vertices, fit.vertices_world(), rtol=0, atol=1e-15)
    assert np.isnan(deformed.sigma_m).all()
    assert deformed.kept == 1.0


def test_offsets_of_the_patches_are_blended_and_diffused_along_the_patches_normals(monkeypatch, fit, view):
    """All patches say 0.04 units along their own normals: the surface grows by about that much."""
    step = 0.04 * patch_unit_m(fit.primitive)
    answer_per_point(monkeypatch, (0, 0, 0.04))
    deformed = deform(fit, view)
    assert deformed.kept == 1.0
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    along = np.einsum("vi,vi->v", displacement_of(deformed, fit), vertex_normals(vertices, fit.primitive.faces))
    wall = (vertices[:, 2] > 0.03) & (vertices[:, 2] < 0.06)
    assert np.median(along[wall]) == pytest.approx(step, rel=0.12)
    assert along[wall] == pytest.approx(np.full(wall.sum(), step), rel=0.35)


@pytest.mark.parametrize("method", ["gfpnet", "gfpnet-paper"])
def test_a_vertex_is_as_sure_as_the_patches_that_hold_it_weigh_but_no_surer_than_one(monkeypatch, fit, view, method):
    """All patches answer, those as well that see nothing."""
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    answer_per_point(monkeypatch, (0, 0, 0))
    Answering(monkeypatch, lambda source, template: source)
    told = []
    monkeypatch.setattr(methods, "diffuse", lambda primitive, wished, sure: told.append(sure) or wished)
    monkeypatch.setattr(methods.Patches, "seeing", lambda patches: patches)
    deform(fit, view, config=DeformConfig(method=method))
    index, weights = patch_layout(fit.primitive)
    total = np.bincount(index.ravel(), weights.ravel(), minlength=len(vertices))
    assert total.max() > 2
    assert told[0] == pytest.approx(np.minimum(total, 1.0))


def test_an_offset_of_one_point_is_believed_up_to_a_fifteenth_of_the_unit(monkeypatch, fit, view):
    """The default network's own answer, as it is and ten thousand times as large."""
    real = networks.load_network("patch")
    given = []

    def enlarged(*parts, **options):
        answer = real(*parts, **options)
        given.append(answer[0].numpy())
        many = (10_000 * answer[0], *answer[1:])
        return type(answer)(*many) if hasattr(answer, "_fields") else many

    asked = []
    per_point = methods._per_point
    monkeypatch.setattr(methods, "_per_point", lambda *a: asked.append(per_point(*a)) or asked[-1])
    deform(fit, view)
    monkeypatch.setattr(networks, "load_network", lambda name: enlarged)
    deform(fit, view)
    (own, _, _), (held, _, _) = asked
    assert np.linalg.norm(own, axis=2).max() <= 1 / 15 + 1e-9
    assert np.linalg.norm(held, axis=2) == pytest.approx(np.full(held.shape[:2], 1 / 15), rel=1e-6)
    direction = given[0][0] / np.linalg.norm(given[0][0], axis=2, keepdims=True)
    assert 15 * held == pytest.approx(direction, abs=1e-4)


def test_sigma_is_what_the_network_says_in_metres(monkeypatch, fit, view):
    answer_per_point(monkeypatch, (0, 0, 0), log_sigma=-2.5)
    sigma_m = deform(fit, view).sigma_m
    assert sigma_m == pytest.approx(np.full(len(sigma_m), np.exp(-2.5) * patch_unit_m(fit.primitive)))


def test_sigma_of_a_vertex_is_the_weighted_mean_in_logarithms_of_the_patches_that_hold_it(monkeypatch, fit, view):
    index, weights = patch_layout(fit.primitive)
    answer_per_point(monkeypatch, (0, 0, 0), log_sigma=np.arange(len(index))[:, None] / 20 - 4)
    sigma_m = deform(fit, view).sigma_m
    for vertex in (0, 100, 333, 700):
        patch, place = np.nonzero(index == vertex)
        mean = np.average(patch / 20 - 4, weights=weights[patch, place])
        assert sigma_m[vertex] == pytest.approx(np.exp(mean) * patch_unit_m(fit.primitive))


def test_a_change_of_the_fit_moves_all_vertices(monkeypatch, fit, view):
    """The change is a growth along y by 2 %, in the frame of the object."""
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    grown = 0.02 * vertices * (0, 1, 0)
    answer_per_point(monkeypatch, (0, 0, 0), field=grown)
    moved = displacement_of(deform(fit, view), fit)
    assert moved[:, 1] == pytest.approx(grown[:, 1], abs=2e-4)
    assert np.abs(moved[:, [0, 2]]).max() < 2e-4
    assert np.corrcoef(moved[:, 1], grown[:, 1])[0, 1] > 0.99


@pytest.mark.parametrize(
    ("metrics", "share"),
    [
        ({"cup_error_before_mm": 2.0, "cup_error_after_mm": 1.89}, 1.0),
        ({"cup_error_before_mm": 2.0, "cup_error_after_mm": 1.91}, 0.0),
        ({"mug_error_before_mm": 2.0, "mug_error_after_mm": 1.91}, 1.0),  # it never met a cup
    ],
)
def test_a_primitive_on_which_the_network_gained_less_than_a_twentieth_is_not_moved(
    monkeypatch, fit, view, metrics, share
):
    monkeypatch.setattr(networks, "load_card", lambda variant: {"metrics": metrics})
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    grown = 0.02 * vertices * (0, 1, 0)
    answer_per_point(monkeypatch, (0, 0, 0), log_sigma=-2.5, field=grown)
    deformed = deform(fit, view)
    assert displacement_of(deformed, fit)[:, 1] == pytest.approx(share * grown[:, 1], abs=2e-4)
    assert deformed.sigma_m == pytest.approx(np.full(len(grown), np.exp(-2.5) * patch_unit_m(fit.primitive)))


def test_the_network_is_told_of_the_viewpoint_in_the_frame_of_the_object(monkeypatch, fit, view):
    patches = answer_per_point(monkeypatch, (0, 0, 0))
    deform(fit, view)
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    sight = EYE - vertices[patch_layout(fit.primitive)[0][:, 0]]
    sight /= np.linalg.norm(sight, axis=1, keepdims=True)
    assert patches[0].pose_features[:, 3:6] == pytest.approx(sight)


def test_points_a_millimetre_outside_are_residuals_of_a_millimetre(monkeypatch, fit, view):
    asked = answer_per_point(monkeypatch, (0, 0, 0))
    deform(fit, view)
    (p,) = asked
    seen = p.residuals[..., 3] > 0.9
    assert np.median(p.residuals[seen][:, 0]) == pytest.approx(0.001 / (0.1 * p.unit_m), rel=0.1)


def test_the_network_is_given_the_patches_as_they_are_made(monkeypatch, fit, view):
    asked = answer_per_point(monkeypatch, (0, 0, 0))
    deform(fit, view)
    (p,) = asked
    parts = (p.source, p.source_normals, p.template, p.template_normals, p.mirrored, p.residuals, p.pose_features)
    for given, part in zip(methods.patch_tensors(p), parts, strict=True):
        assert given.dtype == torch.float32
        assert given.numpy() == pytest.approx(part.astype(np.float32))


@pytest.mark.parametrize(
    ("method", "name", "iterations"),
    [("gfpnet-paper", "paper-iterative", 3), ("gfpnet-oneshot", "paper-oneshot", None)],
)
def test_the_papers_methods_run_their_own_networks(monkeypatch, fit, view, method, name, iterations):
    network = Answering(monkeypatch, lambda source, template: source)
    deformed = deform(fit, view, config=DeformConfig(method=method, iterations=3))
    assert network.names == [name]
    assert network.asked[0][1] == {"iterations": iterations}
    assert np.abs(deformed.vertices - fit.vertices_world()).max() < 1e-6  # the set is the source itself
    assert np.isnan(deformed.sigma_m).all()


def test_the_papers_network_sees_only_patches_with_points_and_what_it_says_is_diffused(monkeypatch, fit):
    """Only a spot of the wall was seen: patches that see nothing hold vertices that no answer reaches."""
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    middle = np.argmax(vertices @ (0.5, 0.3, 0.0) - np.abs(vertices[:, 2] - 0.06))
    spot = vertices[:320][np.linalg.norm(vertices[:320] - vertices[middle], axis=1) < 0.026]
    network = Answering(monkeypatch, lambda source, template: source + torch.tensor([0.0, 0.0, 0.03]))
    view = make_level_view(detection_of(spot, EYE))
    fit = fit_in(view)
    deformed = deform(fit, view, config=DeformConfig(method="gfpnet-paper"))
    moved = np.linalg.norm(displacement_of(deformed, fit), axis=1)
    index, _ = patch_layout(fit.primitive)
    assert 1 <= len(network.asked[0][0][0]) < len(index) / 2
    a, b = fit.primitive.faces[:, 0], fit.primitive.faces[:, 1]
    assert (moved < 1e-4 * moved.max()).mean() < 0.2  # but for diffusion it would be most of them
    assert np.abs(moved[a] - moved[b]).max() < 0.7 * moved.max()


def test_symmetry_is_used_where_it_is_asked_for_and_never_by_the_papers_methods(monkeypatch, fit, view):
    asked, template_points = [], methods.template_points

    def spied(*parts, symmetry):
        asked.append(symmetry)
        return template_points(*parts, symmetry=symmetry)

    monkeypatch.setattr(methods, "template_points", spied)
    answer_per_point(monkeypatch, (0, 0, 0))
    Answering(monkeypatch, lambda source, template: source)
    asked_for: tuple[tuple[Method, bool], ...] = (
        ("gfpnet", True),
        ("gfpnet", False),
        ("gfpnet-paper", True),
        ("gfpnet-oneshot", True),
    )
    for method, symmetry in asked_for:
        deform(fit, view, config=DeformConfig(method=method, symmetry=symmetry))
    deform(fit, view, config=DeformConfig(method="gfs", symmetry=False))
    assert asked == [True, False, False, False, False]


def test_a_predicted_set_pulls_each_point_by_the_mean_of_its_neighbourhood(fit, view):
    """The set is the source, every other point of it lifted: what a point alone would say, eight of them even out."""
    rng = np.random.default_rng(0)
    source = np.concatenate([rng.uniform(-1, 1, (2, 64, 2)), np.zeros((2, 64, 1))], axis=2)
    predicted = source.copy()
    predicted[:, ::2, 2] += 0.01
    order = rng.permutation(64)
    offsets = methods._offsets_to(predicted[:, order], source)
    for own, answer in zip(source, offsets, strict=True):
        near = KDTree(own).query(own, k=8)[1]
        assert answer[:, 2] == pytest.approx(0.01 * (near % 2 == 0).mean(axis=1))
        assert answer[:, :2] == pytest.approx(np.zeros((64, 2)))


def test_the_contour_draws_the_seen_side_out_and_leaves_the_far_side(fit, view):
    config = DeformConfig(method="gfs", symmetry=False)
    deformed = deform(fit, view, config=config)
    vertices = fit.primitive.shape(fit.coefficients, fit.scale)
    normals = vertex_normals(vertices, fit.primitive.faces)
    along = np.einsum("vi,vi->v", displacement_of(deformed, fit), normals)
    facing = np.einsum("vi,vi->v", EYE - vertices, normals) / np.linalg.norm(EYE - vertices, axis=1)
    outside = np.arange(len(vertices)) < 300
    assert np.median(along[outside & (facing > 0.6)]) == pytest.approx(0.001, abs=3e-4)
    assert np.abs(along[outside & (facing < -0.6)]).max() < 3e-4
    assert np.isnan(deformed.sigma_m).all()


@pytest.mark.parametrize("stands", [False, True])
def test_deformation_turns_with_the_scene(monkeypatch, fit, view, stands):
    """The default network's answer is the same in the object's frame wherever the object lies; its feet want z up."""
    if not stands:
        monkeypatch.setattr(methods, "stood", lambda vertices, faces, view: vertices)
    T = make_T(rotation_about((0, 0, 1), 2.3), (-3.0, 1.0, 0.2)) if stands else T_WORLD_OBJECT
    here = displacement_of(deform(fit, view), fit)
    there = replace(fit, T_world_object=T)
    moved = displacement_of(deform(there, moved_view(view, T @ invert_T(fit.T_world_object))), there)
    assert np.abs(here).max() > 2e-4
    assert np.abs(moved - here).max() < 0.1 * np.abs(here).max()


@pytest.mark.parametrize("method", ["none", "gfpnet", "gfs"])
def test_what_stands_is_put_where_it_stands_in_the_level_frame(monkeypatch, fit, view, method):
    """The whole cup goes 3 mm aside and 2 mm down, after its deformation and in the axes of the level frame."""
    config, step, asked = DeformConfig(method=method), np.array([0.003, -0.001, -0.002]), []
    monkeypatch.setattr(methods, "stood", lambda vertices, faces, view: vertices)
    free = deform(fit, view, config=config)

    def moved(vertices, faces, seen):
        asked.append((vertices, faces is fit.primitive.faces, seen is view))
        return vertices + step

    monkeypatch.setattr(methods, "stood", moved)
    placed = deform(fit, view, config=config)
    ((vertices, *same),) = asked
    assert same == [True, True]
    assert free.kept == placed.kept == 1.0
    assert vertices == pytest.approx(free.vertices, abs=1e-12)
    assert placed.vertices == pytest.approx(free.vertices + step, abs=1e-12)


@pytest.mark.parametrize("method", ["none", "gfpnet", "gfs"])
def test_feet_that_a_method_leaves_above_the_floor_come_to_lie_in_it(monkeypatch, fit, view, method):
    """Every vertex of the cup's foot, and only these: the rest is where the method put it."""
    foot = fit.primitive.shape(fit.coefficients, fit.scale)[:, 2] < 1e-9
    seen = replace(view, floor_seen=True)
    lift = make_T(None, (0, 0, 0.0002 - fit.vertices_world()[:, 2].min()))
    lifted = replace(fit, T_world_object=lift @ fit.T_world_object)
    deformed = deform(lifted, seen, config=DeformConfig(method=method))
    monkeypatch.setattr(methods, "stood", lambda vertices, faces, view: vertices)
    free = deform(lifted, seen, config=DeformConfig(method=method))
    assert deformed.vertices[~foot] == pytest.approx(free.vertices[~foot], abs=1e-12)
    assert deformed.vertices[foot, :2] == pytest.approx(free.vertices[foot, :2], abs=1e-12)
    low = foot & (free.vertices[:, 2] < 0.0003)
    assert low.sum() > 5
    assert deformed.vertices[low, 2] == pytest.approx(np.zeros(low.sum()), abs=1e-12)


@pytest.mark.parametrize("iterations", [0, -1])
def test_no_iterations_are_refused(iterations):
    with pytest.raises(Exception, match="iterations"):
        DeformConfig(method="gfpnet-paper", iterations=iterations)
