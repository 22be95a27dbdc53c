"""The command line: parse, call one pipeline function, show its result."""

import sys
from collections.abc import Sequence

from pivometer._version import __version__
from pivometer.cli.front_page import FRONT_PAGE


def main(arguments: Sequence[str] | None = None) -> int:
    """Run ``pivometer`` with `arguments`, those of the process where none are given.

    Returns
    -------
    int
        The exit code: 0 done, 2 wrong usage or configuration, 3 data unfit, 70 a fault of
        Pivometer itself, 130 interrupted.

    Examples
    --------
    >>> main(["--version"])  # doctest: +ELLIPSIS
    pivometer ...
    0
    """
    given = list(sys.argv[1:] if arguments is None else arguments)
    if given == ["--version"]:
        sys.stdout.write(f"pivometer {__version__}\n")
        return 0
    if given in ([], ["--help"], ["-h"]):
        sys.stdout.write(FRONT_PAGE)
        return 0
    from pivometer.cli.app import run

    return run(given)
