"""Template points: what was seen, in the primitive's frame, and its mirror images where nothing was seen."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import KDTree
from toy_bodies import NO_SYMMETRY, ROUND, fit_of, l_body, primitive_of, view_of
from toy_primitive import toy_cup_primitive

from gfp_grasp.deform import patch_unit_m, template_points
from gfp_grasp.types import Symmetry

EYE = (0.6, 0.5, 0.4)  # in the object's frame
ACROSS_Y = Symmetry(np.array([0.0, 0.0, 1.0]), 1, np.array([0.0, 1.0, 0.0]))


def disc(centre, normal, *, radius=0.006, count=60):
    """Points of a flat disc, in a spiral."""
    normal = np.asarray(normal) / np.linalg.norm(normal)
    a = np.cross(normal, [0.3, 0.5, 0.8])
    a /= np.linalg.norm(a)
    turn, reach = np.arange(count) * 2.4, radius * np.sqrt((np.arange(count) + 0.5) / count)
    flat = np.stack([reach * np.cos(turn), reach * np.sin(turn)], axis=1)
    return np.asarray(centre) + flat @ np.stack([a, np.cross(normal, a)])


def on_cup(azimuth_deg, *, away=0.0, height=0.05, radius=0.006):
    """A disc on the toy cup's outside, `away` metres off its surface, and its outward direction."""
    primitive = toy_cup_primitive()
    turn = np.deg2rad(azimuth_deg)
    out = np.array([np.cos(turn), np.sin(turn), 0.0])
    level = primitive.vertices[1 + 32 : 1 + 11 * 32]
    near = level[int(np.abs(level[:, 2] - height).argmin())]
    return disc((np.linalg.norm(near[:2]) + away) * out + [0, 0, height], out, radius=radius)


def as_set(points):
    return np.array(sorted(np.round(points, 9).tolist()))


def test_observed_points_come_back_in_the_primitives_frame_with_normals_that_face_the_viewer():
    body = l_body()
    points = disc((0.03, 0.0, 0.07), (1, 0, 0))
    template = template_points(fit_of(primitive_of(body)), view_of(points, EYE))
    assert as_set(template.points) == pytest.approx(as_set(points))
    assert template.normals == pytest.approx(np.tile([1.0, 0, 0], (len(points), 1)), abs=1e-6)
    assert not template.mirrored.any()


def test_without_a_viewpoint_normals_face_away_from_the_fit():
    body = l_body()
    for centre, normal in (
        ((0.03, 0.0, 0.07), (1, 0, 0)),
        ((0.0, 0.0, 0.07), (-1, 0, 0)),
        ((0.015, -0.02, 0.05), (0, -1, 0)),
        ((0.015, 0.03, 0.05), (0, 1, 0)),
    ):
        template = template_points(fit_of(primitive_of(body)), view_of(disc(centre, normal)))
        assert template.normals == pytest.approx(np.tile(np.array(normal, float), (60, 1)), abs=1e-6)


def test_many_points_are_thinned_to_about_a_thousand():
    points = disc((0.03, 0.0, 0.07), (1, 0, 0), count=6000)
    fit = fit_of(primitive_of(l_body()))
    assert 900 <= len(template_points(fit, view_of(points, EYE)).points) <= 1250


@pytest.mark.parametrize(
    ("symmetry", "signs"),
    [
        (ROUND, [(-1, 1), (1, -1), (-1, -1)]),
        (Symmetry(np.array([0.0, 0.0, 1.0]), 2), [(-1, 1), (1, -1), (-1, -1)]),
        (ACROSS_Y, [(1, -1)]),
        (Symmetry(np.array([0.0, 0.0, 1.0]), 1, np.array([1.0, 0.0, 0.0])), [(-1, 1)]),
        (NO_SYMMETRY, []),
    ],
)
def test_each_symmetry_has_its_own_mirror_images(symmetry, signs):
    points = on_cup(40.0)
    primitive = replace(toy_cup_primitive(), symmetry=symmetry)
    template = template_points(fit_of(primitive), view_of(points, EYE))
    images = [points * (x, y, 1) for x, y in signs]
    found = template.points[template.mirrored]
    assert as_set(found) == pytest.approx(as_set(np.concatenate([np.zeros((0, 3)), *images])))
    seen_normal = np.array([np.cos(np.deg2rad(40)), np.sin(np.deg2rad(40)), 0.0])
    for x, y in signs:
        mine = (np.sign(found[:, 0]) == x) & (np.sign(found[:, 1]) == y)
        assert mine.sum() == len(points)
        normals = template.normals[template.mirrored][mine]
        assert normals == pytest.approx(np.tile(seen_normal * (x, y, 1), (len(points), 1)), abs=1e-6)


def test_symmetry_can_be_left_out():
    template = template_points(fit_of(toy_cup_primitive()), view_of(on_cup(40.0), EYE), symmetry=False)
    assert len(template.points) == 60
    assert not template.mirrored.any()


