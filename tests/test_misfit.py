"""What speaks against a completed surface: points off it, free space within it, reach beyond what was seen."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from toy_wedge import camera_at, corner_silhouette, toy_evidence

from gfp_grasp.misfit import Misfit, misfit_of
from gfp_grasp.types import LevelView

BOX = trimesh.creation.box((0.2, 0.1, 0.05))  # its longest side is along x


def on_top(height_m: float = 0.025, **more: object) -> LevelView:
    """Points of the upper face of the box, or above it."""
    grid = np.stack(np.meshgrid(np.linspace(-0.1, 0.1, 21), np.linspace(-0.05, 0.05, 11)), axis=-1).reshape(-1, 2)
    return toy_evidence(np.column_stack([grid, np.full(len(grid), height_m)]), sigma_m=0.001, **more)  # type: ignore[arg-type]


def test_points_on_the_surface_speak_for_it() -> None:
    found = misfit_of(BOX, on_top())
    assert found.off_points == pytest.approx(0.0, abs=1e-9)
    assert (found.in_free_space, found.faults()) == (0.0, [])
    assert found.beyond == pytest.approx(0.05 / 0.2)  # the box goes on below the points


def test_points_off_the_surface_are_counted_beyond_their_noise_in_lengths_of_the_object() -> None:
    found = misfit_of(BOX, on_top(0.055))
    assert found.off_points == pytest.approx(np.sqrt(0.03**2 - 0.002**2) / 0.2, rel=0.02)
    assert misfit_of(BOX, on_top(0.0269)).off_points == 0.0  # within two sigma


def test_a_few_points_that_fly_off_do_not_count() -> None:
    points = np.array(on_top().points)
    points[:6, 2] = 0.5  # of 231
    assert misfit_of(BOX, toy_evidence(points, sigma_m=0.001)).off_points < 0.01
    points[:12, 2] = 0.5
    found = misfit_of(BOX, toy_evidence(points, sigma_m=0.001))
    assert found.off_points > 0.5
    assert found.away == pytest.approx(12 / 231)


def test_points_beside_an_open_end_of_the_surface_are_away_from_it() -> None:
    short = trimesh.creation.box(
        (0.1, 0.1, 0.05)
    )  # of the length of 0.2 m that was seen, a quarter at either end lacks
    found = misfit_of(short, on_top())
    assert found.away == pytest.approx(6 / 21, abs=0.01)  # three columns of points at either end are 2 cm off or more
    assert found.faults() == ["29% of what was seen of the object is far from its surface"]


def test_a_surface_that_reaches_far_beyond_the_points_is_told_by_how_far() -> None:
    long = BOX.copy()
    long.apply_translation((0.0, 0.36, 0.0))
    assert misfit_of(long, on_top()).beyond == pytest.approx(0.36 / 0.2)
    assert misfit_of(long, on_top()).faults()[-1] == "it reaches 1.8 lengths beyond what was seen"


def test_surface_where_nothing_was_seen_to_be_is_counted_by_its_area() -> None:
    eye = np.array([0.0, 0.0, 1.0])
    # The object's pixels end at the column of x = 0: what of the box lies beyond stands in free space.
    K = np.array([[400.0, 0, 80.0], [0, 400.0, 60.0], [0, 0, 1]])
    T = camera_at(eye, np.zeros(3), roll_rad=0.0)
    pixels = K @ (T[:3, :3].T @ (np.array([0.0, 0.0, 0.025]) - eye))
    column = int(pixels[0] / pixels[2])
    silhouette = corner_silhouette(T, corner=(10**6, column), K=K)
    found = misfit_of(BOX, on_top(silhouette=silhouette)).in_free_space
    strip_m2 = 2 * (0.05 * 0.2) * 0.11  # a twentieth of the length beside the edge does not count
    assert found == pytest.approx(0.5 - strip_m2 / BOX.area, abs=0.03)
    assert misfit_of(BOX, on_top()).in_free_space == 0.0
    guessed = replace(silhouette, certain=False)  # nobody has seen that there is nothing
    assert misfit_of(BOX, on_top(silhouette=guessed)).in_free_space == 0.0


@pytest.mark.parametrize(
    ("misfit", "told"),
    [
        (Misfit(0.399, 0.199, 0.199, 1.59), []),
        (Misfit(0.41, 0.0, 0.0, 0.0), ["its surface is 41% of the object's length away from what was seen of it"]),
        (Misfit(0.0, 0.21, 0.0, 0.0), ["21% of what was seen of the object is far from its surface"]),
        (Misfit(0.0, 0.0, 0.21, 0.0), ["21% of it lies where nothing was seen to be"]),
        (Misfit(0.0, 0.0, 0.0, 1.7), ["it reaches 1.7 lengths beyond what was seen"]),
    ],
)
def test_what_cannot_be_is_told(misfit: Misfit, told: list[str]) -> None:
    assert misfit.faults() == told


def test_the_surface_of_what_is_as_likely_of_no_class_has_to_be_nearer_to_what_was_seen() -> None:
    off = Misfit(0.0, 0.11, 0.0, 0.0)
    assert off.faults(unknown=0.5) == ["11% of what was seen of the object is far from its surface"]
    assert off.faults(unknown=0.49) == []
    assert Misfit(0.399, 0.099, 0.199, 1.59).faults(unknown=0.99) == []
    assert off.faults(unknown=0.99, of_traffic=True) == []


def test_a_lorry_that_is_seen_from_an_end_may_reach_far_beyond_it() -> None:
    long = Misfit(off_points=0.0, away=0.0, in_free_space=0.0, beyond=4.0)
    assert long.faults() == ["it reaches 4.0 lengths beyond what was seen"]
    assert long.faults(of_traffic=True) == []
    assert len(replace(long, off_points=0.5).faults(of_traffic=True)) == 1
