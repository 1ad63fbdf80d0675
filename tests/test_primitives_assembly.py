"""A build step by step: who is dropped and why, what each step is handed, and what the primitive and its card say."""

from collections import Counter
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from moments import assert_known, bent
from revolved import cup
from toy_bodies import l_body

from gfp_grasp.errors import BuildFailed, InvalidMesh, InvalidOption
from gfp_grasp.primitives import BuildConfig, PrimitiveLibrary, build, build_primitive, with_parts
from gfp_grasp.primitives.build import _assemble, _correspond, _into_frame, _mean_mesh, _repair, _smooth, _vertex_areas
from gfp_grasp.primitives.correspondence import Correspondence, CorrespondenceConfig
from gfp_grasp.primitives.procrustes import shape_model
from gfp_grasp.primitives.remesh import RemeshConfig
from gfp_grasp.primitives.resample import ResampleConfig
from gfp_grasp.transforms import rotation_about
from gfp_grasp.types import GenericPrimitive

PLAIN = BuildConfig(parts=False)


def _mug_members(count: int = 7) -> tuple[np.ndarray, np.ndarray]:
    """Corresponded mugs (s, v, 3) of the shipped class; the last of them is far off the others. Faces."""
    mugs = PrimitiveLibrary.shipped().primitive("mug")
    samples = np.array(mugs.coefficient_samples[:count])
    samples[-1, :3] = [4.0, -3.0, 3.0]
    shapes = np.stack([mugs.shape(row[:-3], np.exp(row[-3:])) for row in samples])
    return shapes + np.array([0.0, 0.0, 0.2]), np.asarray(mugs.faces)


@pytest.fixture(scope="module")
def assembled() -> tuple[GenericPrimitive, list]:
    """A primitive of mugs, without the thinning out; and what that was asked for."""
    members, faces = _mug_members()
    asked: list = []

    def all_of_them(shapes, given, rng, *, config):
        asked.append((shapes, config))
        return np.eye(shapes.shape[1]), given, 0.00034567

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(build, "resample", all_of_them)
        config = replace(PLAIN, licence="MIT", resample=ResampleConfig(max_error_m=0.0007))
        placed = _into_frame(members, faces, config)
        np.testing.assert_allclose(placed[..., 2].min(axis=1), 0.0, atol=1e-12)
        model = shape_model(placed, _vertex_areas(placed.mean(axis=0), faces))
        made = _assemble(
            model, faces, "mug.odd", config, np.random.default_rng(0), num_given=9, dropped=Counter({"folds": 2})
        )
    return made, asked


def test_what_is_thinned_out_are_the_mean_and_two_deviations_of_its_first_modes(assembled) -> None:
    primitive, ((shapes, config),) = assembled
    assert config == ResampleConfig(max_error_m=0.0007)
    assert len(shapes) == 1 + 2 * min(6, len(primitive.modes))
    np.testing.assert_allclose(shapes[0], primitive.vertices, atol=1e-12)
    for k, mode in enumerate(primitive.modes[:6]):
        np.testing.assert_allclose(shapes[1 + 2 * k], primitive.vertices + 2 * mode, atol=1e-12)
        np.testing.assert_allclose(shapes[2 + 2 * k], primitive.vertices - 2 * mode, atol=1e-12)


def test_a_primitive_is_put_together_as_ever(assembled) -> None:
    primitive, _ = assembled
    assert (primitive.category, primitive.subcategory, primitive.licence) == ("mug", "odd", "MIT")
    assert primitive.region_names == ("outside", "inside", "handle")
    assert primitive.vertices[:, 2].min() == 0.0
    np.testing.assert_array_equal(primitive.up, [0, 0, 1])
    for name in ("vertices", "modes", "log_scale_cov", "coefficient_samples", "regions", "explained"):
        assert_known(f"assembled {name}", getattr(primitive, name))
    assert (primitive.symmetry.order, primitive.symmetry.mirror_normal is not None) == (1, True)


def test_a_body_without_its_handle_is_a_variant_with_the_same_statistics(assembled) -> None:
    primitive, _ = assembled
    (variant,) = primitive.variants
    assert variant.without == ("handle",)
    body = variant.primitive
    assert body.spec == primitive.spec
    np.testing.assert_array_equal(body.vertices, primitive.vertices[variant.vertex_map])
    np.testing.assert_array_equal(body.modes, primitive.modes[:, variant.vertex_map])
    np.testing.assert_array_equal(body.regions, primitive.regions[variant.vertex_map])
    np.testing.assert_array_equal(body.log_scale_cov, primitive.log_scale_cov)
    assert body.symmetry.order > 1
    assert trimesh.Trimesh(body.vertices, body.faces, process=False).euler_number == 2


