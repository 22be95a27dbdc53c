"""Whatever lies in a session, the answer is a value of ours or a message of ours."""

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from pivometer.errors import ImageError, SessionError
from pivometer.io.codec import json_text, jsonable
from pivometer.io.images import decode_image
from pivometer.io.settings import read_settings

GREY = cv2.GaussianBlur(
    np.random.default_rng(3).integers(0, 256, (24, 32), dtype=np.uint8), (0, 0), 1.0
)
FILES = {ending: bytes(cv2.imencode(ending, GREY)[1].tobytes()) for ending in (".png", ".jpg")}

VALUES = st.one_of(
    st.sampled_from(['"charuco"', '"checkerboard"', '""', "true", "nan", "-inf", "1e999", "{}"]),
    st.sampled_from(
        ["[]", "[9, 7]", "[9.5, 7]", '["a"]', "[[9], 7]", "1979-05-27", "0", "1" * 400]
    ),
    st.sampled_from(['["a", "b"]', '["..", "/"]', "[9, 7, 5]", '"DICT_4X4_50"', "[true, false]"]),
    st.integers().map(str),
    st.floats(allow_nan=False, allow_infinity=False).map(repr),
)
TABLES = {
    "board": {"kind": '"charuco"', "squares": "[9, 7]", "square_mm": "15.0", "square_u_mm": "0.1"}
    | {"dictionary": '"DICT_4X4_50"', "marker_mm": "11"},
    "shaft": {"diameter_mm": "10"},
    "cameras": {"names": '["a", "b"]', "reference": '"a"'},
    "device": {"serial": "1"},
}


@st.composite
def descriptions(draw: st.DrawFn) -> str:
    """Take a right description and change, drop or add a few lines."""
    lines = []
    for table, keys in TABLES.items():
        lines.append(draw(st.sampled_from([f"[{table}]"] * 12 + ["", "[x]", "[a.b]"])))
        for key, value in {**keys, "x": "1"}.items():
            right = [f"{key} = {value}"] * 12 if key != "x" else [""] * 12
            wrong = [f"{key} = {draw(VALUES)}", "", f"y{key} = 1"]
            lines.append(draw(st.sampled_from(right + wrong)))
    return "\n".join(lines)


@given(descriptions())
@settings(
    max_examples=100, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture]
)
def test_any_description(tmp_path: Path, text: str) -> None:
    (tmp_path / "session.toml").write_text(text, encoding="utf-8")
    try:
        described = read_settings(tmp_path / "session.toml")
    except SessionError:
        return
    assert described.board.corner_count >= 4
    json_text(jsonable(described))


@pytest.mark.parametrize("ending", FILES)
@given(data=st.data())
@settings(max_examples=80, deadline=None)
def test_any_damage_to_an_image(ending: str, data: st.DataObject) -> None:
    content = bytearray(FILES[ending])
    for at in data.draw(st.lists(st.integers(0, len(content) - 1), max_size=3)):
        content[at] = data.draw(st.integers(0, 255))
    end = data.draw(st.integers(0, len(content)))
    try:
        image = decode_image(bytes(content[:end]), f"a{ending}")
    except ImageError:
        return
    assert image.ndim == 2
    assert image.dtype == np.uint8
    if ending == ".png":  # every byte is under a checksum
        np.testing.assert_array_equal(image, GREY)


@given(st.lists(st.floats(allow_nan=False, allow_infinity=False)))
def test_every_number_keeps_every_digit(numbers: list[float]) -> None:
    again = json.loads(json_text(jsonable({"numbers": np.array(numbers)})))["numbers"]
    np.testing.assert_array_equal(np.array(again), np.array(numbers))
