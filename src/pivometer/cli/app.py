"""The commands. What they need is imported when they run, so that ``--help`` is quick."""

import os
import re
import shlex
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal, TypeVar

from cyclopts import App, CycloptsError, Parameter
from cyclopts.validators import Number

from pivometer._version import __version__
from pivometer.cli.faults import tell_fault, tell_internal, tell_interrupted, tell_usage
from pivometer.errors import PivometerError, UsageError

if TYPE_CHECKING:
    from pivometer._arrays import Floats
    from pivometer.measurement import Measurement

Method = Literal["joint", "paper"]
Centerline = Literal["paper", "cylinder"]
Format = Literal["opencv", "ros", "kalibr", "matlab", "colmap", "mrcal"]
Distortion = Literal["none", "radial2", "brown5", "rational8"]
Kind = Literal["checkerboard", "charuco"]
Paper = Literal["A4", "A3", "Letter"]

UnitMm = Annotated[float | None, Parameter(validator=Number(gt=0))]
FileUnitMm = Annotated[float, Parameter(validator=Number(gt=0, lt=float("inf")))]
ImageSize = Annotated[tuple[int, int] | None, Parameter(negative="")]
Draws = Annotated[int | None, Parameter(validator=Number(gte=100))]
Hints = Annotated[list[str] | None, Parameter(negative="")]

_Value = TypeVar("_Value")

app = App(
    name="pivometer",
    help="Measure the remote center of motion (RCM) of a surgical robot with two cameras or more.",
    help_epilogue="Exit codes: 0 done, 2 wrong usage or configuration, 3 data unfit for an answer.",
    help_format="plaintext",
    version=f"pivometer {__version__}",
    suppress_keyboard_interrupt=False,
    print_error=False,
    exit_on_error=False,
    help_on_error=False,
    result_action="return_value",
)


def run(arguments: Sequence[str]) -> int:
    """Run one command; whatever goes wrong becomes a message and an exit code."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # we say ourselves what is wrong
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without "±" gets a stand-in, not a crash
            stream.reconfigure(errors="backslashreplace")
    code: object = 0
    try:
        code = app(_with_counts_apart(arguments))
    except PivometerError as error:
        return tell_fault(error)
    except CycloptsError as error:
        return tell_usage(error)
    except KeyboardInterrupt:
        return tell_interrupted()
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:  # the last resort: a message, never a traceback
        if os.environ.get("PIVOMETER_DEBUG"):
            raise
        return tell_internal(error)
    return code if isinstance(code, int) else 0


def _with_counts_apart(arguments: Sequence[str]) -> list[str]:
    """Take 9x7 after --squares for 9 7: both are typed.

    Examples
    --------
    >>> _with_counts_apart(["target", "--squares", "9x7"])
    ['target', '--squares', '9', '7']
    """
    words: list[str] = []
    for word in arguments:
        counts = re.fullmatch(r"(--squares=)?(\d+)[xX×](\d+)", word)
        if counts and (counts[1] or words[-1:] == ["--squares"]):
            words += [*(["--squares"] if counts[1] else []), counts[2], counts[3]]
        else:
            words.append(word)
    return words


@app.command(
    help_prologue="""\
Example:  pivometer demo
          renders pictures of a simulated robot, measures them,
          and says how far the answer is from the truth.
"""
)
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


@app.command(
    help_prologue="""\
Example:  pivometer simulate davinci my-session --poses 30 --seed 1
          pivometer measure my-session
"""
)
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


@app.command(
    help_prologue="""\
Example:  pivometer calibrate my-session
          writes my-session/results/rig.json and prints how good the calibration is.
"""
)
def calibrate(
    session: Annotated[Path, Parameter(name="SESSION")],
    /,
    *,
    method: Method = "joint",
    distortion: Distortion = "radial2",
) -> None:
    """Calibrate the cameras of a session from its board views.

    Parameters
    ----------
    session
        Folder with session.toml and board/<camera>/<view>.png.
    method
        joint: all cameras and views adjusted together; paper: the paper's two steps.
    distortion
        Lens model: radial2 has the paper's two coefficients, brown5 five, rational8 eight. A note
        says so where boards left out of the calibration justify more.
    """
    from pivometer import pipeline
    from pivometer.cli.progress import progress_bar
    from pivometer.cli.show import show_calibration

    loaded = pipeline.load(session)
    with progress_bar() as progress:
        calibration = pipeline.calibrate(
            loaded, method=method, distortion=distortion, progress=progress
        )
    path = pipeline.write_calibration(calibration, session / "results")
    show_calibration(calibration, path, ignored=loaded.ignored)


@app.command(
    help_prologue="""\
