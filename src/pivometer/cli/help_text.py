"""How ``--help`` sets its words: paragraphs fill the terminal, wherever the source breaks lines."""

from typing import Any

from cyclopts.help import HelpPanel
from cyclopts.help.formatters import DefaultFormatter
from rich.console import Console, ConsoleOptions
from rich.text import Text


class FilledParagraphs(DefaultFormatter):
    """Cyclopts' own panels, with descriptions reflowed."""

    def __call__(self, console: Console, options: ConsoleOptions, panel: HelpPanel) -> None:
        """Print a panel of arguments or parameters."""
        for entry in panel.entries:
            _fill(entry.description)
        super().__call__(console, options, panel)

    def render_description(
        self, console: Console, options: ConsoleOptions, description: Any
    ) -> None:
        """Print what a command does."""
        _fill(description)
        super().render_description(console, options, description)


def _fill(description: Any) -> None:
    """Join the lines of each paragraph."""
    text = getattr(description, "primary_renderable", None)
    if isinstance(text, Text):
        paragraphs = text.plain.split("\n\n")
        filled = "\n\n".join(" ".join(paragraph.split()) for paragraph in paragraphs)
        description.primary_renderable = Text(filled, end=text.end)
