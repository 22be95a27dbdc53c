"""Every section and every table of the report has its explanation."""

import ast
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
REPORT = ROOT / "src" / "pivometer" / "report"
PAGE = " ".join((ROOT / "docs" / "explanation" / "report.md").read_text(encoding="utf-8").split())
OTHER_PAGES = {"comparison.py", "history.py"}


def sections() -> list[str]:
    template = (REPORT / "templates" / "report.html.j2").read_text(encoding="utf-8")
    return re.findall(r"<h2[^>]*>(.*?)</h2>", template)


def opening(node: ast.expr) -> str:
    """Return how a caption begins: up to its first number or name, or up to its unit."""
    while isinstance(node, ast.BinOp):
        node = node.left
    first = node.values[0] if isinstance(node, ast.JoinedStr) else node
    return str(first.value).removesuffix(", mm").strip(" “”") if hasattr(first, "value") else ""


def captions() -> set[str]:
    found = set()
    for path in REPORT.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            made = isinstance(node, ast.Call) and ast.unparse(node.func) == "Table"
            if made and path.name not in OTHER_PAGES:
                found.add(opening(node.args[0]))
    return found - {""}


@pytest.mark.parametrize("title", sections())
def test_every_section_has_its_heading(title):
    assert f"## {title} " in PAGE


@pytest.mark.parametrize("caption", sorted(captions()))
def test_every_table_is_named(caption):
    assert caption in PAGE


def test_sections_and_tables_are_found():
    assert len(sections()) > 10
    assert {"RCM error at both points", "Edges of pose", "What the misses follow"} <= captions()


def test_pictures_are_small():
    pictures = list((ROOT / "docs" / "images").iterdir())
    assert pictures
    assert max(picture.stat().st_size for picture in pictures) < 150_000
