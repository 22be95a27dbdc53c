import pytest

from pivometer.cli.hints import shaft_hints
from pivometer.errors import UsageError


@pytest.mark.parametrize("text", ["412,300", "left=412", "left=a,b", "left=1,2,0", "left=nan,1"])
def test_a_hint_that_is_none_is_refused(text: str) -> None:
    with pytest.raises(UsageError, match="is not CAMERA=X,Y"):
        shaft_hints([text])


def test_two_hints_for_one_camera_are_refused() -> None:
    with pytest.raises(UsageError, match="twice for left"):
        shaft_hints(["left=1,2", "left=3,4"])


def test_a_hint_without_width_is_enough() -> None:
    assert shaft_hints(["left=1,2", "right=3,4,5"])["left"].width_px is None
