"""What Furo's pages lack for keyboards and screen readers."""

import re
from typing import Any

from sphinx.application import Sphinx

_PARAMETERS = re.compile(r'<dl>\n((?:<dd><em class="sig-param">.*?</dd>\n)+)</dl>', re.DOTALL)


def _complete(_: Sphinx, __: str, ___: str, context: dict[str, Any], ____: object) -> None:
    """Give the captions of the sidebar a level, and complete the body."""
    tree = context.get("furo_navigation_tree", "")
    context["furo_navigation_tree"] = tree.replace(
        'role="heading">', 'role="heading" aria-level="2">'
    )
    if "body" in context:
        body = context["body"].replace("<pre>", '<pre tabindex="0">')
        body = body.replace('<div class="table-wrapper', '<div tabindex="0" class="table-wrapper')
        context["body"] = _PARAMETERS.sub(_as_lines, body)


def _as_lines(signature: re.Match[str]) -> str:
    """Return parameters, one a line, as lines: Sphinx takes them for a list of definitions."""
    lines = signature[1].replace("<dd>", "<div>").replace("</dd>", "</div>")
    return f'<div class="sig-parameters">{lines}</div>'


def setup(app: Sphinx) -> dict[str, Any]:
    """Come after the theme."""
    app.connect("html-page-context", _complete, priority=900)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
