"""Results over time, and what stands out."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from pivometer.errors import UsageError
from pivometer.io.atomic import write_files
from pivometer.io.codec import jsonable
from pivometer.io.history import Entry, indexed_results
from pivometer.io.result import text_of
from pivometer.report.digits import error_decimals, fixed
from pivometer.report.history import History, Point, Series, render_history
from pivometer.uncertainty.control import FEWEST, drift, running_limits

SCHEMA = "pivometer/history/1"

_QUANTITIES = {
    "rms_mm": "rms miss",
    "noise_mm": "the instrument’s noise",
    "held_out_mm": "error of held-out board edges",
    "diameter_mm": "measured diameter of the shaft",
}


def history(folder: Path | str) -> History:
    """Return all results under a folder over time, and what stands out.

    An index in the folder, ``.pivometer-history.sqlite``, saves reading the results again.

    Raises
    ------
    UsageError
        If there is no such folder, or no result in it.
    """
    entries = indexed_results(folder)
    good = [entry for entry in entries if not entry.problem]
    if not good:
        raise UsageError(
            "holds no result.json", next_step="name the folder of all sessions", path=folder
        )
    devices = dict.fromkeys(entry.device for entry in good)
    series = (
        one
        for device in devices
        for one in _series(device, [entry for entry in good if entry.device == device])
    )
    return History(
        folder=Path(folder).resolve().name,
        series=tuple(series),
        skipped=tuple((entry.path, entry.problem) for entry in entries if entry.problem),
    )


def write_history(followed: History, folder: Path | str) -> dict[str, Path]:
    """Write ``history.html`` and ``history.json`` into a folder: both, or none."""
    content = {
        "schema": SCHEMA,
        "folder": followed.folder,
        "series": jsonable(followed.series),
        "skipped": jsonable(followed.skipped),
    }
    return write_files(
        folder, {"history.html": render_history(followed), "history.json": text_of(content)}
    )


def _series(device: str, entries: list[Entry]) -> Iterator[Series]:
    for name, quantity in _QUANTITIES.items():
        known = [(entry, getattr(entry, name)) for entry in entries if getattr(entry, name)]
        if name == "held_out_mm":  # a calibration that served several sessions counts once
            values = [value for _, value in known]
            known = [one for i, one in enumerate(known) if one[1] not in values[:i]]
        if not known:
            continue
        limits = running_limits([value for _, value in known])
        points = tuple(
            Point(entry.session, entry.made[:10], entry.poses, value, limit)
            for (entry, value), limit in zip(known, limits, strict=True)
        )
        yield Series(device, quantity, points, tuple(_findings(device, quantity, points)))


def _findings(device: str, quantity: str, points: tuple[Point, ...]) -> Iterator[str]:
    robot = f"{device}: " if device else ""
    decimals = error_decimals([point.value_mm for point in points])
    for point in points:
        if point.limits is not None and not point.in_line:
            above = point.value_mm > point.limits.upper
            end = fixed(point.limits.upper if above else point.limits.lower, decimals)
            yield (
                f"{robot}{point.session} ({point.made}): {quantity} of "
                f"{fixed(point.value_mm, decimals)} mm is {'above' if above else 'below'} the "
                f"{'upper' if above else 'lower'} limit of {end} mm that the {point.limits.count} "
                "results before it set"
            )
    change = drift([point.value_mm for point in points])
    if change is not None:
        yield (
            f"{robot}{quantity} {'grows' if change > 0 else 'falls'} by about "
            f"{100 * abs(change):.2g} % from result to result, steadily over {len(points)} results"
        )
    elif len(points) <= FEWEST:
        yield (
            f"{robot}{quantity}: {len(points)} so far; limits are set from the {FEWEST + 1}th on"
        )
    elif all(point.in_line for point in points):
        yield f"{robot}{quantity}: all {len(points)} results are in line"
