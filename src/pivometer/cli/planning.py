"""``pivometer plan``: what a measurement will be good for."""

from pathlib import Path
from typing import Annotated, TypeVar

from cyclopts import Parameter
from cyclopts.validators import Number

from pivometer.errors import UsageError

ImageSize = Annotated[tuple[int, int] | None, Parameter(negative="")]
_Value = TypeVar("_Value")


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
