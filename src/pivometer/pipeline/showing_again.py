"""Whether a report shows the session's own pictures, and the truth that its simulation states."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np

from pivometer.errors import PivometerError
from pivometer.io.images import decode_image
from pivometer.io.session import load
from pivometer.measurement import Measurement
from pivometer.pipeline.examining import Examined, named
from pivometer.pipeline.picturing import shaft_pictures
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.reporting import Report
from pivometer.pipeline.simulating import true_rcm
from pivometer.report.embedding import Key
from pivometer.report.thumbnails import Thumbnail
from pivometer.shaft.across import EdgeProfiles

LARGEST_GREY = 16
"""Grey levels by which a picture may differ: other JPEG libraries round differently."""

PROFILE_STEP = 0.0101
"""Grey levels by which a profile may differ: it is rounded to a hundredth."""


def shown_again(
    report: Report, measurement: Measurement, folder: Path, progress: Progress | None
) -> Iterator[Examined]:
    """Draw the pictures anew from the session's images and compare."""
    thumbnails, profiles = shaft_pictures(measurement, load(folder), progress)
    record = report.record
    changed = _changed_pictures(record.thumbnails(report.pictures), thumbnails)
    changed += _changed_profiles(record.profiles_by_pose(), profiles)
    name = "the pictures against the session"
    if changed:
        yield Examined(name, "changed", f"not those of the session: {named(changed)}")
    else:
        text = f"{len(thumbnails)} pictures and {len(profiles)} profiles are the session’s"
        yield Examined(name, "holds", text)
    if record.truth is not None:
        yield _truth(report, measurement, folder)


def _changed_pictures(shown: Mapping[Key, Thumbnail], anew: Mapping[Key, Thumbnail]) -> list[str]:
    keys = sorted(shown.keys() | anew.keys())
    return [
        f"{camera}/{pose}"
        for pose, camera in keys
        if not _alike(shown.get((pose, camera)), anew.get((pose, camera)))
    ]


def _alike(one: Thumbnail | None, other: Thumbnail | None) -> bool:
    if one is None or other is None:
        return False
    if one.jpeg == other.jpeg:
        return True
    try:
        seen = [decode_image(each.jpeg, Path("a picture")).astype(int) for each in (one, other)]
    except PivometerError:
        return False
    same_size = seen[0].shape == seen[1].shape
    return same_size and int(np.abs(seen[0] - seen[1]).max()) <= LARGEST_GREY


def _changed_profiles(
    shown: Mapping[Key, EdgeProfiles], anew: Mapping[Key, EdgeProfiles]
) -> list[str]:
    keys = sorted(shown.keys() | anew.keys())
    return [
        f"grey levels of {camera}/{pose}"
        for pose, camera in keys
        if not _same_profiles(shown.get((pose, camera)), anew.get((pose, camera)))
    ]


def _same_profiles(one: EdgeProfiles | None, other: EdgeProfiles | None) -> bool:
    if one is None or other is None:
        return False
    pairs = [(getattr(one, name), getattr(other, name)) for name in ("grey", "fitted")]
    return all(a.shape == b.shape and np.abs(a - b).max() <= PROFILE_STEP for a, b in pairs)


def _truth(report: Report, measurement: Measurement, folder: Path) -> Examined:
    """Compare the stated truth with that of the session's simulation."""
    name, stated = "the simulated truth", report.record.truth
    if stated is None or not (folder / "truth.json").is_file():
        return Examined(name, "not checked", "the session has no truth.json")
    truth = true_rcm(folder, poses=[pose.pose for pose in measurement.used]).least_squares
    stated_values = [*stated.point_mm, stated.max_mm, stated.rms_mm]
    if np.allclose(stated_values, [*truth.point_mm, truth.max_mm, truth.rms_mm], rtol=1e-6):
        return Examined(name, "holds", "as truth.json states it")
    return Examined(name, "changed", "not what truth.json states")
