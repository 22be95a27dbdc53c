"""Whether results differ: robots, before and after service, methods."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration import Calibration
from pivometer.errors import DegenerateGeometryError, UsageError
from pivometer.io.atomic import write_files
from pivometer.io.codec import jsonable
from pivometer.io.result import read_result, text_of
from pivometer.measurement import Measurement
from pivometer.report.comparison import Comparison, Pair, render_comparison
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.uncertainty.comparison import (
    LocationDifference,
    Ratio,
    location_difference,
    ratio_of_intervals,
    rms_ratio,
    shared_calibration_mm2,
)
from pivometer.uncertainty.coverage import COVERAGE
from pivometer.uncertainty.propagation import LocationUncertainty

SCHEMA = "pivometer/comparison/1"


def compare(results: Mapping[str, Measurement]) -> Comparison:
    """Compare results with the first of them.

    Parameters
    ----------
    results
        Two or more, by the name to call them.

    Raises
    ------
    UsageError
        If there are fewer than two.
    """
    if len(results) < 2:
        raise UsageError("one result has nothing to be compared with", next_step="name two or more")
    (first, baseline), *others = results.items()
    coverage = 1 - (1 - COVERAGE) / len(others)  # Bonferroni: all statements hold with 95 %
    pairs = (_pair(first, baseline, name, one, coverage) for name, one in others)
    return Comparison(tuple(results), tuple(results.values()), tuple(pairs), coverage)


def results_at(paths: Sequence[Path | str]) -> dict[str, Measurement]:
    """Read results by the shortest part of their paths that tells them apart.

    Parameters
    ----------
    paths
        A ``result.json``, or a session folder that holds ``results/result.json``, each.

    Raises
    ------
    UsageError
        If one is not there, is no result, or is named twice.
    """
    files = [_file(Path(path)) for path in paths]
    twice = [str(file) for file in files if files.count(file) > 1]
    if twice:
        raise UsageError(f"{twice[0]} is named twice", next_step="name different results")
    read = [read_result(file) for file in files]
    names = [result.setup.session for result in read]
    if len({*names}) < len(names):
        names = [str(path) for path in paths]
    return dict(zip(names, read, strict=True))


def _file(path: Path) -> Path:
    if not path.is_dir():
        return path
    inside = [path / "results" / "result.json", path / "result.json"]
    found = next((file for file in inside if file.is_file()), None)
    if found is None:
        raise UsageError(
            "holds no result", next_step=f"run pivometer measure {path} first", path=path
        )
    return found


def write_comparison(compared: Comparison, folder: Path | str) -> dict[str, Path]:
    """Write ``comparison.html`` and ``comparison.json`` into a folder: both, or none."""
    content = {
        "schema": SCHEMA,
        "results": compared.names,
        "coverage": compared.coverage,
        "pairs": jsonable(compared.pairs),
    }
    return write_files(
        folder,
        {"comparison.html": render_comparison(compared), "comparison.json": text_of(content)},
    )


# --- Two results ---


def _pair(
    first: str, baseline: Measurement, second: str, other: Measurement, coverage: float
) -> Pair:
    if _same_pictures(baseline, other):
        return _methods(first, baseline, second, other)
    rms = _rms(baseline, other, coverage)
    own = _own(baseline, other)
    location, where, assumed = _location(baseline, other, coverage)
    assumptions = (
        (
            "the poses of both are samples of the same movements, and each result is of "
            "independent pictures"
        ),
        *assumed,
    )
    statements = (
        _rms_text(first, second, rms),
        *([] if own is None else [_own_text(first, second, own)]),
        where,
        _max_text(baseline, other),
        *_doubts(first, baseline),
        *_doubts(second, other),
    )
    differ = rms.differs or (location is not None and location.differs)
    return Pair(first, second, statements, assumptions, rms, own, location, differ)


def _same_pictures(one: Measurement, other: Measurement) -> bool:
    """Tell whether the shaft's pictures are the same files: then noise is the same, too."""
    shafts = [
        {digest for name, digest in m.inputs.items() if name.startswith("shaft/")}
        for m in (one, other)
    ]
    return bool(shafts[0] & shafts[1])


