"""What the outside relies on: public names, quick start, pages that stay true."""

import importlib
import re
import subprocess
import sys
from pathlib import Path

import pytest

import pivometer

ROOT = Path(__file__).resolve().parents[2]


def test_public_names_all_import():
    assert set(pivometer.__all__) <= set(dir(pivometer))
    for name in pivometer.__all__:
        assert getattr(pivometer, name) is not None


def test_unknown_name_says_so():
    with pytest.raises(AttributeError, match="solv"):
        _ = pivometer.solv


def test_importing_the_package_loads_nothing_heavy():
    heavy = "('numpy', 'cv2', 'cyclopts')"
    code = f"import pivometer, sys; print([m for m in {heavy} if m in sys.modules])"
    shown = subprocess.run(  # noqa: S603
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )
    assert shown.stdout.strip() == "[]"


def equation_rows() -> list[tuple[str, str]]:
    text = (ROOT / "docs" / "conventions.md").read_text(encoding="utf-8")
    table = text[text.index("## The paper, equation by equation") :]
    rows = []
    for line in table.splitlines():
        cells = [cell.strip() for cell in line.split("|")[1:-1]]
        if len(cells) == 3 and re.match(r"\(\d", cells[0]):
            rows += [(cells[0], name) for name in re.findall(r"`([\w.]+)`", cells[2])]
    return rows


@pytest.mark.parametrize(("equation", "name"), equation_rows())
def test_every_function_the_conventions_name_exists_and_cites_its_equation(equation, name):
    parts = name.split(".")
    found = importlib.import_module(".".join(["pivometer", *parts[:2]]))
    for part in parts[2:]:
        found = getattr(found, part)
    assert found.__doc__


def test_every_equation_of_the_paper_has_a_row():
    cited = " ".join(equation for equation, _ in equation_rows())
    numbers = set()
    for first, last in re.findall(r"\((\d+)\)(?:–\((\d+)\))?", cited):
        numbers |= set(range(int(first), int(last or first) + 1))
    assert numbers == set(range(1, 23))


def test_what_was_asked_is_recorded_under_the_names_of_measures_options():
    """`verify` asks `measure` for the same again, name by name."""
    import inspect
    from dataclasses import fields

    from pivometer.measurement import Options
    from pivometer.pipeline import measure

    recorded = {field.name for field in fields(Options)} - {"rig_given"}
    asked = {
        name
        for name, one in inspect.signature(measure).parameters.items()
        if one.kind is inspect.Parameter.KEYWORD_ONLY
    }
    assert recorded <= asked
    assert asked - recorded <= {"rig", "progress", "floor"}  # the floor is in the result itself
