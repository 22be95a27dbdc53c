"""Sessions whose truth is known, and the demo."""

from __future__ import annotations

import json
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pivometer import simulation
from pivometer.io.atomic import replaced_folder
from pivometer.io.images import write_image
from pivometer.io.session import load
from pivometer.measurement import Measurement
from pivometer.pipeline.measuring import measure
from pivometer.pipeline.reading import Progress
from pivometer.pipeline.writing import write_measurement
from pivometer.rcm import RcmSolution, solve
from pivometer.rcm.geometry_check import FEWEST_POSES_ADVISED
from pivometer.report.embedding import SimulatedTruth
from pivometer.simulation.session import poses_csv
from pivometer.uncertainty import lies_within

DEMO = {"poses": FEWEST_POSES_ADVISED, "board_pairs": 12, "single_views": 6}
"""What the demo shows: as few poses as `check` takes, and board views for a sound calibration."""


def simulate(
    preset: str | simulation.Preset,
    folder: Path | str,
    *,
    poses: int | None = None,
    seed: int = 0,
    progress: Progress | None = None,
    **options: Any,
) -> Path:
    """Render a session whose truth is known into a folder.

    Parameters
    ----------
    preset
        ``"gold"``, ``"davinci"`` or ``"micro"``, or a preset of your own.
    folder
        Where to; an earlier simulation there is replaced, anything else is not.
    poses
        Number of poses; the preset's own where none is given.
    seed
        Seed of everything random.
    progress
        Called as ``progress(stage, done, total)``.
    **options
        Further options of `pivometer.simulation.simulate`.

    Returns
    -------
    pathlib.Path
        The session folder, with ``session.toml``, the images, ``poses.csv`` and
        ``truth.json``.
    """
    session = simulation.simulate(preset, poses=poses, seed=seed, **options)
    with replaced_folder(folder, mark="truth.json") as root:
        for done, (name, image) in enumerate(session, start=1):
            write_image(root / name, image)
            if progress is not None:
                progress("rendering", done, session.image_count)
        (root / "session.toml").write_text(session.session_toml, encoding="utf-8")
        (root / "poses.csv").write_text(poses_csv(session.motion), encoding="utf-8")
        (root / "truth.json").write_text(json.dumps(session.truth, indent=1), encoding="utf-8")
    return Path(folder)


@dataclass(frozen=True, slots=True, eq=False)
class DemoOutcome:
    """What the demo measured, and how far that is from the truth.

    Parameters
    ----------
    report
        The report.
    measurement
        The measurement.
    truth
        The RCM of the simulated robot's true centerlines, of the poses used.
    location_error_mm
        Distance of the measured least-squares point from the true one, mm.
    inside_95
        Whether the true point lies inside the stated 95 % region.
    """

    report: Path
    measurement: Measurement
    truth: RcmSolution
    location_error_mm: float
    inside_95: bool


def demo(folder: Path | str, *, progress: Progress | None = None) -> DemoOutcome:
    """Render a small session, measure it, write the report and compare with the truth.

    Parameters
    ----------
    folder
        Where the session goes; its results go into ``results`` in it.
    progress
        Called as ``progress(stage, done, total)``.
    """
    root = simulate("gold", folder, **DEMO, progress=progress)
    session = load(root)
    measured = measure(session, progress=progress)
    truth = true_rcm(root, poses=[pose.pose for pose in measured.used])
    point = truth.least_squares.point_mm
    written = write_measurement(
        measured,
        session,
        root / "results",
        command="pivometer demo",
        truth=SimulatedTruth(point, truth.least_squares.max_mm, truth.least_squares.rms_mm),
        progress=progress,
    )
    error = measured.rcm.least_squares.point_mm - point
    return DemoOutcome(
        report=written["report.html"],
        measurement=measured,
        truth=truth,
        location_error_mm=float(np.linalg.norm(error)),
        inside_95=lies_within(
            point,
            measured.rcm.least_squares.point_mm,
            measured.rcm.least_squares.covariance_mm2,
            degrees_of_freedom=measured.uncertainty.degrees_of_freedom,
        ),
    )


def true_rcm(folder: Path | str, *, poses: Collection[str] | None = None) -> RcmSolution:
    """Solve for the RCM of a simulated session's true centerlines, from its ``truth.json``.

    Parameters
    ----------
    folder
        The session folder.
    poses
        The poses that count, such as those a measurement used; all where none are given.
    """
    content = json.loads((Path(folder) / "truth.json").read_text(encoding="utf-8"))
    rows = [row for row in content["poses"] if poses is None or row["pose"] in poses]
    lines = [row["centerline"] for row in rows]
    points = np.array([line["point_mm"] for line in lines])
    return solve(points, np.array([line["direction"] for line in lines]))