def _methods(first: str, one: Measurement, second: str, other: Measurement) -> Pair:
    """Compare two ways of measuring the same pictures: chance is the same in both."""
    both = {pose.pose: pose.distance_mm.least_squares for pose in one.used}
    apart = [
        pose.distance_mm.least_squares - both[pose.pose] for pose in other.used if pose.pose in both
    ]
    rms = [m.rcm.least_squares.rms_mm for m in (one, other)]
    size = float(np.sqrt(np.mean(np.square(apart)))) if apart else 0.0
    decimals = error_decimals([*rms, size])
    statements = [
        (
            "Both were measured from the same pictures, so chance is the same in both, and no test "
            "of chance applies: what differs, differs by the way of measuring."
        ),
        (
            f"The rms miss is {fixed(rms[0], decimals)} mm in {first} and "
            f"{fixed(rms[1], decimals)} mm in {second}; over {len(apart)} "
            f"common poses the misses differ by {fixed(size, decimals)} mm rms."
        ),
    ]
    if one.reference_camera == other.reference_camera:
        shift = other.rcm.least_squares.point_mm - one.rcm.least_squares.point_mm
        length = float(np.linalg.norm(shift))
        largest = float(np.linalg.norm(one.uncertainty.expanded_mm))
        statements.append(
            f"The locations are {fixed(length, decimals)} mm apart; the expanded uncertainty of "
            f"{first} is {fixed(largest, decimals)} mm (root of the sum of squares)."
        )
    return Pair(first, second, tuple(statements), (), None, None, None, differ=False)


# --- How large the misses are ---


def _rms(one: Measurement, other: Measurement, coverage: float) -> Ratio:
    independent = tuple(float(m.uncertainty.independent_poses or len(m.used)) for m in (one, other))
    return rms_ratio(
        one.rcm.least_squares.distances_mm,
        other.rcm.least_squares.distances_mm,
        independent=(independent[0], independent[1]),
        coverage=coverage,
    )


def _rms_text(first: str, second: str, ratio: Ratio) -> str:
    text = (
        f"The rms miss of {second} is {ratio.value:.3g} times that of {first} "
        f"({_percent(ratio.coverage)} interval {ratio.interval[0]:.3g} to "
        f"{ratio.interval[1]:.3g}), as samples of the robots’ poses"
    )
    if not ratio.differs:
        return f"{text}: no difference is shown."
    return f"{text}: {second} is {'worse' if ratio.value > 1 else 'better'}."


def _own(one: Measurement, other: Measurement) -> Ratio | None:
    """Return the ratio of the robots' own errors over the poses that were measured."""
    if one.intrinsic is None or other.intrinsic is None:
        return None
    return ratio_of_intervals(
        (one.intrinsic.rms_mm, one.intrinsic.rms_interval_mm),
        (other.intrinsic.rms_mm, other.intrinsic.rms_interval_mm),
        coverage=COVERAGE,
    )


def _own_text(first: str, second: str, ratio: Ratio) -> str:
    return (
        f"Apart from the instrument’s noise, and over the poses measured only, the robot’s own rms "
        f"of {second} is {ratio.value:.3g} times that of {first} ({_percent(ratio.coverage)} "
        f"interval {ratio.interval[0]:.3g} to {ratio.interval[1]:.3g})."
    )


def _max_text(one: Measurement, other: Measurement) -> str:
    counts = len(one.used), len(other.used)
    sizes = [m.rcm.minimax.max_mm for m in (one, other)]
    decimals = error_decimals(sizes)
    text = " and ".join(
        f"{fixed(size, decimals)} mm of {count} poses"
        for size, count in zip(sizes, counts, strict=True)
    )
    if counts[0] != counts[1]:
        return (
            f"The largest misses, {text}, are not compared: the largest of more poses is larger by "
            "chance alone."
        )
    return (
        f"The largest misses are {text}. One pose decides each, so chance moves them more than the "
        "rms: rest no conclusion on them alone."
    )


def _doubts(name: str, result: Measurement) -> list[str]:
    refusals = [one.text for one in result.findings if one.severity == "refusal"]
    return [f"{name} was refused when it was measured: {'; '.join(refusals)}."] if refusals else []


