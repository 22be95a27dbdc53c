"""Lines from CSV: ours, other people's, and what is wrong with a file, by line number."""

from pathlib import Path

import numpy as np
import pytest

from pivometer.errors import UsageError
from pivometer.io.lines import read_lines

SIX = "1,2,3,0,0,1\n4,5,6,1,0,0\n7,8,9,0,1,0\n"
HEADINGS = {
    "ours": "pose,point_x_mm,point_y_mm,point_z_mm,direction_x,direction_y,direction_z",
    "short": "name,px,py,pz,dx,dy,dz",
    "plain": "id,X,Y,Z,DX,DY,DZ",
}


def write(tmp_path: Path, text: str) -> Path:
    path = tmp_path / "lines.csv"
    path.write_text(text, encoding="utf-8")
    return path


def test_without_a_heading_lines_are_named_by_their_number(tmp_path: Path) -> None:
    lines = read_lines(write(tmp_path, "# mine\n\n" + SIX))
    assert lines.names == ("3", "4", "5")
    np.testing.assert_array_equal(lines.points_mm, [[1, 2, 3], [4, 5, 6], [7, 8, 9]])
    np.testing.assert_array_equal(lines.directions, [[0, 0, 1], [1, 0, 0], [0, 1, 0]])


@pytest.mark.parametrize("separator", [",", ";", "\t"])
@pytest.mark.parametrize("heading", HEADINGS)
def test_headings_and_separators(heading: str, separator: str, tmp_path: Path) -> None:
    text = HEADINGS[heading] + ",more\n" + "p1,1,2,3,0,0,1,9\np2,4,5,6,1,0,0,\n"
    lines = read_lines(write(tmp_path, "\ufeff" + text.replace(",", separator)))
    assert lines.names == ("p1", "p2")
    np.testing.assert_array_equal(lines.points_mm, [[1, 2, 3], [4, 5, 6]])


def test_columns_may_stand_in_any_order(tmp_path: Path) -> None:
    text = "direction_z,direction_y,direction_x,point_z_mm,point_y_mm,point_x_mm\n6,5,4,3,2,1\n"
    lines = read_lines(write(tmp_path, text))
    np.testing.assert_array_equal(lines.points_mm, [[1, 2, 3]])
    np.testing.assert_array_equal(lines.directions, [[4, 5, 6]])


FAULTS = {
    "": "holds no lines",
    HEADINGS["ours"]: "holds a heading but no lines",
    SIX + "1,2,x,0,0,1\n": "line 4, column 3: 'x' is not a finite number",
    SIX + "\n1,2,nan,0,0,1\n": "line 5, column 3: 'nan' is not a finite number",
    SIX + "1,2,3,0,0\n": "line 4: has 5 cells, but 6 are needed",
    SIX + "1,2,3,0,0,0\n": "line 4: its direction is zero",
    "1,2,3,4,5\n": "line 1: has no heading and 5 columns, not 6",
    "point_x_m,y,z,dx,dy,dz\n1,2,3,4,5,6": "line 1: has no column point_x; its columns are point",
}


@pytest.mark.parametrize("text", FAULTS)
def test_what_is_wrong_is_told_with_its_line(text: str, tmp_path: Path) -> None:
    with pytest.raises(UsageError) as told:
        read_lines(write(tmp_path, text))
    assert told.value.what.startswith(FAULTS[text])
    assert told.value.path is not None


def test_files_that_cannot_be_read(tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="cannot be read"):
        read_lines(tmp_path / "none.csv")
    (tmp_path / "latin.csv").write_bytes(b"1,2\n\xe9\n")
    with pytest.raises(UsageError, match="line 2: is not UTF-8"):
        read_lines(tmp_path / "latin.csv")


def test_lines_in_metres(tmp_path: Path) -> None:
    path = tmp_path / "lines.csv"
    names = "px,py,pz,dx,dy,dz,cov_xx,cov_xy,cov_xz,cov_yy,cov_yz,cov_zz"
    path.write_text(f"{names}\n1,2,3,0,0,1,4,0,0,4,0,4\n", encoding="utf-8")
    lines = read_lines(path, unit_mm=1000)
    np.testing.assert_array_equal(lines.points_mm, [[1000, 2000, 3000]])
    np.testing.assert_array_equal(lines.directions, [[0, 0, 1]])
    assert lines.covariances_mm2 is not None
    np.testing.assert_array_equal(lines.covariances_mm2[0], 4e6 * np.eye(3))
