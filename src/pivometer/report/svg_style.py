"""The styles of the report's drawings, written into each of them, for readers without its page."""

import re
from functools import cache
from importlib.resources import files

from markupsafe import Markup

_FONT = "Libertinus Serif"
"""The typesetter brings this font along, so a drawing is the same on every machine."""


def standalone(drawing: Markup, *, style: str = "") -> str:
    """Return a drawing as a file of its own, in the colours of paper.

    Parameters
    ----------
    drawing
        An ``<svg>`` of the report.
    style
        Further rules.

    Examples
    --------
    >>> standalone(Markup('<svg viewBox="0 0 1 1"></svg>'))[:60]
    '<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 1 1"><s'
    """
    head, mark, body = str(drawing).partition(">")
    head = head.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg"', 1)
    classes = {
        word for names in re.findall(r'class="([^"]*)"', str(drawing)) for word in names.split()
    }
    rules = "".join(rule for needed, rule in _rules() if needed <= classes)
    return f"{head}{mark}<style>{rules}{style}</style>{body}"


@cache
def _rules() -> tuple[tuple[frozenset[str], str], ...]:
    """Return the page's rules for drawings in its print style, each with the classes it needs."""
    page = files("pivometer.report").joinpath("templates", "report.css").read_text("utf-8")
    screen, _, paper = page.partition("@media print")
    colours = dict(re.findall(r"--(\w[\w-]*):\s*(#\w+)", paper))
    rules = []
    for selectors, body in re.findall(
        r"^((?:svg|\.scene)[^{}]*)\{([^{}]*)\}", screen, re.MULTILINE
    ):
        text = re.sub(r"var\(--([\w-]+)\)", lambda found: colours[found[1]], body.strip())
        text = text.replace("font-family: inherit", f'font-family: "{_FONT}"')
        for selector in selectors.split(","):
            needed = frozenset(re.findall(r"\.([\w-]+)", selector))
            rules.append((needed, f"{selector.strip()}{{{text}}}"))
    return tuple(rules)
