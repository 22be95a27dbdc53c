"""``pivometer compare``: whether results differ."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter


def compare(
    *results: Annotated[Path, Parameter(name="RESULT")],
    output: Path | None = None,
) -> None:
    """Say whether results differ by more than chance explains.

    Every other result is compared with the first: rms misses always, locations where they are in
    one frame, largest misses at equal numbers of poses only.

    Parameters
    ----------
    results
        Two results or more: a result.json or the session folder it lies in.
    output
        Folder to write comparison.html and comparison.json into; nothing is written where none is
        given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import say, show_table
    from pivometer.report.comparison import comparison_table

    compared = pipeline.compare(pipeline.results_at(results))
    show_table(comparison_table(compared))
    for pair in compared.pairs:
        say(f"{pair.second} against {pair.first}", *(f"- {text}" for text in pair.statements))
        if pair.assumptions:
            say(f"  Taken for granted: {'; '.join(pair.assumptions)}.")
        say("")
    if output is not None:
        files = pipeline.write_comparison(compared, output)
        say(*(f"{name}: {path}" for name, path in files.items()))
