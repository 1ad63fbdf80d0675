"""A folder of bowls, turned, resized and some of them broken, becomes a class by one command."""

import json
import math
import resource
from pathlib import Path

import numpy as np
import pytest
import trimesh
from revolved import bowl, write_bowls

from gfp_grasp.cli import main
from gfp_grasp.errors import InvalidOption
from gfp_grasp.meshes import crossing_faces
from gfp_grasp.primitives import PrimitiveLibrary, fit_full_surface
from gfp_grasp.train import build_from_folder, build_from_shapes

_LIMIT_S = 180.0


def _run(*words: object) -> int:
    with pytest.raises(SystemExit) as stop:
        main([str(word) for word in words])
    return int(stop.value.code or 0)


def _cpu_s() -> float:
    """Processor time of this process and of its children that have ended: other work on the machine does not count."""
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


@pytest.mark.slow
@pytest.mark.timeout(3600)
def test_folder_of_bowls_becomes_a_class_within_three_minutes(tmp_path: Path) -> None:
    (tmp_path / "bowls").mkdir()
    write_bowls(tmp_path / "bowls")
    (tmp_path / "spec.json").write_text(json.dumps({"names": {"modelnet": ["bowl"]}, "alike": ["cup"]}))
    before = _cpu_s()
    command = ("gps", "build", "bowl", "--meshes", tmp_path / "bowls", "--out", tmp_path / "my")
    assert _run(*command, "--spec", tmp_path / "spec.json") == 0
    assert _cpu_s() - before < _LIMIT_S
    library = PrimitiveLibrary.with_shipped(tmp_path / "my")
    primitive = library.primitive("bowl")
    assert library.categories == PrimitiveLibrary.shipped().categories
    assert len(library.members_of("bowl")) == 1
    mesh = trimesh.Trimesh(primitive.vertices, primitive.faces, process=False)
    assert mesh.is_volume
    assert mesh.euler_number == 2
    assert not len(crossing_faces(mesh.vertices, mesh.faces))
    # It stands on its foot about its axis, and opens upward.
    inside = primitive.on_region("inside")
    assert 0.25 < inside.mean() < 0.6
    assert primitive.vertices[inside, 2].max() > 0.9 * mesh.bounds[1, 2]
    assert mesh.bounds[0, 2] == 0.0
    assert np.abs(mesh.bounds[:, :2].sum(axis=0)).max() < 0.001
    assert primitive.symmetry.order == math.inf
    low = mesh.vertices[:, 2] < 0.03 * mesh.bounds[1, 2]
    assert np.linalg.norm(mesh.vertices[low, :2], axis=1).max() < 0.7 * mesh.bounds[1, 0]
    # Its sizes are those of the files, in metres.
    assert 0.1 < mesh.extents[0] < 0.19
    assert 0.045 < mesh.extents[2] < 0.09
    assert primitive.spec.size_range_m[1][0] < 0.23
    assert primitive.spec.hollow
    assert primitive.spec.alike == ("cup",)
    assert primitive.spec.names == {"modelnet": ("bowl",)}
    assert primitive.parts
    assert int(str(primitive.card["members_used"])) >= 17
    assert "1 more unreadable" in str(primitive.card["data"])
    assert float(str(primitive.card["generalization_mm"])) < 1.0
    assert fit_full_surface(primitive, bowl(height=0.055, rim=0.08, base=0.04, fullness=2.0))[1] < 0.001
    assert _run("gps", "show", "bowl", "--gps", tmp_path / "my") == 0


def test_command_refuses_what_is_no_folder_of_primitives_and_no_spec(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "spec.json").write_text("[1, 2]")
    for words, told in (
        (("gps", "show", "bowl", "--gps", tmp_path / "nowhere"), "nowhere is no folder"),
        (("gps", "show", "bowl", "--gps", tmp_path), "holds no primitive"),
        (("gps", "build", "bowl", "--meshes", tmp_path, "--spec", tmp_path / "spec.json"), "holds a list"),
        (("complete", "sample", "-o", tmp_path / "a.glb", "--gps", tmp_path / "nowhere"), "nowhere is no folder"),
    ):
        assert _run(*words) == 2
        assert told in capsys.readouterr().err


def test_spec_of_a_build_is_refused_before_the_work_begins(tmp_path: Path) -> None:
    with pytest.raises(InvalidOption, match="rests of bowl"):
        build_from_folder(tmp_path, "bowl", spec={"rests": {"afloat": 1.0}})
    with pytest.raises(InvalidOption, match="colour"):
        build_from_shapes("cup", spec={"colour": "red"})
    with pytest.raises(InvalidOption, match="category"):
        build_from_folder(tmp_path, "a.b.c")