def with_handle(azimuth_deg=0.0):
    """The toy cup; its wall within 25 degrees of an azimuth counts as a handle."""
    primitive = toy_cup_primitive()
    azimuth = np.arctan2(primitive.vertices[:, 1], primitive.vertices[:, 0]) - np.deg2rad(azimuth_deg)
    on_handle = np.cos(azimuth) > np.cos(np.deg2rad(25))
    return replace(
        primitive,
        regions=np.where(on_handle, 2, primitive.regions).astype(np.uint8),
        region_names=("outside", "inside", "handle"),
        symmetry=NO_SYMMETRY,
    )


def test_a_handle_is_mirrored_in_its_own_plane_only():
    points = on_cup(18.0, radius=0.003)
    template = template_points(fit_of(with_handle()), view_of(points, EYE))
    assert as_set(template.points[template.mirrored]) == pytest.approx(as_set(points * (1, -1, 1)))


def test_a_handle_in_any_direction_is_mirrored_in_its_own_plane_only():
    """Towards 67.5 degrees: what is seen of it at 80 has an image at 55; the body at 10, images at 125, 190 and 305."""
    for seen, wanted in ((80.0, (55.0,)), (10.0, (125.0, 190.0, 305.0))):
        points = on_cup(seen, radius=0.003)
        template = template_points(fit_of(with_handle(67.5)), view_of(points, EYE))
        found = template.points[template.mirrored]
        assert len(found) == len(wanted) * len(points)
        azimuths = np.rad2deg(np.arctan2(found[:, 1], found[:, 0])) % 360
        for image in wanted:
            near = np.abs(azimuths - image) < 12
            assert near.sum() == len(points)
            assert azimuths[near].mean() == pytest.approx(image, abs=1)


def test_a_body_beside_a_handle_is_mirrored_in_every_upright_plane():
    points = on_cup(60.0)
    template = template_points(fit_of(with_handle()), view_of(points, EYE))
    images = np.concatenate([points * signs for signs in ((1, -1, 1), (-1, 1, 1), (-1, -1, 1))])
    assert as_set(template.points[template.mirrored]) == pytest.approx(as_set(images))


def test_no_point_is_mirrored_onto_a_handle():
    """What is seen opposite the handle would land on it; only the image on its own side is kept."""
    points = on_cup(162.0, radius=0.003)
    template = template_points(fit_of(with_handle()), view_of(points, EYE))
    assert as_set(template.points[template.mirrored]) == pytest.approx(as_set(points * (1, -1, 1)))


def test_a_mirrored_point_is_silent_within_a_fifth_of_the_unit_of_one_that_was_seen():
    primitive = replace(toy_cup_primitive(), symmetry=ACROSS_Y)
    unit = patch_unit_m(primitive)
    points = np.concatenate([on_cup(a, radius=0.002) for a in np.arange(-12.0, 36.0, 3.0)])
    template = template_points(fit_of(primitive), view_of(points, EYE))
    images = points * (1, -1, 1)
    spoken = KDTree(points).query(images)[0] > 0.2 * unit
    assert 0 < spoken.sum() < len(points)
    assert as_set(template.points[template.mirrored]) == pytest.approx(as_set(images[spoken]))


@pytest.mark.parametrize(("share", "is_kept"), [(0.9, True), (1.1, False)])
def test_a_mirrored_point_is_dropped_where_the_fit_is_not(share, is_kept):
    """It may be 0.4 units and a spacing of the vertices off the fit."""
    primitive = replace(toy_cup_primitive(), symmetry=ACROSS_Y)
    surface = KDTree(primitive.vertices)
    spacing = np.median(surface.query(primitive.vertices, k=2)[0][:, 1])
    bound = 0.4 * patch_unit_m(primitive) + spacing
    assert spacing > 0.1 * bound  # so that it shows whether it counts
    centre = primitive.vertices[surface.query([0.03, 0.03, 0.05])[1]]
    out = centre * (1, 1, 0) / np.linalg.norm(centre[:2])
    points = disc(centre + share * bound * out, out, radius=1e-4)
    template = template_points(fit_of(primitive), view_of(points, EYE))
    assert template.mirrored.sum() == (len(points) if is_kept else 0)


def test_without_a_viewpoint_normals_of_an_inner_wall_face_the_axis():
    """Points all around the inside of the cup, 0.2 mm off it: away from the points' middle is into the wall."""
    primitive = toy_cup_primitive()
    inner = primitive.vertices[(primitive.regions == 1) & (np.linalg.norm(primitive.vertices[:, :2], axis=1) > 0.02)]
    inward = -inner * (1, 1, 0) / np.linalg.norm(inner[:, :2], axis=1, keepdims=True)
    template = template_points(fit_of(primitive), view_of(inner + 2e-4 * inward), symmetry=False)
    at = KDTree(inner + 2e-4 * inward).query(template.points)[1]
    below_rim = template.points[:, 2] < 0.8 * primitive.vertices[:, 2].max()
    assert (np.einsum("ni,ni->n", template.normals, inward[at])[below_rim] > 0.5).mean() > 0.9