Example:  pivometer measure my-session
          pivometer measure other-session --rig my-session/results/rig.json
          pivometer measure bearing --gold-standard --bearing-rms-mm 0.002
          pivometer measure my-session --floor bearing/results/result.json
"""
)
def measure(
    session: Annotated[Path, Parameter(name="SESSION")],
    /,
    *,
    output: Path | None = None,
    figures: Path | None = None,
    rig: Path | None = None,
    limit: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    method: Method | None = None,
    distortion: Distortion | None = None,
    centerline: Centerline | None = None,
    unit_mm: UnitMm = None,
    image_size: ImageSize = None,
    hint: Hints = None,
    floor: Path | None = None,
    gold_standard: Annotated[bool, Parameter(negative="")] = False,
    bearing_rms_mm: Annotated[float | None, Parameter(validator=Number(gte=0))] = None,
    monte_carlo: Draws = None,
) -> None:
    """Measure the RCM of a session and write the report.

    Writes result.json, centerlines.csv, rig.json and report.html; report.pdf, too, where the
    extra pdf is installed.

    Parameters
    ----------
    session
        Folder with session.toml, board/ and shaft/<camera>/<pose>.png.
    output
        Folder for the results; SESSION/results where none is given.
    figures
        Folder for figures (SVG, PNG) and tables (CSV), too; see pivometer figures.
    rig
        The rig.json of an earlier calibration, or a calibration of another program: OpenCV, ROS,
        Kalibr, MATLAB, COLMAP or mrcal, a file or the folder with its files. Such a rig has no
        uncertainty, and the result says so. Calibrates first where none is given.
    limit
        Limit of the largest miss, mm: the report then says whether the robot keeps it, as
        pivometer check decides.
    method
        How to calibrate: joint, which is used where none is given, or paper.
    distortion
        Lens model to calibrate: see pivometer calibrate; radial2 where none is given.
    centerline
        paper: where the planes midway between the edges meet, which is used where none is given; or
        cylinder: the axis of the cylinder that fits the edges of all cameras best.
    unit_mm
        Length of the unit of the --rig file, mm, where it states none.
    image_size
        Width and height of the images, px, where the --rig file states none.
    hint
        Where a camera's shaft is, if it is not found by itself: CAMERA=X,Y or CAMERA=X,Y,WIDTH,
        the pixel about which it turns and its width there. Once for each camera that needs it.
    floor
        The result.json of a gold standard measured with the same cameras: what the instrument
        showed there beyond its stated noise counts as noise here.
    gold_standard
        The session shows a spherical bearing or another joint that turns about one point: the
        result then states the instrument's own floor, for --floor.
    bearing_rms_mm
        What that joint misses by itself, rms, mm; taken for perfect where none is given.
    monte_carlo
        Number of draws of a Monte Carlo through the whole chain, beside the linear propagation:
        10000 take a minute. None where none is given.
    """
    from pivometer import pipeline
    from pivometer.cli.hints import shaft_hints
    from pivometer.cli.progress import progress_bar
    from pivometer.cli.show import show_measurement
    from pivometer.io.formats import read_any_rig
    from pivometer.io.result import read_floor

    if rig is not None and (method or distortion) is not None:
        raise UsageError(
            f"--{'distortion' if method is None else 'method'} says how to calibrate, but --rig "
            "gives a calibration",
            next_step="leave out one of them",
        )
    if rig is None and (unit_mm is not None or image_size is not None):
        raise UsageError(
            "--unit-mm and --image-size describe a --rig, and none is given",
            next_step="add --rig, or leave them out",
        )
    if bearing_rms_mm is not None and not gold_standard:
        raise UsageError(
            "--bearing-rms-mm describes a gold standard", next_step="add --gold-standard"
        )
    hints = shaft_hints(hint or [])
    loaded = pipeline.load(session)
    known = None if rig is None else read_any_rig(rig, unit_mm=unit_mm, image_size=image_size)
    folder = session / "results" if output is None else output
    if folder.exists() and not folder.is_dir():
        raise UsageError("is a file", next_step="name a folder for the results", path=folder)
    options: dict[str, object] = {
        "--output": output,
        "--figures": figures,
        "--rig": rig,
        "--limit": limit,
        "--method": method,
        "--distortion": distortion,
        "--centerline": centerline,
        "--unit-mm": unit_mm,
        "--floor": floor,
        "--bearing-rms-mm": bearing_rms_mm,
        "--monte-carlo": monte_carlo,
    }
    given = [str(word) for option in options.items() if option[1] is not None for word in option]
    given += [] if image_size is None else ["--image-size", *map(str, image_size)]
    given += [word for text in hint or [] for word in ("--hint", text)]
    given += ["--gold-standard"] if gold_standard else []
    command = shlex.join(["pivometer", "measure", str(session), *given])
    with progress_bar() as progress:
        measurement = pipeline.measure(
            loaded,
            rig=known,
            method=method or "joint",
            distortion=distortion or "radial2",
            hints=hints,
            centerline=centerline or "paper",
            floor=None if floor is None else read_floor(floor),
            bearing_rms_mm=(bearing_rms_mm or 0.0) if gold_standard else None,
            draws=monte_carlo or 0,
            progress=progress,
        )
        if limit is not None:
            measurement = pipeline.with_decision(measurement, limit)
        files = pipeline.write_measurement(
            measurement, loaded, folder, command=command, progress=progress
        )
        if figures is not None:
            pipeline.write_tables(measurement, figures)
            pipeline.write_figures(measurement, figures)
            files["figures"] = figures
    show_measurement(measurement, files, ignored=loaded.ignored)


@app.command(
    help_prologue="""\
