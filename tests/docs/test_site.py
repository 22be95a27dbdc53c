"""The documentation site: it builds without warnings, asks no other host, and no link is broken."""

import posixpath
import re
import subprocess
import sys
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote

import pytest

import pivometer

DOCS = Path(__file__).resolve().parents[2] / "docs"
LOADING = {
    ("script", "src"),
    ("link", "href"),
    ("img", "src"),
    ("img", "srcset"),
    ("source", "src"),
    ("source", "srcset"),
    ("video", "src"),
    ("iframe", "src"),
    ("object", "data"),
    ("embed", "src"),
    ("use", "href"),
    ("form", "action"),
}
"""What a browser fetches or sends by itself, in contrast to links that a reader may follow."""


@dataclass
class Page(HTMLParser):
    """What one page loads, links to and can be linked at."""

    text: str = field(repr=False)
    loads: set[str] = field(default_factory=set)
    links: set[str] = field(default_factory=set)
    anchors: set[str] = field(default_factory=set)
    tags: set[str] = field(default_factory=set)

    def __post_init__(self):
        super().__init__()
        self.feed(self.text)

    def handle_starttag(self, tag, attrs):
        self.tags.add(tag)
        for name, value in attrs:
            if (tag, name) in LOADING:
                self.loads.add(value)
            if (tag, name) == ("a", "href"):
                self.links.add(value)
            if name == "id":
                self.anchors.add(value)


def build(pages: Path, folder: Path) -> subprocess.CompletedProcess[str]:
    """Build as ``make docs`` does; a warning fails it."""
    return subprocess.run(  # noqa: S603
        [sys.executable, "-m", "sphinx", "-q", "-W", "--keep-going", "-c", DOCS, pages, folder],
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.fixture(scope="module")
def site(tmp_path_factory) -> Path:
    folder = tmp_path_factory.mktemp("site")
    built = build(DOCS, folder)
    assert (built.returncode, built.stderr) == (0, "")
    return folder


@pytest.fixture(scope="module")
def pages(site) -> dict[str, Page]:
    return {
        path.relative_to(site).as_posix(): Page(path.read_text(encoding="utf-8"))
        for path in site.rglob("*.html")
    }


def is_elsewhere(address: str) -> bool:
    return "//" in address.partition("#")[0] or address.startswith(("data:", "mailto:"))


def test_no_page_loads_anything_from_another_host(pages):
    loads = {load for page in pages.values() for load in page.loads}
    assert len(loads) > 20
    assert not {load for load in loads if is_elsewhere(load) and not load.startswith("data:")}


def test_no_style_asks_another_host(site):
    styles = [path.read_text(encoding="utf-8") for path in site.rglob("*.css")]
    assert len(styles) > 3
    addresses = re.findall(r"""(?:url\(|@import)\s*["']?([^"')\s]+)""", "".join(styles))
    assert addresses
    assert not [a for a in addresses if is_elsewhere(a) and not a.startswith("data:")]


def test_every_link_leads_somewhere(site, pages):
    broken = []
    for name, page in pages.items():
        for link in page.links | page.loads:
            path, _, anchor = unquote(link).partition("#")
            if is_elsewhere(link):
                continue
            target = (
                posixpath.normpath(posixpath.join(posixpath.dirname(name), path)) if path else name
            )
            target = target.partition("?")[0]
            found = target in pages if target.endswith(".html") else (site / target).is_file()
            if not found or (anchor and target in pages and anchor not in pages[target].anchors):
                broken.append((name, link))
    assert broken == []


@pytest.mark.parametrize(
    ("wrong", "told"),
    [
        ("[gone](gone.md)", "gone.md"),
        ("[gone](index.md#gone)", "gone"),
        ("{py:obj}`pivometer.gone`", "pivometer.gone"),
    ],
)
def test_a_wrong_reference_fails_the_build(tmp_path, wrong, told):
    (tmp_path / "pages").mkdir()
    (tmp_path / "pages" / "index.md").write_text(f"# Title\n\n{wrong}\n", encoding="utf-8")
    built = build(tmp_path / "pages", tmp_path / "site")
    assert built.returncode != 0
    assert told in built.stderr


def test_a_broken_link_would_be_found():
    assert Page('<a href="no.html#x"><img src="https://a.b/c.png">').links == {"no.html#x"}
    assert is_elsewhere("https://a.b/c.png")


def test_every_public_name_has_an_entry(pages):
    entries = pages["reference/python/index.html"].anchors
    names = {name for name in pivometer.__all__ if name != "__version__"}
    assert {f"pivometer.{name}" for name in names} <= entries


def test_the_equations_lead_to_their_functions(pages):
    links = pages["conventions.html"].links
    assert "reference/python/rcm.html#pivometer.rcm.minimax_rcm" in links
    assert "reference/python/shaft.html#pivometer.shaft.silhouette.coimage_normal" in links
    assert "reference/python/cameras.html#pivometer.cameras.Camera.project" in links


def test_commands_keys_and_results_are_all_described(pages):
    from pivometer.cli.app import app
    from pivometer.io.schema import schema
    from pivometer.io.settings import KEYS

    commands = {f"pivometer-{name}" for name in app if not name.startswith("-")}
    assert commands <= pages["reference/command-line.html"].anchors
    settings = pages["reference/session-toml.html"].text
    assert all(key.meaning in settings for key in KEYS.values())
    types = {name.lower() for name, part in schema()["$defs"].items() if "properties" in part}
    assert types <= pages["reference/result-json.html"].anchors


def test_formulas_are_mathml(pages):
    page = pages["explanation/mathematics.html"]
    assert {"math", "mtable", "msubsup"} <= page.tags
    assert "merror" not in page.tags
    assert not [name for name, page in pages.items() if "$$" in page.text]


READ = [
    "index.html",
    "explanation/mathematics.html",
    "explanation/report.html",
    "reference/python/rcm.html",
    "reference/command-line.html",
]
THEME_S_OWN = {"landmark-unique"}
"""Furo's two sidebars have no names."""


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_pages_can_be_read_by_everyone_and_ask_no_host(site, browser, scheme):
    axe = pytest.importorskip("axe_playwright_python.sync_playwright", reason="axe is not there")
    context = browser.new_context(viewport={"width": 390, "height": 800}, color_scheme=scheme)
    page, asked = context.new_page(), []
    page.on("request", lambda request: asked.append(request.url))
    for name in READ:
        page.goto((site / name).as_uri())
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        found = {one["id"] for one in axe.Axe().run(page).response["violations"]}
        assert found <= THEME_S_OWN, name
    assert asked
    assert not [url for url in asked if not url.startswith(("file:", "data:"))]
    context.close()
