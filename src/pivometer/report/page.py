"""A page from a template of ours: self-contained, with every text escaped."""

from importlib.resources import files

from markupsafe import Markup


def render_page(template: str, **content: object) -> str:
    """Fill a template with the page's style and what it asks for."""
    from jinja2 import Environment, PackageLoader, StrictUndefined

    environment = Environment(
        loader=PackageLoader("pivometer.report"),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    return environment.get_template(template).render(style=asset("report.css"), **content)


def asset(name: str) -> Markup:
    """Return a file of ours that stands in a page as it is."""
    text = files("pivometer.report").joinpath("templates", name).read_text(encoding="utf-8")
    return Markup(text)  # noqa: S704 – our own file, no user text in it
