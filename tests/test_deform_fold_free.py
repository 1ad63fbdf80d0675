"""Displacements are spread over the mesh, and damped where the surface would fold."""

import numpy as np
import pytest
from toy_bodies import dense_laplacian, l_body, primitive_of, slab

from gfp_grasp.deform.shape import damp_until_solid, diffuse
from gfp_grasp.meshes import crossing_faces


def test_diffusion_has_the_least_misfit_and_bending():
    """sum c |d - d0|^2 + 0.3 |L d|^2, no confidence below 0.001: its gradient is zero at the answer, on an L."""
    body = primitive_of(l_body(0.02))
    rng = np.random.default_rng(0)
    wished, confidence = rng.normal(0, 0.003, body.vertices.shape), rng.random(len(body.vertices))
    confidence[rng.random(len(confidence)) < 0.3] = 0.0
    found = diffuse(body, wished, confidence)
    L, c = dense_laplacian(body.faces, len(wished)), np.maximum(confidence, 1e-3)[:, None]
    assert c * (found - wished) + 0.3 * L.T @ (L @ found) == pytest.approx(np.zeros_like(found), abs=1e-12)


def test_one_dent_is_damped_and_what_is_far_from_it_is_kept():
    body = l_body(0.01)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    dent = int(np.argmin(np.linalg.norm(vertices - [0.03, 0.005, 0.07], axis=1)))
    wished = np.tile([0.0, 0.001, 0.0005], (len(vertices), 1))
    wished[dent] = (-0.05, 0.0, 0.0)  # through the other side, 30 mm behind
    moved, kept = damp_until_solid(vertices, faces, wished)
    share = np.linalg.norm(moved - vertices, axis=1) / np.linalg.norm(wished, axis=1)
    far = np.linalg.norm(vertices - vertices[dent], axis=1) > 0.05
    near = np.linalg.norm(vertices - vertices[dent], axis=1)
    assert kept == pytest.approx(0.5) == share.min()
    assert share[near < 0.012] == pytest.approx(np.full((near < 0.012).sum(), 0.5))
    ring = (near > 0.012) & (near < 0.018)
    assert ((share[ring] > 0.7) & (share[ring] < 0.95)).all()  # softly, not as a step
    assert share[far] == pytest.approx(np.ones(far.sum()), abs=0.002)
    assert moved - vertices == pytest.approx(share[:, None] * wished, abs=1e-9)


def test_a_face_that_turns_over_is_damped_although_nothing_crosses():
    """A corner of a flat plate's upper face slides across the opposite edge, in the plane."""
    plate = slab((0.12, 0.08, 0.03), edge_m=0.02)
    vertices, faces = np.asarray(plate.vertices), np.asarray(plate.faces)
    middle = int(np.argmin(np.linalg.norm(vertices - [0, 0, 0.015], axis=1)))
    wished = np.zeros_like(vertices)
    wished[middle] = (0.03, 0.004, 0.0)
    moved, kept = damp_until_solid(vertices, faces, wished)

    def normals(at):
        corners = at[faces]
        return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])

    assert (np.einsum("fi,fi->f", normals(vertices), normals(vertices + wished)) < 0).any()
    assert (np.einsum("fi,fi->f", normals(vertices), normals(moved)) > 0).all()
    assert 0.1 < kept < 1


def test_what_nothing_helps_against_stays_where_it_was():
    """A mesh that crosses itself from the start has no displacement that is a solid."""
    body = l_body(0.02)
    vertices, faces = np.array(body.vertices), np.asarray(body.faces)
    vertices[int(np.argmax(vertices[:, 2]))] -= (0, 0, 0.3)
    assert len(crossing_faces(vertices, faces)) > 0
    moved, kept = damp_until_solid(vertices, faces, np.full_like(vertices, 0.001))
    assert kept == 0.0
    np.testing.assert_array_equal(moved, vertices)


def test_a_wish_that_is_wild_everywhere_is_halved_everywhere_and_says_by_how_much():
    body = l_body(0.01)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    wild = np.random.default_rng(0).normal(0, 0.02, vertices.shape)
    moved, kept = damp_until_solid(vertices, faces, wild)
    assert len(crossing_faces(moved, faces)) == 0
    share = np.linalg.norm(moved - vertices, axis=1) / np.linalg.norm(wild, axis=1)
    assert kept == pytest.approx(share.min())
    assert 0 < kept < 0.5


@pytest.mark.parametrize(("spread_m", "factor"), [(0.05, 0.5), (0.1, 0.25), (0.2, 0.1), (0.4, 0.0)])
def test_where_five_halvings_do_not_help_all_of_it_is_damped_together(spread_m, factor):
    body = l_body(0.012)
    vertices, faces = np.asarray(body.vertices), np.asarray(body.faces)
    wild = np.random.default_rng(0).normal(0, spread_m, vertices.shape)
    moved, kept = damp_until_solid(vertices, faces, wild)
    assert len(crossing_faces(moved, faces)) == 0
    share = np.linalg.norm(moved - vertices, axis=1) / np.linalg.norm(wild, axis=1)
    assert kept == pytest.approx(factor * 0.5**5)
    assert share.min() == pytest.approx(kept, abs=1e-12)
