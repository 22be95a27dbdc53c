"""One function per user task: the only place where all the rooms meet."""

from pivometer.io.session import load
from pivometer.pipeline.calibrating import calibrate
from pivometer.pipeline.capturing import (
    Group,
    add_picture,
    capture,
    describe,
    exclude,
    file_of,
    picture,
    save_sources,
    saved_sources,
)
from pivometer.pipeline.checking import CheckOutcome, Condition, check, with_decision
from pivometer.pipeline.comparing import compare, results_at, write_comparison
from pivometer.pipeline.examining import Examined
from pivometer.pipeline.following import history, write_history
from pivometer.pipeline.junit import write_junit
from pivometer.pipeline.measuring import SeenShafts, measure, measure_seen, see_shafts
from pivometer.pipeline.notebook import show_in_notebooks
from pivometer.pipeline.planning import (
    Plan,
    foreseen_calibration,
    plan,
    seen_length_mm,
    two_cameras,
)
from pivometer.pipeline.simulating import DemoOutcome, demo, simulate, true_rcm
from pivometer.pipeline.solving import (
    SolvedLines,
    SolvedPoses,
    solve_axis,
    solve_lines,
    solve_poses,
    write_pivot,
    write_solution,
)
from pivometer.pipeline.standing import (
    StandingResults,
    ViewQuality,
    is_of_now,
    view_qualities,
)
from pivometer.pipeline.verifying import Verification, verify
from pivometer.pipeline.watching import device_thumbnails
from pivometer.pipeline.writing import (
    write_calibration,
    write_figures,
    write_measurement,
    write_tables,
    write_target,
)

__all__ = [
    "CheckOutcome",
    "Condition",
    "DemoOutcome",
    "Examined",
    "Group",
    "Plan",
    "SeenShafts",
    "SolvedLines",
    "SolvedPoses",
    "StandingResults",
    "Verification",
    "ViewQuality",
    "add_picture",
    "calibrate",
    "capture",
    "check",
    "compare",
    "demo",
    "describe",
    "device_thumbnails",
    "exclude",
    "file_of",
    "foreseen_calibration",
    "history",
    "is_of_now",
    "load",
    "measure",
    "measure_seen",
    "picture",
    "plan",
    "results_at",
    "save_sources",
    "saved_sources",
    "see_shafts",
    "seen_length_mm",
    "show_in_notebooks",
    "simulate",
    "solve_axis",
    "solve_lines",
    "solve_poses",
    "true_rcm",
    "two_cameras",
    "verify",
    "view_qualities",
    "with_decision",
    "write_calibration",
    "write_comparison",
    "write_figures",
    "write_history",
    "write_junit",
    "write_measurement",
    "write_pivot",
    "write_solution",
    "write_tables",
    "write_target",
]