def test_the_card_counts_members_and_measures_what_was_lost(assembled) -> None:
    primitive, _ = assembled
    card = dict(primitive.card)
    assert card.pop("variance_kept") == pytest.approx(float(primitive.explained.sum()))
    assert card == {
        "meshes_given": 9,
        "members_used": 7,
        "members_dropped": {"folds": 2},
        "outliers": 1,
        "vertices": len(primitive.vertices),
        "faces": len(primitive.faces),
        "modes": len(primitive.modes),
        "rms_after_scale_mm": 5.475,
        "smoothing_moved_mm": 0.1135,
        "resampling_error_mm": 0.3457,
        "dense_vertices": len(primitive.vertices),
    }


def test_a_mean_is_smoothed_over_its_own_edges() -> None:
    mesh = bent(l_body(0.012))
    rough = np.asarray(mesh.vertices) + 4e-4 * np.random.default_rng(0).normal(size=mesh.vertices.shape)
    assert_known("smooth", _smooth(rough, np.asarray(mesh.faces), 0.75))
    assert_known("smooth wider", _smooth(rough, np.asarray(mesh.faces), 1.5))
    np.testing.assert_array_equal(_smooth(rough, np.asarray(mesh.faces), 0.0), rough)


def test_the_area_of_a_mesh_is_shared_among_its_vertices() -> None:
    areas = _vertex_areas(
        np.array([[0, 0, 0], [2.0, 0, 0], [0, 3, 0], [9, 9, 9], [2, 3, 0]]), np.array([[0, 1, 2], [1, 4, 2]])
    )
    np.testing.assert_allclose(areas, [1, 2, 2, 0, 1])


@pytest.mark.parametrize("orientation", ["upright", "any"])
def test_corresponded_members_are_turned_onto_each_other_and_stand(orientation) -> None:
    members, faces = _mug_members(4)
    turns = [rotation_about((0, 0, 1) if orientation == "upright" else (1.0, 0.3, 2.0), 0.4 * k) for k in range(4)]
    turned = np.stack([v @ R.T for v, R in zip(members, turns, strict=True)])
    placed = _into_frame(turned, faces, replace(PLAIN, orientation=orientation))
    np.testing.assert_allclose(placed[..., 2].min(axis=1), 0.0, atol=1e-9)
    assert_known(f"into frame {orientation}", placed, rel=1e-4)
    mean = _mean_mesh(turned, faces, replace(PLAIN, orientation=orientation, smoothing=0.3))
    assert_known(f"mean mesh {orientation}", mean.vertices, rel=1e-4)


def test_members_are_dropped_for_what_is_wrong_with_their_fits(monkeypatch: pytest.MonkeyPatch) -> None:
    template = trimesh.creation.box((0.03, 0.04, 0.12))  # the diagonal is 0.13 m
    config = replace(PLAIN, max_residual=0.01, min_covered=0.9, max_flipped=0.1)
    verdicts = [(0.0012, 0.91, 0.09), (0.0014, 0.95, 0.0), (0.001, 0.89, 0.0), (0.001, 0.95, 0.11), (0.0013, 0.9, 0.1)]
    waiting = iter(verdicts)
    sizes: list[float] = []

    class Fitter:
        def __init__(self, mesh, *, config, seed) -> None:
            assert (mesh is template, config.steps, seed) == (True, 5, 7)

        def fit(self, member) -> Correspondence:
            sizes.append(float(np.linalg.norm(member.extents)))
            return Correspondence(np.array(template.vertices), *next(waiting))

    monkeypatch.setattr(build, "TemplateFitter", Fitter)
    members = [template.copy().apply_scale(1 + 0.1 * k) for k in range(5)]
    dropped: Counter[str] = Counter()
    watched: list[int] = []
    config = replace(config, correspondence=CorrespondenceConfig(steps=5))
    vertices, faces = _correspond(
        template, members, dropped, config, 7, lambda stream, total: (watched.append(total), stream)[1]
    )
    np.testing.assert_allclose(sizes, 0.13)
    assert watched == [5]
    np.testing.assert_allclose(vertices, np.stack([template.vertices, 1.4 * template.vertices]))
    np.testing.assert_array_equal(faces, template.faces)
    assert dropped == {
        "template does not reach it": 1,
        "lacks surface that the template has": 1,
        "folds the template": 1,
    }


def test_what_cannot_be_repaired_is_counted_and_what_is_sound_stays_as_it_is() -> None:
    flat = trimesh.Trimesh([[0, 0, 0], [1, 0, 0], [0, 1, 0]], [[0, 1, 2]])
    sound = l_body(0.03)
    two = trimesh.util.concatenate([cup(sections=12), cup(sections=12).apply_translation((0.02, 0, 0))])
    dropped: Counter[str] = Counter()
    solids = _repair([sound, flat, two], dropped)  # pyright: ignore[reportArgumentType]
    assert dropped == {"not repaired: InvalidMesh": 1}
    np.testing.assert_array_equal(solids[0].vertices, sound.vertices)
    assert [solid.body_count for solid in solids] == [1, 1]


