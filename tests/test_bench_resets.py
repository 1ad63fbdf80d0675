"""Memory of the environment over many resets."""

from pathlib import Path

import pytest
import trimesh

from gfp_grasp.bench import bench_resets
from gfp_grasp.errors import InvalidOption

# What a heap in pieces may add over 270 resets; episodes that stay a while add more than twice this.
FLAT_MB = 30.0


@pytest.fixture
def folder(tmp_path):
    """More objects than the environment keeps compiled."""
    for number in range(18):
        mesh = trimesh.creation.cylinder(0.02 + 0.001 * number, 0.14, sections=64)
        mesh.apply_translation((0, 0, 0.07))
        mesh.export(tmp_path / f"bottle__{number}.ply")
    return str(tmp_path)


@pytest.mark.slow
def test_memory_stays_flat_over_hundreds_of_resets(folder):
    report = bench_resets(folder, resets=300)
    resident = report["rss_mb"]
    assert len(resident) == 10
    assert resident[-1] - resident[0] < FLAT_MB
    assert report["resets_per_s"] > 0
    assert report["settings"] == {
        **{
            "objects": Path(folder).name,
            "completer": "mirror",
            "limit": 20,
            "num_objects": 18,
            "resets": 300,
            "seed": 0,
        },
        **{"image_width": 120, "image_height": 90, "num_points": 256},
    }


def test_too_few_resets_to_measure_ten_times_are_refused():
    with pytest.raises(InvalidOption, match="resets is 9; at least 10"):
        bench_resets("bottle", resets=9)
