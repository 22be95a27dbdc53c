"""Where a page differs from the one drawn anew, in words that lead a reader there."""

from __future__ import annotations

import re

_AROUND = 24
"""Characters shown on either side of a difference."""


def page_changes(page: str, redrawn: str, *, limit: int) -> list[str]:
    """Say where a page differs from the one drawn anew; an empty list where it does not.

    Examples
    --------
    >>> head = "<h2>Result</h2>" + chr(10)
    >>> page_changes(head + "<td>0.391</td>", head + "<td>0.381</td>", limit=3)
    ['in “Result”: shows “<td>0.391</td>”, should show “<td>0.381</td>”']
    """
    if page == redrawn:
        return []
    theirs, ours = page.split("\n"), redrawn.split("\n")
    if len(theirs) != len(ours):
        return [_change(page, redrawn, "")]
    changed = [i for i, (a, b) in enumerate(zip(theirs, ours, strict=True)) if a != b]
    told = [_change(theirs[i], ours[i], "\n".join(theirs[:i])) for i in changed[:limit]]
    more = len(changed) - limit
    return [*told, f"and {more} more lines"] if more > 0 else told


def _change(shown: str, right: str, before: str) -> str:
    """Show the first difference of two texts, after the text that both have before them."""
    at = _first_difference(shown, right)
    start = max(0, at - _AROUND)
    one, other = (_shown(text[start : at + _AROUND]) for text in (shown, right))
    return f"in {_place(before + shown[:at])}: shows “{one}”, should show “{other}”"


def _shown(text: str) -> str:
    return text.replace("\n", " ")


def _first_difference(one: str, other: str) -> int:
    pairs = enumerate(zip(one, other, strict=False))
    return next((i for i, (a, b) in pairs if a != b), min(len(one), len(other)))


def _place(before: str) -> str:
    """Name the section by the last heading before it."""
    headings = re.findall(r"<h2[^>]*>([^<]*)</h2>", before)
    return f"“{headings[-1]}”" if headings else "the head of the page"
