"""``pivometer demo`` and ``pivometer simulate``: sessions whose truth is known."""

from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number


def demo(folder: Annotated[Path, Parameter(name="DIR")] = Path("pivometer-demo"), /) -> None:
    """Render a small session, measure it and write the report.

    Parameters
    ----------
    folder
        Folder to make; a demo that is there is replaced.
    """
    from pivometer import pipeline
    from pivometer.cli.progress import progress_bar
    from pivometer.cli.show import show_demo

    with progress_bar() as progress:
        outcome = pipeline.demo(folder, progress=progress)
    show_demo(outcome)


def simulate(
    preset: Annotated[Literal["gold", "davinci", "micro"], Parameter(name="PRESET")],
    folder: Annotated[Path, Parameter(name="DIR")],
    /,
    *,
    poses: Annotated[int | None, Parameter(validator=Number(gte=3))] = None,
    seed: Annotated[int, Parameter(validator=Number(gte=0))] = 0,
) -> None:
    """Render a session whose truth is known, in DIR/truth.json.

    Parameters
    ----------
    preset
        gold: a spherical bearing; davinci: an arm with assembly errors; micro: the same small.
    folder
        Session folder to make; a simulated session that is there is replaced.
    poses
        Number of robot poses; the preset's own, 70, where none is given.
    seed
        Another seed gives another robot of the same kind, other poses and other noise.
    """
    from pivometer import pipeline
    from pivometer.cli.progress import progress_bar
    from pivometer.cli.show import say

    with progress_bar() as progress:
        made = pipeline.simulate(preset, folder, poses=poses, seed=seed, progress=progress)
    say(f"Session: {made}", f"Next:    pivometer measure {made}")
