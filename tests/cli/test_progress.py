import io

from rich.console import Console

from pivometer.cli.progress import progress_bar


def drawn(*, terminal: bool) -> str:
    stream = io.StringIO()
    console = Console(file=stream, force_terminal=terminal, width=80)
    with progress_bar(console) as progress:
        progress("finding boards [mm]", 0, 3)
        progress("finding boards [mm]", 3, 3)
    return stream.getvalue()


def test_a_terminal_sees_the_stage_and_how_far_it_is() -> None:
    text = drawn(terminal=True)
    assert "finding boards [mm]" in text
    assert "3/3" in text


def test_elsewhere_nothing_is_drawn() -> None:
    assert drawn(terminal=False) == ""
