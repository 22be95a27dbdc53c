"""The package docstrings that say what each file of the shaft's rooms is for leave none out."""

import re
from pathlib import Path
from types import ModuleType

import pytest

from pivometer import shaft
from pivometer.shaft import finding, fitting


@pytest.mark.parametrize("room", [shaft, finding, fitting])
def test_every_file_of_a_room_is_on_its_map(room: ModuleType):
    folder = Path(str(room.__file__)).parent
    inside = [file for file in folder.iterdir() if file.suffix == ".py" or file.is_dir()]
    names = {file.stem for file in inside} - {"__init__", "__pycache__"}
    assert set(re.findall(r"`(\w+)`", room.__doc__ or "")) == names
