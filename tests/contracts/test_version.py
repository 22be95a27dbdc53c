"""What a file says it was made by tells two states of the code apart."""

import importlib.util
import shutil
from pathlib import Path

from pivometer import _version


def named(folder: Path) -> str:
    spec = importlib.util.spec_from_file_location("copied_version", folder / "_version.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.software()


def test_the_name_follows_the_code_and_not_its_line_ends(tmp_path: Path) -> None:
    shutil.copy(_version.__file__, tmp_path)
    (tmp_path / "cost.py").write_bytes(b"one = 1\ntwo = 2\n")
    before = named(tmp_path)
    assert before.startswith(f"pivometer {_version.__version__} (code ")
    (tmp_path / "cost.py").write_bytes(b"one = 1\r\ntwo = 2\r\n")
    (tmp_path / "__pycache__").mkdir()
    (tmp_path / "__pycache__" / "cost.cpython-312.pyc").write_bytes(b"x")
    assert named(tmp_path) == before
    (tmp_path / "cost.py").write_bytes(b"one = 1\ntwo = 3\n")
    assert named(tmp_path) != before
