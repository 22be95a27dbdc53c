"""``pivometer check``: whether a limit is kept, for acceptance tests and CI."""

import shlex
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import Parameter
from cyclopts.validators import Number

from pivometer.errors import PivometerError, UsageError

if TYPE_CHECKING:
    from pivometer.measurement import Measurement


def check(
    session: Annotated[Path, Parameter(name="SESSION")],
    /,
    *,
    limit: Annotated[float, Parameter(validator=Number(gt=0))],
    guard: Annotated[float | None, Parameter(validator=Number(gte=0))] = None,
    baseline: Path | None = None,
    junit: Path | None = None,
    rig: Path | None = None,
    floor: Path | None = None,
    output: Path | None = None,
) -> int:
    """Decide whether a robot's RCM error keeps a limit.

    Parameters
    ----------
    session
        Session folder, which is measured; or a result.json, which is taken as it is.
    limit
        Limit of the largest miss, mm.
    guard
        Guard band U about the observed largest miss, mm; the 95 % interval of the robot's own
        largest miss decides where none is given.
    baseline
        The result.json of an earlier measurement: also not passed if the rms miss has grown by more
        than chance explains.
    junit
        JUnit XML file to write.
    rig
        The rig.json of an earlier calibration, for a session.
    floor
        The result.json of a gold standard, for a session: see pivometer measure.
    output
        Folder for the results of a session; nothing is written where none is given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import show_check
    from pivometer.io.result import read_result

    try:
        earlier = None if baseline is None else read_result(baseline)
        measurement = _measured(session, rig, floor, output, limit, guard)
        outcome = pipeline.check(measurement, limit, guard_mm=guard, baseline=earlier)
    except PivometerError as error:
        if junit is not None:  # or CI would show the file of the last run
            pipeline.write_junit(error, junit, name=str(session))
        raise
    if junit is not None:
        pipeline.write_junit(outcome, junit, name=str(session))
    show_check(outcome)
    return outcome.exit_code


def _measured(
    session: Path,
    rig: Path | None,
    floor: Path | None,
    output: Path | None,
    limit: float,
    guard: float | None,
) -> "Measurement":
    """Return the measurement in a result file, or measure a session."""
    from pivometer import pipeline
    from pivometer.cli.progress import progress_bar
    from pivometer.io.result import read_floor, read_result, read_rig

    if session.is_file():
        if any(option is not None for option in (rig, floor, output)):
            raise UsageError(
                "--rig, --floor and --output are for a session, but this is a file",
                next_step="leave them out, or name the session's folder",
                path=session,
            )
        return read_result(session)
    loaded = pipeline.load(session)
    known = None if rig is None else read_rig(rig)
    with progress_bar() as progress:
        measurement = pipeline.measure(
            loaded,
            rig=known,
            floor=None if floor is None else read_floor(floor),
            progress=progress,
        )
        if output is not None:
            command = shlex.join(["pivometer", "check", str(session), "--limit", str(limit)])
            decided = pipeline.with_decision(measurement, limit, guard_mm=guard)
            pipeline.write_measurement(decided, loaded, output, command=command, progress=progress)
    return measurement
