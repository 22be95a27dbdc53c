"""All RCM points side by side: where they are, how far the lines miss them, and what that means."""

from collections.abc import Mapping

import numpy as np

from pivometer.measurement import Measurement
from pivometer.rcm.result import RcmSolution
from pivometer.report.digits import error_decimals, fixed, uncertainty_text
from pivometer.report.tables import Table

MEANING: Mapping[str, str] = {
    "minimax": "“minimax” has the least largest miss: the RCM error; a few lines decide it",
    "weighted": "“weighted” lets lines that the instrument knows badly count less",
    "least_distance": "“least sum” has the least sum of misses and “trimmed” leaves the farthest "
    "quarter out: a few wrong lines do not move them, so far from least squares they tell of some",
}
"""What each point is for, by its name in `RcmSolution`."""

_TITLES = {"minimax": "minimax", "weighted": "weighted"} | {
    "least_distance": "least sum",
    "trimmed": "trimmed",
}


def points_table(rcm: RcmSolution, names: tuple[str, ...], *, frame: str) -> Table:
    """Tabulate all points of a solution.

    Parameters
    ----------
    rcm
        The solution.
    names
        What to call each line.
    frame
        Whose frame the points are in.
    """
    points = {"least_squares": rcm.least_squares} | {
        name: getattr(rcm, name) for name in _TITLES if getattr(rcm, name) is not None
    }
    decimals = error_decimals([rcm.minimax.max_mm, rcm.minimax.rms_mm, rcm.least_squares.rms_mm])
    rows = [
        (f"{axis}, mm", *(fixed(float(p.point_mm[i]), decimals) for p in points.values()))
        for i, axis in enumerate("xyz")
    ]
    rows += [
        (f"u of {axis}, mm", *(_uncertainty(point, i) for point in points.values()))
        for i, axis in enumerate("xyz")
    ]
    distances = [point.distances_mm for point in points.values()]
    apart = [np.linalg.norm(p.point_mm - rcm.least_squares.point_mm) for p in points.values()]
    rows += [
        ("from least squares, mm", "–", *(fixed(float(length), decimals) for length in apart[1:])),
        ("largest miss (max), mm", *(fixed(float(d.max()), decimals) for d in distances)),
        ("rms miss, mm", *(fixed(float(np.sqrt(np.mean(d**2))), decimals) for d in distances)),
        ("mean miss, mm", *(fixed(float(d.mean()), decimals) for d in distances)),
        ("farthest line", *(names[int(np.argmax(d))] for d in distances)),
    ]
    return Table(
        f"All RCM points in {frame}, u standard uncertainty",
        ("", "least squares", *(_TITLES[name] for name in points if name in _TITLES)),
        tuple(rows),
        _note(rcm),
    )


def all_points_table(measurement: Measurement) -> Table:
    """Tabulate all points of a measurement in the reference camera's frame."""
    names = tuple(pose.pose for pose in measurement.used)
    frame = f"the frame of camera “{measurement.reference_camera}”"
    return points_table(measurement.rcm, names, frame=frame)


def _uncertainty(point: object, axis: int) -> str:
    """Return the standard uncertainty of a coordinate, if the point has one."""
    covariance = getattr(point, "covariance_mm2", None)
    return "–" if covariance is None else uncertainty_text(float(np.sqrt(covariance[axis, axis])))


def _content(rcm: RcmSolution) -> str:
    """Say what the largest miss says of poses that were not measured."""
    if rcm.content is None:
        return ""
    return (
        f" With 95 % confidence at least {100 * rcm.content:.0f} % of all poses miss the minimax "
        "point by no more than its largest miss, if those measured were drawn from them at random, "
        "not from a grid or along a path."
    )


def _note(rcm: RcmSolution) -> str:
    """Say what each point is for, and which one to quote."""
    told = [text for name, text in MEANING.items() if getattr(rcm, name) is not None]
    note = (
        "Each point has the least miss of its kind. Quote the least-squares point as the location "
        f"and the minimax miss as the error; {'; '.join(told)}. No miss is weighted."
        f"{_content(rcm)}"
    )
    if rcm.weighted is None:
        return note
    shift = float(np.linalg.norm(rcm.weighted.shift_mm))
    chance = float(np.sqrt(np.trace(rcm.weighted.shift_covariance_mm2)))
    return note + (
        f" Weighting moves the point by {fixed(shift, 4)} mm, where chance explains about "
        f"{fixed(chance, 4)} mm; {fixed(100 * float(rcm.weighted.shares.max()), 1)} % of the "
        "weight is the most that one line has, "
        f"{fixed(100 / len(rcm.weighted.shares), 1)} % an equal share."
    )
