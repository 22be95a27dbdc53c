"""``pivometer calibrate`` and ``pivometer measure``: from a session to its rig and its RCM."""

import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter
from cyclopts.validators import Number

from pivometer.errors import UsageError

Method = Literal["joint", "paper"]
Centerline = Literal["paper", "cylinder"]
Distortion = Literal["none", "radial2", "brown5", "rational8"]
UnitMm = Annotated[float | None, Parameter(validator=Number(gt=0))]
ImageSize = Annotated[tuple[int, int] | None, Parameter(negative="")]
Draws = Annotated[int | None, Parameter(validator=Number(gte=100))]
Hints = Annotated[list[str] | None, Parameter(negative="")]


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

    _refuse_stray_options(
        rig,
        calibrating={"--method": method, "--distortion": distortion},
        describing=(unit_mm, image_size),
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
    command = _command(session, options, image_size, hint or [], gold_standard=gold_standard)
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


def _refuse_stray_options(
    rig: Path | None, *, calibrating: Mapping[str, object], describing: Sequence[object]
) -> None:
    """Refuse to calibrate beside a rig that is given, and to describe one that is not."""
    stray = [name for name, value in calibrating.items() if value is not None]
    if rig is not None and stray:
        raise UsageError(
            f"{stray[0]} says how to calibrate, but --rig gives a calibration",
            next_step="leave out one of them",
        )
    if rig is None and any(value is not None for value in describing):
        raise UsageError(
            "--unit-mm and --image-size describe a --rig, and none is given",
            next_step="add --rig, or leave them out",
        )


def _command(
    session: Path,
    options: Mapping[str, object],
    image_size: tuple[int, int] | None,
    hints: Sequence[str],
    *,
    gold_standard: bool,
) -> str:
    """Return the command line that asks for the same again."""
    given = [str(word) for option in options.items() if option[1] is not None for word in option]
    given += [] if image_size is None else ["--image-size", *map(str, image_size)]
    given += [word for text in hints for word in ("--hint", text)]
    given += ["--gold-standard"] if gold_standard else []
    return shlex.join(["pivometer", "measure", str(session), *given])
