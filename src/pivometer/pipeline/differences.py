"""Every figure of a result against the same figure measured again."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np

LEFT_OUT = ("schema", "software", "sha256", "provenance", "inputs", "setup.session")
"""What may differ: when, where and by which version it was measured; inputs are compared apart."""

ADVICE = ".next_step"
"""Advice is no figure: of alternatives that are equally good, rounding picks one."""

SMALLEST = 1e-9
"""Numbers below this are not told apart: 1 pm, a billionth of a pixel, or rounding's own size."""


@dataclass(frozen=True, slots=True, eq=False)
class Differences:
    """Where two results differ.

    Parameters
    ----------
    beyond
        What differs beyond rounding, in words.
    count
        How many figures and texts were compared.
    largest
        The largest difference of numbers that rounding explains, relative to their size.
    identical
        Whether all are the same to the last bit.
    """

    beyond: list[str]
    count: int
    largest: float
    identical: bool

    TOLERANCE: ClassVar[float] = 1e-6
    """Other instructions of a processor (OpenBLAS for Sandy Bridge against AVX-512) changed no
    figure of the demo by more than 6e-8 of its size; a report prints at most five digits."""


def differences(stated: Mapping[str, Any], again: Mapping[str, Any]) -> Differences:
    """Compare the content of two results name by name.

    Texts, whole numbers and states must be the same. Numbers may differ by what other processors
    and library versions round differently. A list of numbers is compared against its largest.

    Examples
    --------
    >>> found = differences({"max_mm": 0.391}, {"max_mm": 0.381})
    >>> found.beyond
    ['max_mm: the file states 0.391, measured again 0.381']
    """
    beyond: list[str] = []
    sizes: list[float] = []
    count = 0
    for where, one, other in _pairs(stated, again, ""):
        count += 1
        if _is_numbers(one) and _is_numbers(other) and np.shape(one) == np.shape(other):
            difference = _relative(one, other)
            sizes.append(difference)
            told = difference > Differences.TOLERANCE
        else:
            told = one != other or type(one) is not type(other)
        if told:
            beyond.append(f"{where}: the file states {_short(one)}, measured again {_short(other)}")
    largest = max((size for size in sizes if size <= Differences.TOLERANCE), default=0.0)
    return Differences(beyond, count, largest, not any(sizes) and not beyond)


def _pairs(one: Any, other: Any, where: str) -> Iterator[tuple[str, Any, Any]]:
    """Walk two contents together down to texts, numbers and arrays of numbers."""
    if where in LEFT_OUT or where.endswith(ADVICE):
        return
    if isinstance(one, dict) and isinstance(other, dict):
        for name in [*one, *(name for name in other if name not in one)]:
            inside = f"{where}.{name}" if where else str(name)
            yield from _pairs(one.get(name, _ABSENT), other.get(name, _ABSENT), inside)
    elif _is_records(one) and _is_records(other) and len(one) == len(other):
        for i, (a, b) in enumerate(zip(one, other, strict=True)):
            name = a.get("pose", i) if isinstance(a, dict) else i
            yield from _pairs(a, b, f"{where}[{name}]")
    else:
        yield where, one, other


_ABSENT = "nothing"


def _is_records(value: object) -> bool:
    return isinstance(value, list) and not _is_numbers(value)


def _is_numbers(value: object) -> bool:
    """Tell numbers, and rectangular lists of numbers, from all else."""
    if isinstance(value, list):
        return bool(value) and all(map(_is_numbers, value)) and len({*map(np.shape, value)}) == 1
    return isinstance(value, float)


def _relative(one: Any, other: Any) -> float:
    a, b = np.asarray(one, dtype=float), np.asarray(other, dtype=float)
    apart = float(np.abs(a - b).max(initial=0.0))
    size = float(max(np.abs(a).max(initial=0.0), np.abs(b).max(initial=0.0)))
    return apart / max(size, SMALLEST / Differences.TOLERANCE)


def _short(value: object) -> str:
    text = repr(value) if isinstance(value, float | int | str) else str(value)
    return text if len(text) <= 60 else text[:57] + "…"
