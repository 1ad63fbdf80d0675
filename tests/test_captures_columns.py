"""Text clouds: coordinates are found by the names of their columns, and what names none of them is said."""

from pathlib import Path

import numpy as np
import pytest

from gfp_grasp.captures import read_capture
from gfp_grasp.errors import UnreadableFile

POINTS = np.array([[0.1, -0.25, 0.5], [0.125, 0.75, -0.0625], [1.5, 0.0, 0.25]])


def points_of(folder: Path, text: str, name: str = "a.csv") -> np.ndarray:
    (folder / name).write_text(text, encoding="utf-8")
    points = read_capture(folder / name).points
    assert points is not None
    return points


@pytest.mark.parametrize(
    ("heading", "row"),
    [
        ("r,g,b,x,y,z", "250,10,3,{0},{1},{2}"),
        ("%time,field.header.seq,field.header.frame_id,field.x,field.y,field.z", "1.6e18,4,camera,{0},{1},{2}"),
        ("Z,Y,X", "{2},{1},{0}"),
        ("//X Y Z R G B", "{0} {1} {2} 255 0 7"),
        ("# nx ny nz x y z", "0 0 1 {0} {1} {2}"),
        ('"Points:0","Points:1","Points:2","scalar"', "{0},{1},{2},9"),
        ("normal_x,normal_y,normal_z,pos_x,pos_y,pos_z", "0,0,1,{0},{1},{2}"),
        ("id;x [m];y [m];z [m]", "7;{0};{1};{2}"),
        ("t\tpose.position.x\tpose.position.y\tpose.position.z", "7\t{0}\t{1}\t{2}"),
    ],
)
def test_columns_are_found_by_their_names(tmp_path: Path, heading: str, row: str) -> None:
    text = "\n".join([heading, *(row.format(*point) for point in POINTS)])
    np.testing.assert_allclose(points_of(tmp_path, text), POINTS, atol=1e-12)


def test_the_unit_of_a_column_is_heeded(tmp_path: Path) -> None:
    rows = "\n".join(",".join(f"{1000 * value}" for value in point) for point in POINTS)
    np.testing.assert_allclose(points_of(tmp_path, f"x_mm,y_mm,z_mm\n{rows}"), POINTS, atol=1e-12)
    np.testing.assert_allclose(points_of(tmp_path, f"x (cm),y (cm),z (cm)\n{rows}"), 10 * POINTS, atol=1e-12)
    with pytest.raises(UnreadableFile, match="different units"):
        points_of(tmp_path, f"x_mm,y_m,z_mm\n{rows}")


def test_a_count_of_points_before_them_is_stepped_over(tmp_path: Path) -> None:
    rows = "\n".join(" ".join(map(str, point)) + " -1200 9 8 7" for point in POINTS)
    np.testing.assert_array_equal(points_of(tmp_path, f"3\n{rows}\n", "a.pts"), POINTS)
    np.testing.assert_array_equal(points_of(tmp_path, f"3\nx y z i r g b\n{rows}\n", "a.pts"), POINTS)


def test_decimals_may_have_commas_where_semicolons_part_the_columns(tmp_path: Path) -> None:
    rows = "\n".join(";".join(map(str, point)).replace(".", ",") for point in POINTS)
    np.testing.assert_array_equal(points_of(tmp_path, f"x;y;z\n{rows}"), POINTS)
    np.testing.assert_array_equal(points_of(tmp_path, rows.replace(";", "\t")), POINTS)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("r,g,b,depth\n1,2,3,0.5\n", "4 columns are named r, g, b, depth; x, y and z are expected"),
        ("time,field.data0,field.data1\n1,2,3\n", "named time, field.data0, field.data1"),
        ("nx,ny,nz\n0,0,1\n", "named nx, ny, nz"),
        ("250 10 3 0.1 0.2 0.3\n7 8 9 0.1 0.5 0.3\n", "first three of its 6 columns hold whole numbers from 0 to 255"),
        ("1 2\n3 4\n", "hold 2 numbers"),
        ("<html><body>not found</body></html>\n", "begins with '<html>"),
    ],
)
def test_what_names_no_coordinates_is_said_with_the_columns_that_there_are(
    tmp_path: Path, text: str, words: str
) -> None:
    with pytest.raises(UnreadableFile, match=r"a\.csv.*" + words):
        points_of(tmp_path, text)