Example:  pivometer export my-session/results/rig.json --to kalibr camchain.yaml
          pivometer export intrinsics-and-extrinsics/ --to ros camera_info/ --unit-mm 1
"""
)
def export(
    rig: Annotated[Path, Parameter(name="RIG")],
    path: Annotated[Path, Parameter(name="PATH")],
    /,
    *,
    to: Format,
    unit_mm: UnitMm = None,
    image_size: ImageSize = None,
) -> None:
    """Write a calibrated rig in the format of another program.

    Parameters
    ----------
    rig
        A rig.json or result.json, or a calibration of another program.
    path
        File to write; for ros, colmap and mrcal the folder.
    to
        The format. What it cannot carry is refused, not dropped; no format carries the covariance.
    unit_mm
        Length of the unit of RIG, mm, where it states none.
    image_size
        Width and height of the images, px, where RIG states none.
    """
    from pivometer.cli.show import say
    from pivometer.io.formats import read_any_rig, write_rig

    known = read_any_rig(rig, unit_mm=unit_mm, image_size=image_size)
    say(*map(str, write_rig(known.rig, to, path)))


@app.command(
    help_prologue="""\
Example:  pivometer target board.pdf --squares 9 7 --square-mm 15
          a page to print at 100 %, with a line that tells whether it was,
          and the lines for session.toml.
"""
)
def target(
    file: Annotated[Path, Parameter(name="FILE")] = Path("target.pdf"),
    /,
    *,
    kind: Kind = "checkerboard",
    squares: Annotated[tuple[int, int], Parameter(negative="")] = (9, 7),
    square_mm: float = 15.0,
    paper: Paper = "A4",
    dictionary: str | None = None,
    marker_mm: float | None = None,
) -> None:
    """Draw a calibration board to print, as PDF or SVG.

    Parameters
    ----------
    file
        File to write; a name that ends in .pdf or .svg says which.
    kind
        checkerboard, or charuco: with markers, so that a part of it will do.
    squares
        Squares across and down, 9 7 or 9x7, counting the outer ones.
    square_mm
        Side of a square, mm.
    paper
        Paper to print on; which way it lies follows from the board.
    dictionary
        ArUco dictionary of a charuco board; DICT_4X4_50 where none is given.
    marker_mm
        Side of a charuco board's markers, mm; 11/15 of a square where none is given.
    """
    from pivometer import pipeline
    from pivometer.calibration import Board
    from pivometer.cli.show import show_target

    if kind == "charuco":
        dictionary = dictionary or "DICT_4X4_50"
        marker_mm = round(square_mm * 11 / 15, 1) if marker_mm is None else marker_mm
    elif dictionary is not None or marker_mm is not None:
        raise UsageError(
            "a checkerboard has no markers, but --dictionary or --marker-mm is given",
            next_step="add --kind charuco, or leave them out",
        )
    try:
        board = Board(kind, squares, square_mm, None, dictionary, marker_mm)
    except UsageError as error:
        raise UsageError(error.what, next_step="see pivometer target --help") from error
    show_target(board, pipeline.write_target(board, file, paper=paper))


@app.command(
    help_prologue="""\
Example:  pivometer solve my-session/results/centerlines.csv
          the RCM of lines from anywhere: no camera, no pictures.
