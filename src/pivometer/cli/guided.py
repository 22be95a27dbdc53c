"""``pivometer app``."""

from pathlib import Path
from typing import Annotated

from cyclopts import Parameter
from cyclopts.validators import Number


def guided(
    session: Annotated[Path, Parameter(name="SESSION")] = Path("pivometer-session"),
    /,
    *,
    port: Annotated[int, Parameter(validator=Number(gte=0, lte=65535))] = 0,
    browser: bool = True,
) -> None:
    """Lead through a measurement in the browser of this computer.

    Five steps, which can be left and resumed. Nothing leaves this computer,
    and nobody without the printed address can look.

    Parameters
    ----------
    session
        Session folder; a new one is described in the app. The other commands work on it, too.
    port
        Port on the loopback address; a free one where none is given.
    browser
        Open the browser; with --no-browser the address is only printed.
    """
    from pivometer.app import run_app

    run_app(session, port=port, browser=browser)
