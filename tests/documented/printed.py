"""Whether what a page shows is what was printed: every word, and numbers to their last digit."""

from __future__ import annotations

import re
from collections.abc import Sequence
from decimal import Decimal

GAP = "…"
"""Stands in a page for what it leaves out: by itself for any words, in a word for any letters."""

_NUMBER = re.compile(r"\d+(?:\.\d+)?(?:e[-+]?\d+)?")
_RULE = re.compile(r"[─━]+")


def difference(shown: str, printed: str) -> str | None:
    """Return in what a page's output differs from what was printed; `None` if in nothing.

    Lines may be broken elsewhere and columns be wider, for a number that grew by a digit moves
    them. A number with decimals may differ by one in its last digit: other linear algebra rounds
    the sixteenth digit otherwise, and what is printed has six at most, so only a number that lies
    on the edge between two can differ, and by no more. Whole numbers are counted, and must agree.

    Examples
    --------
    >>> difference("misses by 0.31 mm …", "misses by 0.32 mm rms over 20 poses")
    >>> difference("misses by 0.31 mm", "misses by 0.33 mm")
    'the page shows “0.31” where “misses by” is followed by “0.33”'
    >>> difference("20 poses", "21 poses")
    'the page shows “20” where “” is followed by “21”'
    """
    words, found = _words(shown), _words(printed)
    runs = _runs(words)
    at, free = 0, False
    for number, run in enumerate(runs):
        last = number == len(runs) - 1
        begins = _place(run, found, at, free=free, to_end=last)
        if begins is None:
            return _told(run, found, at, free=free)
        at, free = begins + len(run), True
    return None


def _words(text: str) -> list[str]:
    return _RULE.sub("─", text).split()


def _runs(words: Sequence[str]) -> list[list[str]]:
    """Split at the gaps."""
    runs: list[list[str]] = [[]]
    for word in words:
        if word == GAP:
            runs.append([])
        else:
            runs[-1].append(word)
    return runs


def _place(
    run: Sequence[str], found: Sequence[str], at: int, *, free: bool, to_end: bool
) -> int | None:
    """Return where a run of words begins: at `at`, or anywhere after it if that is free."""
    end = len(found) - len(run)
    if to_end:
        begins = range(end, end + 1) if free or end == at else range(0)
    else:
        begins = range(at, end + 1 if free else at + 1)
    return next((b for b in begins if b >= at and _agree(run, found[b : b + len(run)])), None)


def _agree(run: Sequence[str], found: Sequence[str]) -> bool:
    return len(run) == len(found) and all(map(same_word, run, found))


def same_word(shown: str, printed: str) -> bool:
    """Tell whether two words agree, numbers in them to one in their last digit.

    Examples
    --------
    >>> same_word("(0.120,", "(0.119,"), same_word("0.12", "0.120"), same_word("k=2", "k=3")
    (True, False, False)
    >>> same_word("http://127.0.0.1:…/?token=…", "http://127.0.0.1:80/?token=Xy-")
    True
    """
    if GAP in shown:
        pattern = ".*".join(map(re.escape, shown.split(GAP)))
        return re.fullmatch(pattern, printed) is not None
    numbers, others = _NUMBER.findall(shown), _NUMBER.findall(printed)
    return (
        _NUMBER.sub("#", shown) == _NUMBER.sub("#", printed)
        and len(numbers) == len(others)
        and all(map(_close, numbers, others))
    )


def _close(shown: str, printed: str) -> bool:
    one, other = Decimal(shown), Decimal(printed)
    step = Decimal(1).scaleb(int(one.as_tuple().exponent))
    same_place = one.as_tuple().exponent == other.as_tuple().exponent
    allowed = step if "." in shown else 0
    return same_place and abs(one - other) <= allowed


def _told(run: Sequence[str], found: Sequence[str], at: int, *, free: bool) -> str:
    """Say at which word a run stops to agree, at the place where most of it does."""
    lengths = {b: _agreeing(run, found[b:]) for b in range(at, len(found) if free else at + 1)}
    best = max(lengths, key=lambda b: lengths[b], default=at)
    same = lengths.get(best, 0)
    before, after = " ".join(found[max(0, best + same - 4) : best + same]), found[best + same :]
    shown = run[same] if same < len(run) else "no more"
    return f"the page shows “{shown}” where “{before}” is followed by “{' '.join(after[:1])}”"


def _agreeing(run: Sequence[str], found: Sequence[str]) -> int:
    pairs = enumerate(zip(run, found, strict=False))
    return next((i for i, pair in pairs if not same_word(*pair)), min(len(run), len(found)))
