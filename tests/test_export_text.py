"""Every word of the files that are written of a known body."""

from dataclasses import replace
from inspect import signature
from pathlib import Path

import numpy as np
import pytest
import trimesh
from bodies import box_part

from gfp_grasp.errors import InvalidOption
from gfp_grasp.export import SUFFIXES, Body, MassProperties, export_completion, mass_properties
from gfp_grasp.export.formats import replacing, to_text, write_meshes, write_mjcf, write_urdf

WEDGE = trimesh.Trimesh(
    [[0, 0, 0], [0.6, 0, 0], [0, 0.4, 0], [0, 0, 0.3]], [[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]], process=False
)
LOWER = trimesh.Trimesh(WEDGE.vertices - [0, 0, 0.1], WEDGE.faces, process=False)
INERTIA = np.array([[0.11, 0.12, 0.13], [0.12, 0.22, 0.23], [0.13, 0.23, 0.33]])
WEIGHT = MassProperties(1.5, np.array([0.1, 0.2, 0.3]), INERTIA)
# Its x lies along y, its y along z, its z along x.
PLACE = np.array([[0.0, 0, 1, 1], [1, 0, 0, 2], [0, 1, 0, 3], [0, 0, 0, 1]])
BODY = Body("jug", WEDGE, (LOWER, WEDGE), WEIGHT, PLACE)
UP = np.array([0.6, 0.0, 0.8])

MJCF = """<?xml version='1.0' encoding='utf-8'?>
<mujoco model="jug">
  <option gravity="-5.886 -0 -7.848" />
  <asset>
    <mesh name="jug_visual" {visual} inertia="shell" />
    <mesh name="jug_hull_000" {first} />
    <mesh name="jug_hull_001" {second} />
  </asset>
  <worldbody>
    <light pos="3.5 2.3 6.4" dir="-0.6 -0 -0.8" type="directional" />
    <geom name="floor" type="plane" size="0 0 0.05" pos="{floor}" zaxis="0.6 0 0.8" rgba="0.8 0.8 0.82 1" />
    <body name="jug" pos="1 2 3" quat="0.5 0.5 0.5 0.5">
      <freejoint name="jug_free" />
      <inertial pos="0.1 0.2 0.3" mass="1.5" fullinertia="0.11 0.22 0.33 0.12 0.13 0.23" />
      <geom name="jug_visual" type="mesh" mesh="jug_visual" mass="0" contype="0" conaffinity="0" group="2" \
rgba="0.55 0.65 0.8 1" />
      <geom name="jug_hull_000" type="mesh" mesh="jug_hull_000" group="3" mass="0"{contact} />
      <geom name="jug_hull_001" type="mesh" mesh="jug_hull_001" group="3" mass="0"{contact} />
    </body>
  </worldbody>
</mujoco>"""
FACES = 'face="0 2 1 0 1 3 0 3 2 1 2 3"'
SOLID = f'vertex="0 0 0 0.6 0 0 0 0.4 0 0 0 0.3" {FACES}'
SUNK = f'vertex="0 0 -0.1 0.6 0 -0.1 0 0.4 -0.1 0 0 0.2" {FACES}'

URDF = """<?xml version='1.0' encoding='utf-8'?>
<robot name="jug">
  <mujoco>
    <compiler strippath="false" discardvisual="false" />
  </mujoco>
  <link name="jug">
    <inertial>
      <origin xyz="0.1 0.2 0.3" rpy="0 0 0" />
      <mass value="1.5" />
      <inertia ixx="0.11" ixy="0.12" ixz="0.13" iyy="0.22" iyz="0.23" izz="0.33" />
    </inertial>
    <visual name="visual">
      <origin xyz="0 0 0" rpy="0 0 0" />
      <geometry>
        <mesh filename="jug_meshes/visual.obj" />
      </geometry>
    </visual>
    <collision name="hull_000">
      <origin xyz="0 0 0" rpy="0 0 0" />
      <geometry>
        <mesh filename="jug_meshes/hull_000.obj" />
      </geometry>
    </collision>
    <collision name="hull_001">
      <origin xyz="0 0 0" rpy="0 0 0" />
      <geometry>
        <mesh filename="jug_meshes/hull_001.obj" />
      </geometry>
    </collision>
  </link>
</robot>"""


@pytest.mark.parametrize("contact", [False, True])
@pytest.mark.parametrize("in_files", [False, True])
@pytest.mark.parametrize(("floor_m", "floor"), [(None, "1.764 0 2.352"), (-0.5, "-0.3 -0 -0.4")])
def test_mjcf_of_a_leaning_floor_word_by_word(
    tmp_path: Path, in_files: bool, contact: bool, floor_m: float | None, floor: str
) -> None:
    path = tmp_path / "jug.xml"
    write_mjcf([BODY], path, up=UP, in_files=in_files, contact=contact, floor_m=floor_m)
    sources = {"visual": SOLID, "first": SUNK, "second": SOLID}
    if in_files:
        names = {"visual": "visual", "first": "hull_000", "second": "hull_001"}
        sources = {key: f'file="jug_meshes/{name}.obj"' for key, name in names.items()}
    sources["contact"] = ' solref="0.004 1" priority="1"' if contact else ""
    assert path.read_text(encoding="utf-8") == MJCF.format(**sources, floor=floor)
    assert (tmp_path / "jug_meshes").is_dir() == in_files


