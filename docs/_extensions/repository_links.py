"""Links as the sources have them, relative and out of ``docs/``, taken to where the site has it.

A link to a page that the site includes (``../README.md``), to a folder (``adr/``), or to a source
file (``../src/…/intrinsic.py``) leads to the page, the folder's list, or the listing. Any other
file of the repository is offered for download.
"""

import posixpath
import re
from pathlib import Path
from typing import Any

from docutils import nodes
from sphinx import addnodes
from sphinx.application import Sphinx
from sphinx.transforms import SphinxTransform

PAGES = {
    "../README.md": "readme",
    "../CHANGELOG.md": "changelog",
    "../CONTRIBUTING.md": "contributing",
    "../examples/reproduce_paper.py": "reference/reproduce-paper",
}
"""Files beside ``docs/`` and the pages that include them."""

_LINK = re.compile(r"(\]\()(?!\w+:|#|/)([^)\s]+\))")


def _seen_from_docs(_: Sphinx, path: Path, __: str, text: list[str]) -> None:
    """Make the links of an included file relative to ``docs/``, from where it is included."""
    if path.as_posix() in PAGES:
        text[0] = _LINK.sub(r"\1../\2", text[0])


class _Resolve(SphinxTransform):
    """Point every link at what the site has of its target."""

    default_priority = 5

    def apply(self, **_: Any) -> None:
        for link in list(self.document.findall(_leaves_the_pages)):
            path, _, anchor = link["reftarget"].partition("#")
            target = self._seen_from_docs(path)
            page = self._page_of(target)
            if page is not None:
                _become_page(link, page, anchor or link.get("reftargetid"))
            elif target.startswith("../src/pivometer/"):
                _become_listing(link, target)

    def _seen_from_docs(self, path: str) -> str:
        """Return a path as seen from ``docs/``; MyST gives some in full, without their ending."""
        if not path.startswith("/"):
            path = self.env.relfn2path(path, self.env.docname)[1]
        return posixpath.relpath(path, Path(self.env.srcdir).as_posix())

    def _page_of(self, target: str) -> str | None:
        """Return the page that includes a file, or that lists a folder."""
        folder = posixpath.join(target, "README")
        included = PAGES.get(target) or PAGES.get(f"{target}.md")
        return included or (folder if folder in self.env.found_docs else None)


def _leaves_the_pages(node: nodes.Node) -> bool:
    if not isinstance(node, addnodes.download_reference | addnodes.pending_xref):
        return False
    inside = node["refdomain"] == "doc" and not node["reftarget"].startswith("/")
    return node["reftype"] == "myst" and not inside


def _become_page(link: nodes.Element, page: str, anchor: str | None) -> None:
    link.replace_self(
        addnodes.pending_xref(
            "",
            *link.children,
            refdomain="doc",
            reftype="myst",
            reftarget=page,
            reftargetid=anchor,
            refdoc=link["refdoc"],
            refexplicit=link["refexplicit"],
        )
    )


def _become_listing(link: nodes.Element, target: str) -> None:
    module = target.removeprefix("../src/").removesuffix(".py").removesuffix("/__init__")
    up = "../" * link["refdoc"].count("/")
    reference = nodes.reference("", "", *link.children, refuri=f"{up}_modules/{module}.html")
    link.replace_self(reference)


def setup(app: Sphinx) -> dict[str, Any]:
    """Listen to what is read."""
    app.connect("include-read", _seen_from_docs)
    app.add_transform(_Resolve)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
