"""Scans of very many faces: far fewer for the same surface, within a bound, and within a time."""

import time

import numpy as np
import pytest
import trimesh
from bodies import TILTED, l_shape, together

from gfp_grasp.errors import DecompositionFailed
from gfp_grasp.meshes import make_solid, repair_mesh
from gfp_grasp.meshes.simplify import MOST_FACES, MOST_MOVED


@pytest.fixture(scope="module")
def scan() -> tuple[trimesh.Trimesh, trimesh.Trimesh]:
    """An L and a scan of it, with noise of a seventh of its edges: like a mug of 1.9 million faces with 0.02 mm."""
    body = l_shape().apply_transform(TILTED)
    fine = body.subdivide_to_size(float(np.sqrt(2.0 * body.area / (1.3 * MOST_FACES))) * 1.4)
    while len(fine.faces) < 1.1 * MOST_FACES:
        fine = fine.subdivide()
    noise = np.random.default_rng(0).normal(scale=fine.edges_unique_length.mean() / 7, size=fine.vertices.shape)
    return body, trimesh.Trimesh(fine.vertices + noise, fine.faces, process=False)


@pytest.mark.parametrize("opened", [False, True])
def test_a_noisy_scan_becomes_a_solid_of_few_faces_within_the_bound(scan, opened: bool) -> None:
    body, noisy = scan
    given = noisy
    if opened:  # a hole of 1 % of the surface
        distance = np.linalg.norm(noisy.triangles_center - noisy.triangles_center[0], axis=1)
        given = trimesh.Trimesh(noisy.vertices, noisy.faces[distance > np.quantile(distance, 0.01)], process=False)
    started = time.monotonic()
    repair = repair_mesh(given)
    assert time.monotonic() - started < 15
    assert repair.solid.is_volume
    assert len(repair.solid.faces) < MOST_FACES / 4
    assert repair.how != "remeshed"
    assert 0 < repair.error_m < MOST_MOVED * np.linalg.norm(noisy.extents)
    assert repair.solid.volume == pytest.approx(body.volume, rel=0.02)
    np.testing.assert_allclose(repair.solid.center_mass, body.center_mass, atol=0.001)


def test_a_good_mesh_of_few_faces_is_not_simplified() -> None:
    fine = l_shape().subdivide().subdivide().subdivide()
    assert len(make_solid(fine)[0].faces) == len(fine.faces)


def test_a_repair_that_is_out_of_time_goes_on_to_its_last_step(monkeypatch) -> None:
    bars = [trimesh.creation.box(bounds=[[0, 0, 0], [0.1, 0.02, 0.02]])]
    bars.append(trimesh.creation.box(bounds=[[0.003, -0.01, 0.004], [0.018, 0.06, 0.015]]))
    both = together(*bars)
    assert repair_mesh(both).how == "united"
    assert repair_mesh(both, time_limit_s=100.0).how == "united"
    assert repair_mesh(both, time_limit_s=-1.0).how == "remeshed"


def test_the_limit_of_a_decomposition_holds_for_its_repair_and_the_advice_counts_what_came(monkeypatch) -> None:
    from gfp_grasp import decompose
    from gfp_grasp.collision import DecomposeConfig

    limits = []

    def slow(mesh: trimesh.Trimesh, *, time_limit_s: float) -> tuple[trimesh.Trimesh, float]:
        limits.append(time_limit_s)
        time.sleep(0.6)
        return trimesh.creation.box((0.1, 0.1, 0.1)), 0.0

    monkeypatch.setattr("gfp_grasp.collision.decomposition.make_solid", slow)
    with pytest.raises(DecompositionFailed, match=r"no time for one.*24 faces came, the solid made of them has 12"):
        decompose(l_shape(), config=DecomposeConfig(time_limit_s=0.5, cache=False))
    assert limits == [0.25]