def test_urdf_word_by_word(tmp_path: Path) -> None:
    write_urdf([BODY], tmp_path / "jug.urdf")
    assert (tmp_path / "jug.urdf").read_text(encoding="utf-8") == URDF
    lines = (tmp_path / "jug_meshes" / "hull_000.obj").read_text().split("\n")
    assert [line for line in lines if line] == [
        *(f"v {x:.8f} {y:.8f} {z:.8f}" for x, y, z in LOWER.vertices),
        *("f 1 3 2", "f 1 2 4", "f 1 4 3", "f 2 3 4"),
    ]


def test_parts_of_an_earlier_export_go_and_what_was_not_exported_stays(tmp_path: Path) -> None:
    folder = tmp_path / "jug_meshes"
    folder.mkdir()
    gone = ("hull_001.obj", "hull_017.obj", "hull_1234.obj")
    kept = ("hull_17.obj", "hull_abc.obj", "hull_007.obj.bak", "other.obj")
    for name in (*gone, *kept):
        (folder / name).write_text("old")
    one = Body("jug", WEDGE, (LOWER,), WEIGHT)
    assert write_meshes([one], tmp_path / "jug.urdf") == [["jug_meshes/visual.obj", "jug_meshes/hull_000.obj"]]
    assert sorted(path.name for path in folder.iterdir()) == sorted([*kept, "visual.obj", "hull_000.obj"])
    two = write_meshes([one, replace(BODY, name="cup.2")], tmp_path / "jug.urdf")
    stems = [["jug_visual", "jug_hull_000"], ["cup.2_visual", "cup.2_hull_000", "cup.2_hull_001"]]
    assert two == [[f"jug_meshes/{stem}.obj" for stem in own] for own in stems]
    assert sorted(path.name for path in folder.iterdir()) == sorted(
        [*kept, *(f"{s}.obj" for own in stems for s in own)]
    )
    write_meshes([one], tmp_path / "jug.urdf")
    assert sorted(path.name for path in folder.iterdir()) == sorted([*kept, "visual.obj", "hull_000.obj"])


def test_a_file_that_could_not_be_written_leaves_the_old_one_and_nothing_else(tmp_path: Path) -> None:
    path = tmp_path / "a.xml"
    path.write_text("old")

    def write(text: str, *, fails: bool) -> None:
        with replacing(path) as new:
            assert new.parent == tmp_path
            assert new.name.startswith(".a.xml.")
            new.write_text(text)
            if fails:
                raise RuntimeError

    with pytest.raises(RuntimeError):
        write("half", fails=True)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.xml", "old")]
    write("whole", fails=False)
    assert [(file.name, file.read_text()) for file in tmp_path.iterdir()] == [("a.xml", "whole")]


def test_numbers_have_nine_digits() -> None:
    assert to_text([[1 / 3, 0.1], [2e-7, 12]]) == "0.333333333 0.1 2e-07 12"


def test_without_a_density_bodies_are_as_heavy_as_water() -> None:
    box = box_part([0, 0, 0], [0.1, 0.2, 0.05]).to_trimesh()
    found = mass_properties(box)
    assert found.mass_kg == pytest.approx(1.0)
    np.testing.assert_allclose(found.centre, [0.05, 0.1, 0.025])
    assert mass_properties(box, shell_thickness_m=0.001).mass_kg == pytest.approx(box.area)
    defaults = {p.name: p.default for p in signature(export_completion).parameters.values() if p.kind == p.KEYWORD_ONLY}
    assert defaults == {
        "name": "object",
        "density": 1000.0,
        "shell_thickness_m": None,
        "colors": None,
        "up": (0.0, 0.0, 1.0),
        "assets": "embedded",
        "contact": True,
    }


def test_an_export_hands_every_option_on(tmp_path: Path) -> None:
    box = box_part([0, 0, 0], [0.1, 0.2, 0.05])
    path = export_completion(box.to_trimesh(), [box], tmp_path / "a.xml")
    text = path.read_text()
    assert 'model="object"' in text
    assert 'gravity="-0 -0 -9.81"' in text
    assert 'mass="1"' in text
    path = export_completion(
        box.to_trimesh(), [box], tmp_path / "b.XML", name="b", density=500.0, up=(0, 3, 0), assets="files"
    )
    text = path.read_text()
    assert 'model="b"' in text
    assert 'gravity="-0 -9.81 -0"' in text
    assert 'mass="0.5"' in text
    assert 'file="b_meshes/hull_000.obj"' in text
    path = export_completion(box.to_trimesh(), [box], tmp_path / "c.URDF", shell_thickness_m=0.001, density=2000.0)
    assert f'<mass value="{2 * box.to_trimesh().area:.9g}" />' in path.read_text()
    assert SUFFIXES == (".obj", ".ply", ".stl", ".glb", ".xml", ".urdf")
    with pytest.raises(InvalidOption, match="'embedded' or 'files'"):
        export_completion(box.to_trimesh(), [box], tmp_path / "d.xml", assets="both")  # type: ignore[arg-type]
