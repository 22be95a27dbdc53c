"""Rigs in the formats of other programs: read whatever a file holds, write what a format carries.

Half a pixel, transposed matrices, metres, inverse transforms: every conversion between conventions
is in this package and nowhere else.
"""

from __future__ import annotations

import hashlib
from pathlib import Path
from types import ModuleType

from pivometer.calibration import Calibration
from pivometer.cameras import Rig
from pivometer.errors import UsageError
from pivometer.io.atomic import write_file, write_files
from pivometer.io.formats import colmap, kalibr, matlab, mrcal, opencv, ros
from pivometer.io.formats.conventions import Told
from pivometer.io.result import read_rig
from pivometer.measurement import ImportedRig

FORMATS: dict[str, ModuleType] = {
    "opencv": opencv,
    "ros": ros,
    "kalibr": kalibr,
    "matlab": matlab,
    "colmap": colmap,
    "mrcal": mrcal,
}
FOLDERS = ("ros", "colmap", "mrcal")
"""Formats of several files: they are read from a folder, and written into one."""
_DAMAGE = (
    ArithmeticError, AttributeError, LookupError, MemoryError, RecursionError, TypeError,
    ValueError,
)  # fmt: skip
"""What parsers and arithmetic raise over content that is not what the format promises."""
MOST_BYTES = 100_000_000
"""No calibration is larger; what is, is not read."""


def read_any_rig(
    path: Path | str,
    *,
    unit_mm: float | None = None,
    image_size: tuple[int, int] | None = None,
) -> Calibration | ImportedRig:
    """Read a rig from a ``rig.json``, a ``result.json``, or a file or folder of another program.

    What a file is, is told from its content, not from its name.

    Parameters
    ----------
    path
        A file, or a folder that holds the files of one rig; other files in it are passed over.
    unit_mm
        Length of the file's unit, mm, for files that state none.
    image_size
        Width and height of the images, px, for files that state none.

    Raises
    ------
    UsageError
        If the file is of no known format, or holds what Pivometer cannot carry; the message says
        what.
    """
    source = Path(path)
    contents = _contents(source)
    by_format: dict[str, dict[str, bytes]] = {}
    for name, content in contents.items():
        known = next((n for n, one in FORMATS.items() if one.recognise(content)), None)
        if known is not None:
            by_format.setdefault(known, {})[name] = content
    if not by_format and len(contents) == 1 and next(iter(contents.values())).lstrip()[:1] == b"{":
        return read_rig(source if source.is_file() else source / next(iter(contents)))
    if len(by_format) != 1:
        raise UsageError(
            f"holds {' and '.join(by_format) or 'no'} calibration in a format that is known; these "
            f"are rig.json, {', '.join(FORMATS)}",
            next_step="name one calibration, or the folder that holds its files and no other",
            path=source,
        )
    ((file_format, files),) = by_format.items()
    try:
        rig: Rig = FORMATS[file_format].read(files, Told(unit_mm, image_size))
    except UsageError as error:
        what = f"({file_format}) {error.what}"
        raise UsageError(what, next_step=error.next_step, path=source) from error
    except _DAMAGE as error:
        what = f"({file_format}) is damaged: {type(error).__name__} {error}"
        raise UsageError(
            what, next_step="name a whole file, or write it anew", path=source
        ) from error
    hashes = {name: hashlib.sha256(content).hexdigest() for name, content in files.items()}
    return ImportedRig(rig, file_format, hashes)


def _contents(source: Path) -> dict[str, bytes]:
    """Return the content of a file, or of the files of a folder, by name."""
    try:
        files = sorted(source.iterdir()) if source.is_dir() else [source]
        return {
            file.name: file.read_bytes()
            for file in files
            if file == source or (file.is_file() and file.stat().st_size < MOST_BYTES)
        }
    except OSError as error:
        raise UsageError(
            f"cannot be read: {error.strerror}", next_step="check the path", path=source
        ) from error


def write_rig(rig: Rig, file_format: str, path: Path | str) -> tuple[Path, ...]:
    """Write a rig in the format of another program; all of its files, or none.

    Parameters
    ----------
    rig
        The cameras and their poses.
    file_format
        One of `FORMATS`.
    path
        The file; for the formats of several files, the folder.

    Returns
    -------
    tuple of pathlib.Path
        The files written.

    Raises
    ------
    UsageError
        If the format cannot carry the rig, or a file cannot be written.
    """
    target = Path(path)
    if file_format not in FORMATS:
        raise UsageError(
            f"there is no format {file_format!r}", next_step=f"choose one of {', '.join(FORMATS)}"
        )
    files: dict[str, bytes] = FORMATS[file_format].write(rig, target.name)
    if file_format in FOLDERS:
        return tuple(write_files(target, files).values())
    return (write_file(target, files[target.name]),)