# --- Where it is ---

_Location = tuple[LocationDifference | None, str, tuple[str, ...]]


def _location(one: Measurement, other: Measurement, coverage: float) -> _Location:
    """Compare the locations where they are in one frame, and say so where they are not."""
    try:
        if _same_board(one, other):
            return _in_board_frame(one, other, coverage)
        if _same_rig(one, other) and isinstance(one.calibration, Calibration):
            return _in_camera_frame(one, other, one.calibration, coverage)
    except DegenerateGeometryError as error:
        return None, f"The locations are not compared: {error.what}.", ()
    return (
        None,
        (
            "The locations are not compared: they are in different frames. Put a board beside the "
            "RCM and leave it there (reference/), or measure both with one calibration (--rig) "
            "without touching the cameras."
        ),
        (),
    )


def _same_board(one: Measurement, other: Measurement) -> bool:
    boards = [m.setup.board for m in (one, other)]
    alike = [(b.kind, b.squares, b.square_mm, b.dictionary, b.marker_mm) for b in boards]
    return bool(one.board_frame and other.board_frame) and alike[0] == alike[1]


def _in_board_frame(one: Measurement, other: Measurement, coverage: float) -> _Location:
    first, second = one.board_frame, other.board_frame
    if first is None or second is None:  # asked before; for the type
        return None, "", ()
    found = location_difference(
        second.least_squares_point_mm - first.least_squares_point_mm,
        first.uncertainty.total_mm2 + second.uncertainty.total_mm2,
        degrees_of_freedom=min(
            first.uncertainty.degrees_of_freedom, second.uncertainty.degrees_of_freedom
        ),
        coverage=coverage,
    )
    assumed = (
        "the reference board stood in the same place beside the robot both times",
        (
            "the two calibrations are independent; if one served both, the stated uncertainty of "
            "the difference is too large rather than too small"
        ),
    )
    return found, _location_text(found, "the reference board’s frame"), assumed


def _same_rig(one: Measurement, other: Measurement) -> bool:
    first, second = (jsonable(m.calibration.rig) for m in (one, other))
    return bool(first == second)


def _in_camera_frame(
    one: Measurement, other: Measurement, calibration: Calibration, coverage: float
) -> _Location:
    shared = shared_calibration_mm2(
        [pose.edges for pose in one.used],
        [pose.edges for pose in other.used],
        calibration.rig,
        calibration.covariance,
    )
    found = location_difference(
        other.rcm.least_squares.point_mm - one.rcm.least_squares.point_mm,
        _without_calibration(one) + _without_calibration(other) + shared,
        degrees_of_freedom=min(
            one.uncertainty.degrees_of_freedom, other.uncertainty.degrees_of_freedom
        ),
        coverage=coverage,
    )
    assumed = (
        (
            "neither cameras nor the robot’s base were moved between the two; what one calibration "
            "is off moves both locations alike, and only the rest of it counts"
        ),
    )
    return found, _location_text(found, f"the frame of camera “{one.reference_camera}”"), assumed


def _without_calibration(m: Measurement) -> Floats:
    """Return what of a location's covariance each session has for itself: scatter, and light."""
    if isinstance(m.uncertainty, LocationUncertainty):
        return m.uncertainty.total_mm2 - m.uncertainty.calibration_mm2
    return m.uncertainty.lines_mm2


def _location_text(found: LocationDifference, frame: str) -> str:
    vector = ", ".join(
        with_uncertainty(float(x), float(u))
        for x, u in zip(found.vector_mm, found.expanded_mm, strict=True)
    )
    length = float(np.linalg.norm(found.vector_mm))
    text = (
        f"In {frame} the RCM has moved by ({vector}) mm, {fixed(length, 3)} mm in all: "
        f"{found.mahalanobis:.1f} standard uncertainties, by chance under {found.limit:.1f}"
    )
    return f"{text}: {'it lies elsewhere' if found.differs else 'no difference is shown'}."


def _percent(coverage: float) -> str:
    return f"{100 * coverage:.3g} %"
