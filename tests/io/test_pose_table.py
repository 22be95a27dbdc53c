"""``poses.csv``: what it may say, and what is said of mistakes in it."""

import hashlib

import pytest

from pivometer.errors import SessionError, UsageError
from pivometer.io.joints import read_pose_table

POSES = ("000", "001", "002")


def read(tmp_path, text, poses=POSES):
    path = tmp_path / "poses.csv"
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return read_pose_table(path, poses)


def test_everything_it_may_say(tmp_path):
    heading = "pose;q1_deg;time_s;approach;d3_mm\n# a note\n"
    text = heading + "002;3;30;+;7\n0;1;10;-;5\n\n001.png;2;20;+;6\n"
    table = read(tmp_path, text)
    assert table.poses == ("002", "000", "001")
    rows = table.rows_of(["000", "001"])
    assert rows.times_s.tolist() == [10, 20]
    assert rows.approach == ("-", "+")
    assert {name: column.tolist() for name, column in rows.joints.items()} == {
        "q1_deg": [1, 2],
        "d3_mm": [5, 6],
    }
    assert table.sha256 == hashlib.sha256(text.encode()).hexdigest()


def test_rows_without_pictures_are_passed_over(tmp_path):
    table = read(tmp_path, "pose,q_deg\n000,1\nnone,7\n001,2\n002,3\n")
    assert (table.poses, table.joints["q_deg"].tolist()) == (POSES, [1, 2, 3])


def test_joints_alone_are_enough(tmp_path):
    table = read(tmp_path, "pose,yaw_rad\n000,0.1\n001,0.2\n002,0.3\n")
    assert (table.times_s, table.approach) == (None, ())


@pytest.mark.parametrize(
    ("text", "what"),
    [
        ("", "is empty"),
        ("q1_deg\n1\n", "line 1: the heading has no column pose: q1_deg"),
        ("pose,q1\n000,1\n", "line 1: column 'q1' does not end in a unit: _deg, _rad, _mm"),
        ("pose,q_deg,q_deg\n000,1,1\n", "line 1: two columns are called 'q_deg'"),
        ("pose,q_deg\n000,1\n001\n", "line 3: has 1 cells, but the heading has 2"),
        ("pose,q_deg\n000,1,2\n", "line 2: has 3 cells, but the heading has 2"),
        ("pose,q_deg\n000,\n", "line 2: q_deg is empty"),
        ("pose,q_deg\n000,nan\n", "line 2: q_deg is 'nan', not a finite number"),
        ("pose,q_deg\n000,inf\n", "line 2: q_deg is 'inf', not a finite number"),
        ("pose,time_s\n000,noon\n", "line 2: time_s is 'noon', not a finite number"),
        ("pose,approach,q_deg\n000,,1\n", "line 2: approach is empty"),
        ("pose,q_deg\n000,1\n000,1\n", "line 3: pose '000' has a row already, in line 2"),
        ("pose,q_deg\n00,1\n0,1\n", "line 3: pose '000' has a row already, in line 2"),
        ("pose,q_deg\n000,1\n0O1,1\n002,1\n", "has no row for pose 001; its row '0O1' names"),
        ("pose,q_deg\n000,1\n", "has no row for pose 001, 002"),
    ],
)
def test_mistakes_are_named(tmp_path, text, what):
    lines = text.splitlines()
    if what.startswith("line") and lines:  # the other poses, so that only one thing is wrong
        text = "\n".join(lines + [f"{p}{',1' * lines[0].count(',')}" for p in ("001", "002")])
    with pytest.raises(SessionError) as error:
        read(tmp_path, text)
    assert error.value.what.startswith(what)
    assert error.value.path.name == "poses.csv"


def test_a_file_that_is_no_text_is_named(tmp_path):
    with pytest.raises(UsageError, match="UTF-8"):
        read(tmp_path, b"pose,q_deg\n000,\xff\n")