"""
)
def solve(
    lines: Annotated[Path, Parameter(name="LINES.csv")],
    /,
    *,
    unit_mm: FileUnitMm = 1.0,
    output: Path | None = None,
) -> None:
    """Solve for the RCM of lines from a CSV file.

    Parameters
    ----------
    lines
        Columns point_x_mm, point_y_mm, point_z_mm, direction_x, direction_y, direction_z, and pose
        if you like; without a heading the six in this order. With cov_xx_mm2, cov_xy_mm2,
        cov_xz_mm2, cov_yy_mm2, cov_yz_mm2 and cov_zz_mm2 the lines are weighted, too.
    unit_mm
        Length of the file's unit, mm: 1000 for metres.
    output
        Folder to write rcm.json into; nothing is written where none is given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import show_solution

    solved = pipeline.solve_lines(lines, unit_mm=unit_mm)
    path = None if output is None else pipeline.write_solution(solved, output)
    show_solution(solved, path)


@app.command(
    help_prologue="""\
Example:  pivometer pivot poses.csv
          where a tracked instrument pivots, and where its tip is.
          pivometer pivot poses.csv --axis 0,0,1
          the RCM of the instrument's axis, which may slide through it.
"""
)
def pivot(
    poses: Annotated[Path, Parameter(name="POSES.csv")],
    /,
    *,
    axis: str | None = None,
    axis_point: str | None = None,
    unit_mm: FileUnitMm = 1.0,
    output: Path | None = None,
) -> None:
    """Find the pivot of a tracked instrument: of its tip, or of its axis.

    Parameters
    ----------
    poses
        One 4×4 matrix a row, in mm and in the order of time: 16 numbers, or columns t00 to t23.
    axis
        Direction of the instrument's axis in its own frame, x,y,z; or estimate, which finds it from
        how the instrument slides along it. Without it, its tip is taken for what stays in place.
    axis_point
        A point on that axis, x,y,z in mm; the instrument's origin where none is given.
    unit_mm
        Length of the file's unit, mm: 1000 for metres.
    output
        Folder to write pivot.json into, or rcm.json with --axis; nothing is written where none is
        given.
    """
    from pivometer import pipeline
    from pivometer.cli.show import show_pivot, show_solution
    from pivometer.rcm import InstrumentAxis

    if axis_point is not None and axis in (None, "estimate"):
        raise UsageError(
            "--axis-point is a point on a known axis, but --axis states none",
            next_step="give --axis x,y,z, or leave it out",
        )
    if axis is None:
        pivoted = pipeline.solve_poses(poses, unit_mm=unit_mm)
        show_pivot(pivoted, None if output is None else pipeline.write_pivot(pivoted, output))
        return
    known = None
    if axis != "estimate":
        through = _three(axis_point or "0,0,0", "--axis-point")
        known = InstrumentAxis(through, _three(axis, "--axis"))
    solved = pipeline.solve_axis(poses, known, unit_mm=unit_mm)
    show_solution(solved, None if output is None else pipeline.write_solution(solved, output))


def _three(text: str, option: str) -> "Floats":
    """Return three numbers that are not all zero unless they are a point."""
    import numpy as np

    from pivometer.io.rows import finite_or_nan

    numbers = [finite_or_nan(word) for word in text.split(",")]
    if (
        len(numbers) != 3
        or any(x != x for x in numbers)
        or (option == "--axis" and not any(numbers))
    ):
        raise UsageError(
            f"{option} is {text!r}, not three numbers x,y,z",
            next_step="write for example --axis 0,0,1",
        )
    return np.array(numbers)


@app.command(
    help_prologue="""\
Example:  pivometer check my-session --limit 0.5
          pivometer check results/result.json --limit 0.5 --junit check.xml
Exit codes: 0 pass, 1 over the limit, 2 wrong usage or configuration, 3 data
          unfit for an answer, 4 a condition of validity is not met,
          5 inconclusive: the limit lies inside the uncertainty.
"""
)
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


