"""Where the uncertainty comes from: the budget, the Monte Carlo and the instrument's floor."""

import numpy as np

from pivometer.measurement import Measurement
from pivometer.report.digits import fixed, uncertainty_text
from pivometer.report.tables import Table
from pivometer.uncertainty.budget import BudgetSource
from pivometer.uncertainty.floor import InstrumentFloor
from pivometer.uncertainty.monte_carlo import Spread


def budget_table(measurement: Measurement) -> Table | None:
    """Tabulate what each source contributes; `None` where not all are known."""
    budget, board = measurement.budget, measurement.setup.board
    if budget is None:
        return None
    framed = measurement.board_frame is not None
    columns = ["source"]
    columns += [f"u({axis}) board" for axis in "xyz" if framed]
    columns += [f"u({axis}) camera" for axis in "xyz"]
    columns += ["rms of a perfect robot", "u(max)"]
    note = (
        "Standard uncertainties of the least-squares point in the frame "
        + ("of the reference board and " * framed)
        + f"of camera “{measurement.reference_camera}”; the rms miss that the source alone would "
        "show with a perfect robot; and the standard uncertainty of the largest miss, to first "
        "order. The sources are independent: squares add up. What moves all centerlines alike "
        "adds to the location and not to the misses."
    )
    if board.square_u_mm is None:
        note += (
            " The uncertainty of the size of a square is not stated in the session "
            "(board.square_u_mm), so it is in none of these figures: 0.1 % of it moves the RCM by "
            f"{0.001 * np.linalg.norm(measurement.rcm.least_squares.point_mm):.2f} mm from the "
            "camera."
        )
    rows = [_budget_row(source) for source in budget.sources]
    return Table("Uncertainty budget, mm", tuple(columns), (*rows, _total(measurement)), note)


def _budget_row(source: BudgetSource) -> tuple[str, ...]:
    board = () if source.board_u_mm is None else source.board_u_mm.tolist()
    values = (*board, *source.location_u_mm.tolist(), source.rms_mm, source.max_u_mm)
    return (source.name, *(_cell(value) for value in values))


def _total(measurement: Measurement) -> tuple[str, ...]:
    """Return the root of the sum of squares of every column."""
    budget = measurement.budget
    sources = () if budget is None else budget.sources
    columns = np.array(
        [
            [
                *([] if one.board_u_mm is None else one.board_u_mm),
                *one.location_u_mm,
                one.rms_mm,
                one.max_u_mm,
            ]
            for one in sources
        ]
    )
    return ("all together", *(_cell(value) for value in np.sqrt(np.square(columns).sum(axis=0))))


def _cell(value: float) -> str:
    """Return a contribution with two digits, those under 0.1 µm as none."""
    return uncertainty_text(value) if value >= 1e-4 else "–"


def budget_sentences(measurement: Measurement) -> list[str]:
    """Say which source is the largest and what to do about it; empty without a budget."""
    if measurement.budget is None:
        return []
    return [f"{text[0].upper()}{text[1:]}." for text in measurement.budget.advice]


def monte_carlo_table(measurement: Measurement) -> Table | None:
    """Tabulate the draws beside the linear propagation; `None` where none were made."""
    found, linear = measurement.monte_carlo, measurement.uncertainty
    if found is None:
        return None
    rcm = measurement.rcm
    stated = linear.expanded_mm / linear.coverage_factor
    rows = [
        _spread_row(f"{axis} of the RCM", float(rcm.least_squares.point_mm[i]), spread, stated[i])
        for i, (axis, spread) in enumerate(zip("xyz", (found.x, found.y, found.z), strict=True))
    ]
    own = measurement.intrinsic
    largest_u = None if own is None else own.max_u_mm
    rows += [
        _spread_row("largest miss (max)", rcm.minimax.max_mm, found.max, largest_u),
        _spread_row("rms miss", rcm.least_squares.rms_mm, found.rms, None),
    ]
    part = f"{100 * found.coverage:.0f} %"
    return Table(
        f"By drawing every input {found.draws} times (Monte Carlo), mm",
        ("quantity", "observed", "mean of the draws", "u", "u, linear", f"{part} of the draws"),
        tuple(rows),
        "Pixels, calibration, light and the robot’s scatter are drawn and the whole chain is "
        "computed again for each draw; GUM supplement 1. Observed misses hold noise once and the "
        "draws twice: by as much as their mean lies above what was observed, that lies above the "
        f"robot’s own. The linear propagation {'holds' if found.linear_holds else 'does NOT hold'} "
        "for the location.",
    )


def _spread_row(
    name: str, observed: float, spread: Spread, linear_u: float | None
) -> tuple[str, ...]:
    decimals = 4 if spread.u_mm < 0.1 else 3
    low, high = (fixed(float(end), decimals) for end in spread.interval_mm)
    return (
        name,
        fixed(observed, decimals),
        fixed(spread.mean_mm, decimals),
        uncertainty_text(spread.u_mm),
        "–" if linear_u is None else uncertainty_text(linear_u),
        f"{low} … {high}",
    )


def floor_table(measurement: Measurement) -> Table | None:
    """Tabulate the instrument's floor, measured here or taken from elsewhere; `None` without."""
    own, taken = measurement.gold_standard, measurement.floor
    floor = own or taken
    if floor is None:
        return None
    caption = (
        "The instrument’s floor: this session is a gold standard"
        if taken is None
        else f"The instrument’s floor, from the gold standard of session “{floor.session}”"
    )
    return Table(
        caption,
        ("quantity", "found"),
        (
            ("poses", str(floor.poses)),
            ("rms / largest miss seen, mm", f"{floor.rms_mm:.4f} / {floor.max_mm:.4f}"),
            ("of that, explained by edges and calibration, mm rms", f"{floor.stated_rms_mm:.4f}"),
            ("of that, the joint itself (stated), mm rms", f"{floor.bearing_rms_mm:.4f}"),
            ("left over, a line and component, mm", _excess(floor)),
        ),
        "What is left over is what the instrument adds beyond its stated noise. In a session that "
        "is given this floor it counts as noise of every line: the estimate of the robot’s own "
        "error takes it off, and the intervals hold for every value in its own.",
    )


def _excess(floor: InstrumentFloor) -> str:
    value, low, high = np.sqrt(floor.excess_mm2)
    return f"{value:.4f} (95 %: {low:.4f} … {high:.4f})"


def floor_sentence(measurement: Measurement) -> str:
    """Say what a gold standard showed, in one sentence; empty for another session."""
    floor = measurement.gold_standard
    if floor is None:
        return ""
    value, low, high = np.sqrt(floor.excess_mm2)
    return (
        f"The instrument's floor: {floor.rms_mm:.4f} mm rms seen, {floor.stated_rms_mm:.4f} mm "
        f"explained by edges and calibration; {value:.4f} mm ({low:.4f} to {high:.4f}) a line and "
        "component are left over."
    )
