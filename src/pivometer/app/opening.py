"""Open the browser without showing the token to the other users of this computer."""

from __future__ import annotations

import html
import os
import tempfile
import webbrowser
from pathlib import Path

_PAGE = (
    "<!doctype html><meta charset=utf-8><title>Pivometer</title>"
    '<meta http-equiv="refresh" content="0; url={url}"><p><a href="{url}">Open Pivometer</a>'
)


def open_browser(url: str) -> Path:
    """Open an address in the browser through a file that only its owner can read.

    A browser's command line can be read by all users; so it names a file that sends it on.

    Returns
    -------
    pathlib.Path
        That file, to be removed in the end.
    """
    handle, name = tempfile.mkstemp(prefix="pivometer-", suffix=".html")  # made with mode 0600
    with os.fdopen(handle, "w", encoding="utf-8") as page:
        page.write(_PAGE.format(url=html.escape(url, quote=True)))
    webbrowser.open(Path(name).as_uri())
    return Path(name)