@app.command(
    help_prologue="""\
Example:  pivometer plan --rig my-session/results/rig.json --wanted-mm 0.3
          pivometer plan --focal-px 1000 --image-size 640 480 \\
                         --distance-mm 480 --baseline-mm 525 --square-mm 15
"""
)
def plan(
    *,
    rig: Path | None = None,
    focal_px: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    image_size: ImageSize = None,
    distance_mm: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    baseline_mm: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
    convergence_deg: Annotated[float | None, Parameter(validator=Number(gt=0, lt=180))] = None,
    squares: Annotated[tuple[int, int], Parameter(negative="")] = (9, 7),
    square_mm: Annotated[float, Parameter(validator=Number(gt=0))] = 15.0,
    board_views: Annotated[int, Parameter(validator=Number(gte=6))] = 30,
    corner_px: Annotated[float, Parameter(validator=Number(gt=0))] = 0.1,
    diameter_mm: Annotated[float, Parameter(validator=Number(gt=0))] = 8.0,
    visible_mm: Annotated[tuple[float, float] | None, Parameter(negative="")] = None,
    edge_px: Annotated[float, Parameter(validator=Number(gt=0))] = 0.1,
    cone_deg: Annotated[float, Parameter(validator=Number(gt=0, lt=180))] = 57.0,
    poses: Annotated[int, Parameter(validator=Number(gte=3, lte=500))] = 70,
    robot_rms_mm: Annotated[float, Parameter(validator=Number(gte=0))] = 0.0,
    wanted_mm: Annotated[float | None, Parameter(validator=Number(gt=0))] = None,
) -> None:
    """Say what a measurement will be good for, before it is made.

    Parameters
    ----------
    rig
        The rig.json of a calibration; else the rig and its calibration are simulated.
    focal_px, image_size
        Focal length, px, and width and height of the images, px, of two equal cameras.
    distance_mm, baseline_mm, convergence_deg
        From each camera to the shaft, between the cameras, and the angle between their optical
        axes: two of the three. With --rig the distance alone, if it is not where the axes meet.
    squares, square_mm, board_views, corner_px
        The board, the number of its views, and the standard deviation of a corner's coordinate.
    diameter_mm, visible_mm
        The shaft, and where the visible part starts and ends, from the RCM; it starts at 20 mm and
        fills 60 % of the images' height where that is not given.
    edge_px
        Standard deviation of the shaft's edge in one row of an image, px.
    cone_deg, poses
        Apex angle of the cone of poses, and their number.
    robot_rms_mm
        The robot's own rms miss: its scatter makes the location less certain.
    wanted_mm
        Wanted expanded uncertainty of each coordinate: the smallest number of poses is looked for.
    """
    from pivometer import pipeline
    from pivometer.calibration import Board
    from pivometer.cli.show import show_plan
    from pivometer.io.result import read_rig
    from pivometer.uncertainty.foresight import Shaft

    if rig is not None:
        calibration = read_rig(rig)
    else:
        cameras = pipeline.two_cameras(
            focal_px=_needed(focal_px, "--focal-px"),
            image_size=_needed(image_size, "--image-size"),
            distance_mm=distance_mm,
            baseline_mm=baseline_mm,
            convergence_deg=convergence_deg,
        )
        distance_mm = None
        board = Board("checkerboard", squares, square_mm)
        calibration = pipeline.foreseen_calibration(
            cameras, board, board_views=board_views, corner_px=corner_px
        )
    span = visible_mm or (20.0, 20.0 + pipeline.seen_length_mm(calibration.rig))
    planned = pipeline.plan(
        calibration,
        Shaft(diameter_mm, span),
        edge_px=edge_px,
        cone_deg=cone_deg,
        poses=poses,
        robot_rms_mm=robot_rms_mm,
        distance_mm=distance_mm,
        wanted_mm=wanted_mm,
    )
    show_plan(planned)


def _needed(value: _Value | None, option: str) -> _Value:
    """Return what an option gives, or ask for it."""
    if value is None:
        raise UsageError(
            f"{option} is missing", next_step="give --rig, or the measures of the planned cameras"
        )
    return value


@app.command(
    help_prologue="""\
Example:  pivometer schema > result.schema.json
"""
)
def schema() -> None:
    """Print the JSON Schema of result.json."""
    import json

    from pivometer.io.schema import schema as result_schema

    sys.stdout.write(json.dumps(result_schema(), indent=2, ensure_ascii=False) + "\n")


app.command(
    "pivometer.cli.figures:figures",
    help_prologue="""\
Example:  pivometer figures my-session/results/result.json figures/
""",
)

app.command(
    "pivometer.cli.verify:verify",
    help_prologue="""\
Example:  pivometer verify my-session/results/report.html
          pivometer verify report.html my-session
Exit codes: 0 everything holds, 2 wrong usage or configuration, 3 data unfit
          for an answer, 4 something was changed, 5 nothing found changed, but
          not all could be checked.
""",
)


app.command(
    "pivometer.cli.guided:guided",
    name="app",
    help_prologue="""\
Example:  pivometer app my-session
          opens the browser: set up, calibrate, take poses, read the result,
          write the report.
""",
)

app.command(
    "pivometer.cli.compare:compare",
    help_prologue="""\
Example:  pivometer compare before-service after-service
          says whether the robot has changed by more than chance explains.
""",
)

app.command(
    "pivometer.cli.history:history",
    help_prologue="""\
Example:  pivometer history all-sessions --output trend
Exit codes: 0 the newest results are in line, 1 one is out of line, 2 wrong usage
          or configuration.
""",
)
