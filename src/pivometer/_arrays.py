"""Shape checks at the public boundary, and read-only copies for frozen types."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from pivometer.errors import ShapeError

Floats = NDArray[np.float64]
"""A float64 array; its shape, unit and frame stand in the docstring that uses it."""


def read_only(values: ArrayLike) -> Floats:
    """Return a float64 copy of `values` that cannot be written to.

    Examples
    --------
    >>> read_only([1, 2]).flags.writeable
    False
    """
    array = np.array(values, dtype=np.float64)
    array.setflags(write=False)
    return array


def checked(values: ArrayLike, shape: Sequence[int | None], name: str) -> Floats:
    """Return `values` as float64 after checking its trailing shape and that it is finite.

    Parameters
    ----------
    values
        Array-like of numbers.
    shape
        The trailing axes wanted; `None` stands for any length. Further leading (batch) axes are
        allowed only where `shape` starts with `...` (Ellipsis is written as ``-1``).
    name
        What the message calls the array.

    Raises
    ------
    ShapeError
        If the shape differs or a value is not finite.

    Examples
    --------
    >>> checked([[1, 2, 3]], (None, 3), "points").shape
    (1, 3)
    """
    array = np.asarray(values, dtype=np.float64)
    batched = len(shape) > 0 and shape[0] == -1
    wanted = tuple(shape[1:] if batched else shape)
    got = array.shape[array.ndim - len(wanted) :] if batched else array.shape
    fits = len(got) == len(wanted) and all(
        w is None or w == g for w, g in zip(wanted, got, strict=True)
    )
    if not fits:
        text = ", ".join("n" if w is None else str(w) for w in wanted)
        raise ShapeError(
            f"{name} has shape {array.shape}, not ({'..., ' if batched else ''}{text})",
            next_step="pass an array of the documented shape",
        )
    if not np.isfinite(array).all():
        count = int(np.size(array) - np.isfinite(array).sum())
        raise ShapeError(
            f"{name} holds {count} values that are not finite",
            next_step="remove the missing values first",
        )
    return array
