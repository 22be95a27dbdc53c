"""The test command checks the import layers; here is that the check fails when it should."""

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]


def lint(folder: Path) -> subprocess.CompletedProcess[str]:
    code = "import sys; sys.path.insert(0, 'src'); from importlinter.cli import lint_imports; "
    return subprocess.run(  # noqa: S603
        [sys.executable, "-c", code + "sys.exit(lint_imports(no_cache=True))"],
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    shutil.copytree(ROOT / "src", tmp_path / "src", ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(ROOT / "pyproject.toml", tmp_path)
    return tmp_path


def test_the_layers_hold_in_a_copy(copy):
    assert lint(copy).returncode == 0


@pytest.mark.parametrize(
    ("room", "forbidden"),
    [
        ("simulation/robots.py", "import pivometer.rcm"),
        ("geometry/line.py", "import pivometer.cameras"),
        ("rcm/least_squares.py", "import rich"),
        ("report/html.py", "import pivometer.io"),
        ("shaft/fitting/plain.py", "import pivometer.shaft.finding.motion"),
        ("pipeline/measuring.py", "import pivometer.app"),
        ("app/work.py", "import pivometer.cli"),
    ],
)
def test_a_forbidden_import_is_caught(copy, room, forbidden):
    path = copy / "src" / "pivometer" / room
    path.write_text(path.read_text(encoding="utf-8") + f"\n{forbidden}\n", encoding="utf-8")
    outcome = lint(copy)
    assert outcome.returncode != 0
    assert "BROKEN" in outcome.stdout