@pytest.mark.parametrize("rounds", [1, 3])
def test_each_round_bends_the_mean_of_the_last_and_the_last_counts_who_is_lost(monkeypatch, rounds: int) -> None:
    members = [l_body(0.03).apply_scale(1 + 0.02 * k) for k in range(6)]
    for k, member in enumerate(members):  # no two of them are one mesh in two shapes
        member.faces = np.roll(member.faces, k, axis=0)
    steps: list[str] = []
    remesh_config = RemeshConfig(min_edge=0.02)
    config = replace(PLAIN, rounds=rounds, remesh=remesh_config, variance=0.8, max_modes=5, parts=rounds == 3)

    def correspond(template, given, lost, own, seed, progress):
        steps.append("correspond")
        assert (len(given), own, seed, progress) == (6, config, 4, None)
        lost["once more"] += 1
        return np.stack([m.vertices for m in given[:5]]), np.asarray(template.faces)

    def remesh(mesh, rng, *, config):
        steps.append("remesh")
        assert config == remesh_config
        return mesh

    def assemble(model, faces, category, own, rng, *, num_given, dropped):
        steps.append("assemble")
        assert (category, own, num_given, dropped) == ("toy", config, 6, {"once more": 1})
        return SimpleNamespace()

    def model_of(placed, areas, **knobs):
        if "variance" in knobs:
            assert knobs == {"variance": 0.8, "max_modes": 5}
        return shape_model(placed, areas, **knobs)

    for name, fake in (
        ("_correspond", correspond),
        ("remesh", remesh),
        ("_assemble", assemble),
        ("shape_model", model_of),
    ):
        monkeypatch.setattr(build, name, fake)
    monkeypatch.setattr(build, "with_parts", lambda primitive: (steps.append("parts"), primitive)[1])
    build_primitive(members, "toy", config=config, seed=4)
    assert steps == ["remesh", "correspond"] * rounds + ["assemble"] + ["parts"] * (rounds == 3)


def test_a_mean_that_crosses_itself_is_no_primitive(monkeypatch: pytest.MonkeyPatch) -> None:
    members, faces = _mug_members()
    model = shape_model(members, _vertex_areas(members.mean(axis=0), faces))
    monkeypatch.setattr(
        build, "resample", lambda shapes, given, rng, *, config: (np.eye(len(shapes[0])), given[3:], 0.0)
    )
    with pytest.raises(BuildFailed, match="mean mug is no clean volume"):
        _assemble(model, faces, "mug", PLAIN, np.random.default_rng(0), num_given=9, dropped=Counter())


def test_parts_come_at_every_level_for_the_primitive_and_its_variants(assembled, monkeypatch) -> None:
    primitive, _ = assembled
    seen: list[int] = []
    part = SimpleNamespace(
        parts=primitive.parts, merges=np.array([[0, 1]]), errors_m=np.array([[0.1, 0.2], [0.1, 0.1]])
    )
    kept: list[dict] = []

    def levels(mesh):
        seen.append(len(mesh.vertices))
        return part

    bound: list[object] = []
    monkeypatch.setattr("gfp_grasp.collision.part_levels", levels)
    monkeypatch.setattr("gfp_grasp.collision.with_binding", lambda primitive: (bound.append(primitive), primitive)[1])
    monkeypatch.setattr(build, "replace", lambda of, **fields: (kept.append(fields), of)[1])
    with_parts(primitive)
    assert seen == [len(primitive.vertices), len(primitive.variants[0].primitive.vertices)]
    whole = next(fields for fields in kept if "variants" in fields and len(fields["variants"]))
    assert (whole["parts"], whole["part_merges"], whole["part_errors_m"]) == (part.parts, part.merges, part.errors_m)
    assert bound == [primitive.variants[0].primitive, primitive]
    assert all(fields["binding"] is None for fields in kept if "parts" in fields)


@pytest.mark.parametrize(
    "nonsense", [{"rounds": 0}, {"variance": 0.0}, {"variance": 1.01}, {"max_modes": 0}, {"min_members": 1}]
)
def test_a_build_that_cannot_be_is_refused(nonsense: dict) -> None:
    with pytest.raises(InvalidOption):
        replace(PLAIN, **nonsense)


@pytest.mark.parametrize(
    "edge", [{"variance": 1.0}, {"rounds": 1}, {"max_modes": 1}, {"min_members": 2}, {"orientation": "upright"}]
)
def test_a_build_at_the_edge_of_what_can_be_is_one(edge: dict) -> None:
    assert replace(PLAIN, **edge)


def test_a_model_of_too_few_or_of_overturned_members_is_refused() -> None:
    members, _ = _mug_members(2)
    with pytest.raises(InvalidMesh, match="at least two"):
        shape_model(members[:1], np.ones(members.shape[1]))
    with pytest.raises(InvalidMesh, match="turned over"):
        shape_model(np.stack([*members, members[0] * [-0.9, 1, 1]]), np.ones(members.shape[1]))
