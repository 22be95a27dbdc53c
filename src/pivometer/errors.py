"""Every error Pivometer raises on purpose.

::

    PivometerError
    ├── UsageError                  what was asked for cannot be done        exit code 2
    │   ├── SessionError            the folder or its session.toml is wrong
    │   └── ShapeError              an array has the wrong shape (also a ValueError)
    └── DataError                   the data cannot support an answer        exit code 3
        ├── ImageError              an image is missing, truncated or does not fit the others
        ├── BoardNotFoundError      the calibration board is not (all) there
        ├── CalibrationError        the board views do not determine the cameras
        ├── ShaftNotFoundError      the shaft cannot be told from its surroundings
        └── DegenerateGeometryError the geometry leaves the answer undetermined
            └── TooFewPosesError    fewer usable poses than the answer needs

A message says what happened, with the numbers; ``next_step`` says what to do about it; ``path``
names the file, where there is one.
"""

from pathlib import Path
from typing import ClassVar


class PivometerError(Exception):
    """Anything Pivometer refuses to do, with the reason and the next step.

    Parameters
    ----------
    what
        What happened, with the numbers; one sentence without a full stop at the end.
    next_step
        What the user does about it; one imperative sentence.
    path
        The file or folder concerned, if any.

    Examples
    --------
    >>> from pivometer.errors import SessionError
    >>> print(SessionError("no session.toml in this folder", next_step="name a session folder"))
    no session.toml in this folder; next: name a session folder
    """

    exit_code: ClassVar[int] = 3

    def __init__(self, what: str, *, next_step: str, path: Path | str | None = None) -> None:
        self.what = what
        self.next_step = next_step
        self.path = None if path is None else Path(path)
        super().__init__(what)

    def __str__(self) -> str:
        where = "" if self.path is None else f"{self.path}: "
        return f"{where}{self.what}; next: {self.next_step}"


class UsageError(PivometerError):
    """What was asked for cannot be done as asked (exit code 2)."""

    exit_code: ClassVar[int] = 2


class SessionError(UsageError):
    """A folder is not a session, or its ``session.toml`` is wrong."""


class ShapeError(UsageError, ValueError):
    """An array does not have the documented shape, or holds values that are not finite."""


class DataError(PivometerError):
    """The data cannot support an answer (exit code 3)."""


class ImageError(DataError):
    """An image is missing, truncated, or does not fit the others of its camera."""


class BoardNotFoundError(DataError):
    """The calibration board was not found in an image, or not all of it."""


class CalibrationError(DataError):
    """The board views do not determine the cameras."""


class ShaftNotFoundError(DataError):
    """The shaft cannot be told from its surroundings."""


class DegenerateGeometryError(DataError):
    """The geometry leaves the answer undetermined."""


class TooFewPosesError(DegenerateGeometryError):
    """Fewer usable poses than the answer needs."""
