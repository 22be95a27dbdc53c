"""Table I of the paper, simulated: the paper's figures, ours, and the truth, side by side.

    python examples/reproduce_paper.py [FOLDER]

Renders both of the paper's experiments (70 poses, 20 board pairs and 10 single views a camera),
measures them from the images alone and prints what comes out, beside the same poses' truth.
Takes a few minutes.

The pictures have noise, blur, distortion, shading and clutter, but neither a bowed board nor
cameras that move: the calibration column shows what the method can do, not what a laboratory gets.
"""

import sys
import tempfile
from pathlib import Path

import numpy as np

import pivometer
from pivometer import pipeline
from pivometer.measurement import Measurement
from pivometer.rcm import RcmSolution

PAPER = {
    "gold": {"calibration": (0.253, 0.130), "rcm": (0.391, 0.145)},
    "davinci": {"calibration": (0.441, 0.166), "rcm": (7.086, 3.010)},
}
TITLES = {"gold": "Gold standard (spherical bearing)", "davinci": "da Vinci (linkage errors)"}


def print_table(
    preset: str, calibration: pivometer.Calibration, measured: Measurement, truth: RcmSolution
) -> None:
    """Print one experiment in the form of Table I."""
    ours = measured.rcm.minimax
    edges = calibration.edge_length_error
    paper = PAPER[preset]
    print(f"\n{TITLES[preset]}: {len(measured.used)} poses used, {len(measured.rejected)} rejected")
    print(f"{'mm':24}{'paper':>9}{'ours':>9}{'truth':>9}")
    rows = [
        ("calibration, max", paper["calibration"][0], edges.max_mm, 0.0),
        ("calibration, rms", paper["calibration"][1], edges.rms_mm, 0.0),
        ("RCM error, max", paper["rcm"][0], ours.max_mm, truth.minimax.max_mm),
        ("RCM error, rms", paper["rcm"][1], ours.rms_mm, truth.minimax.rms_mm),
    ]
    for name, theirs, mine, true in rows:
        print(f"{name:24}{theirs:9.3f}{mine:9.3f}{true:9.3f}")
    points = measured.rcm, truth
    minimax = np.linalg.norm(points[0].minimax.point_mm - points[1].minimax.point_mm)
    squares = np.linalg.norm(points[0].least_squares.point_mm - points[1].least_squares.point_mm)
    u = np.sqrt(np.trace(measured.rcm.least_squares.covariance_mm2))
    print(
        f"location off by {squares:.3f} mm (least squares; stated u {u:.3f}), "
        f"{minimax:.3f} mm (minimax)"
    )
    print(f"2-norm and ∞-norm points are {measured.rcm.separation_mm:.3f} mm apart")


def main(folder: Path, poses: int = 70) -> None:
    """Simulate, measure and print both experiments."""
    for preset in PAPER:
        session = pipeline.simulate(preset, folder / preset, poses=poses)
        loaded = pivometer.load(session)
        calibration = pivometer.calibrate(loaded)
        measured = pivometer.measure(loaded, rig=calibration)
        used = [pose.pose for pose in measured.used]
        print_table(preset, calibration, measured, pipeline.true_rcm(session, poses=used))


if __name__ == "__main__":
    if len(sys.argv) > 1:
        main(Path(sys.argv[1]))
    else:
        with tempfile.TemporaryDirectory() as scratch:
            main(Path(scratch))
