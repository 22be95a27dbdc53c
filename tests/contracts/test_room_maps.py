"""The package docstring that says what each file of the shaft's room is for leaves none out."""

import re
from pathlib import Path

from pivometer import shaft


def test_every_file_of_the_shafts_room_is_on_its_map():
    folder = Path(str(shaft.__file__)).parent
    files = {file.stem for file in folder.glob("*.py")} - {"__init__"}
    assert set(re.findall(r"`(\w+)`", shaft.__doc__ or "")) == files
