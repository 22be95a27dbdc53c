"""The styles of the report's drawings, for other pages that show them."""

import re
from importlib.resources import files


def drawing_rules(scope: str) -> str:
    """Return the report's rules for drawings, nested in a selector; the page defines the colours.

    Examples
    --------
    >>> drawing_rules(".figures").startswith(".figures {")
    True
    """
    page = files("pivometer.report").joinpath("templates", "report.css").read_text("utf-8")
    rules = re.findall(
        r"^(?:svg|\.scene|\.photo svg|\.photo \.)[^{}]*\{[^{}]*\}", page, re.MULTILINE
    )
    return f"{scope} {{\n" + "\n".join(rules) + "\n}"
