"""Whether a robot keeps a limit: for acceptance tests, and for CI."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import ClassVar, Literal

import numpy as np

from pivometer.errors import DataError, PivometerError, UsageError
from pivometer.geometry import distances_to_lines
from pivometer.measurement import ImportedRig, LimitDecision, Measurement, ShaftAgreement
from pivometer.pipeline.own_error import own_error
from pivometer.rcm import minimax_rcm
from pivometer.rcm.geometry_check import FEWEST_POSES_ADVISED, swept_by_one_joint
from pivometer.shaft.gate import SPREAD_TOLERANCE
from pivometer.uncertainty import Decision, guarded_decision, variance_ratio_limit
from pivometer.uncertainty.coverage import COVERAGE

CALIBRATION_RATIO = 4.0
"""How many times smaller than the limit the error of held-out board edges must be, rms: the ratio
of tolerance to measuring error that calibration laboratories ask for (ANSI/NCSL Z540.3)."""

RECORD_TOLERANCE = 1e-6
"""Part of the largest miss to which stated misses must follow from the stated lines: coordinates of
a metre are stored to 1e-13 mm."""

LARGEST_CHANGE = 100.0
"""From a change of the rms miss by this factor a baseline is of another robot, or not in mm."""

OWN_RULE = (
    "the 95 % interval of the robot's own largest miss: pass if its upper end keeps the limit, "
    "over if its lower end exceeds it, inconclusive otherwise (JCGM 106, guarded acceptance)"
)
GUARD_RULE = (
    "the observed largest miss with the guard band U: pass if max + U keeps the limit, over if "
    "max − U exceeds it, inconclusive otherwise (JCGM 106, guarded acceptance)"
)


@dataclass(frozen=True, slots=True, eq=False)
class Condition:
    """One thing that must be so.

    Parameters
    ----------
    name
        What it is about.
    status
        ``"met"``, ``"not met"``, or ``"not checked"`` where the data for it are missing.
    text
        What was found, with the numbers.
    """

    name: str
    status: Literal["met", "not met", "not checked"]
    text: str


@dataclass(frozen=True, slots=True, eq=False)
class CheckOutcome:
    """Whether the robot keeps the limit, and whether the measurement can tell.

    Parameters
    ----------
    decision
        ``"pass"``, ``"over"``, ``"inconclusive"``; ``"invalid"`` where a condition of validity is
        not met, so that no decision is made.
    text
        Why, in one sentence.
    rule
        The decision rule.
    limit_mm
        The limit of the largest miss, mm.
    interval_mm
        What is held against it, mm.
    validity
        The conditions of validity.
    baseline
        Comparison with an earlier result, if one was given.
    """

    decision: Decision | Literal["invalid"]
    text: str
    rule: str
    limit_mm: float
    interval_mm: tuple[float, float]
    validity: tuple[Condition, ...]
    baseline: Condition | None

    CODES: ClassVar[dict[str, int]] = {"pass": 0, "over": 1, "invalid": 4, "inconclusive": 5}

    @property
    def exit_code(self) -> int:
        """0 pass, 1 over, 4 a condition of validity is not met, 5 inconclusive."""
        return self.CODES[self.decision]


def check(
    measurement: Measurement,
    limit_mm: float,
    *,
    guard_mm: float | None = None,
    baseline: Measurement | None = None,
) -> CheckOutcome:
    """Decide whether the robot's largest miss keeps a limit.

    Parameters
    ----------
    measurement
        What `measure` returned or `read_result` read.
    limit_mm
        The limit, mm.
    guard_mm
        A guard band U about the observed largest miss, mm; where none is given, the interval of the
        robot's own largest miss is used.
    baseline
        An earlier result. If the rms miss has grown since by more than chance explains, the check
        is not passed, whatever the limit.

    Raises
    ------
    UsageError
        If the limit or the guard band is not a length, or the baseline cannot be compared.
    DataError
        If no guard band is given and the lines have no uncertainty.
    """
    if guard_mm is not None and not 0 <= guard_mm < float("inf"):
        raise UsageError(f"the guard band is {guard_mm} mm", next_step="give one of 0 or more")
    low, high = _interval(measurement, guard_mm)
    decision: Decision | Literal["invalid"] = guarded_decision(low, high, limit_mm)
    text = _reason(decision, (low, high), limit_mm)
    validity = tuple(_validity(measurement, limit_mm))
    compared = None if baseline is None else _compared(measurement, baseline)
    failed = [condition for condition in validity if condition.status == "not met"]
    if failed:
        decision, text = "invalid", "; ".join(condition.text for condition in failed)
    elif compared is not None and compared.status == "not met":
        decision, text = "over", compared.text
    return CheckOutcome(
        decision=decision,
        text=text,
        rule=OWN_RULE if guard_mm is None else GUARD_RULE,
        limit_mm=limit_mm,
        interval_mm=(low, high),
        validity=validity,
        baseline=compared,
    )


def with_decision(
    measurement: Measurement, limit_mm: float, *, guard_mm: float | None = None
) -> Measurement:
    """Return a measurement that states whether it keeps a limit; see `check`."""
    outcome = check(measurement, limit_mm, guard_mm=guard_mm)
    conditions = tuple(f"{one.name}: {one.text} ({one.status})" for one in outcome.validity)
    decided = LimitDecision(
        outcome.decision,
        outcome.text,
        outcome.rule,
        outcome.limit_mm,
        np.array(outcome.interval_mm),
        guard_mm,
        conditions,
    )
    return replace(measurement, decision=decided)


def _interval(measurement: Measurement, guard_mm: float | None) -> tuple[float, float]:
    """Return what is held against the limit, mm."""
    largest = measurement.rcm.minimax.max_mm
    if guard_mm is not None:
        return max(largest - guard_mm, 0.0), largest + guard_mm
    if not any(pose.centerline.covariance.any() for pose in measurement.used):
        raise DataError(
            "the centerlines of this result have no uncertainty",
            next_step="measure the session again, or give a guard band",
        )
    low, high = (measurement.intrinsic or own_error(measurement)).max_interval_mm.tolist()
    return low, high


def _reason(decision: str, interval: tuple[float, float], limit_mm: float) -> str:
    seen = f"the largest miss lies between {interval[0]:.3f} and {interval[1]:.3f} mm"
    if decision == "pass":
        return f"{seen}, within the limit of {limit_mm:g} mm"
    if decision == "over":
        return f"{seen}, beyond the limit of {limit_mm:g} mm"
    return f"{seen}, and the limit of {limit_mm:g} mm is inside: lessen the noise of the pictures"


def _validity(measurement: Measurement, limit_mm: float) -> Iterator[Condition]:
    yield _record(measurement)
    refusals = [f.text for f in measurement.findings if f.severity == "refusal"]
    yield _condition("geometry", not refusals, "; ".join(refusals) or "no finding refuses it")
    yield _joints(measurement)
    yield _stillness(measurement)
    count = len(measurement.used)
    yield _condition(
        "poses",
        count >= FEWEST_POSES_ADVISED,
        f"{count} of {len(measurement.poses)} poses count, {FEWEST_POSES_ADVISED} are the least",
    )
    yield _calibrated(measurement, limit_mm / CALIBRATION_RATIO)
    yield _diameter(measurement)
    if measurement.shaft is not None:
        yield _agreement(measurement.shaft)
    own = measurement.intrinsic
    if own is not None:
        yield _condition(
            "noise",
            not own.noise_overstated,
            f"the noise stated for the edges explains {own.instrument_rms_mm:.3g} mm rms of the "
            f"{measurement.rcm.least_squares.rms_mm:.3g} mm seen",
        )


def _joints(measurement: Measurement) -> Condition:
    """Ask for poses that more than one joint moved: else every robot seems to keep a point."""
    swept = swept_by_one_joint(np.stack([p.centerline.direction for p in measurement.used]))
    text = "the directions of the shaft fill a cone"
    if swept is not None:
        text = f"all directions lie on one circle to {np.degrees(swept[0]):.2g}°: one joint moved"
    return _condition("joints", swept is None, text)


def _stillness(measurement: Measurement) -> Condition:
    """Ask for a set-up that stood still: else the misses are not the robot's."""
    moved = [movement for movement in measurement.camera_movements if movement.significant]
    if moved:
        shifts = "; ".join(
            f"camera {m.camera} moved by {m.shift_px:.2f} px between {m.before} and {m.after}, "
            f"{m.limit_px:.2f} px is the most"
            for m in moved
        )
        return Condition("stillness", "not met", shifts)
    if measurement.structure is None:
        return Condition("stillness", "not checked", "the result does not state the order's part")
    orders = [pattern for pattern in measurement.structure.patterns if pattern.kind == "order"]
    if not orders:
        return Condition("stillness", "not checked", "fewer than 10 poses tell no drift")
    return _condition("stillness", not orders[0].found, orders[0].text)


def _record(measurement: Measurement) -> Condition:
    """Hold the stated misses against the lines that are stated beside them."""
    used, both = measurement.used, (measurement.rcm.minimax, measurement.rcm.least_squares)
    if any(len(point.distances_mm) != len(used) for point in both):
        return Condition("record", "not met", f"{len(used)} poses count, but not as many misses")
    points = [pose.centerline.point_mm for pose in used]
    directions = [pose.centerline.direction for pose in used]
    try:
        least = minimax_rcm(points, directions).max_mm
    except PivometerError as error:
        return Condition("record", "not met", error.what)
    differ = [abs(measurement.rcm.minimax.max_mm - least)]
    for point in both:
        distances = distances_to_lines(point.point_mm, points, directions)
        differ.append(float(np.abs(point.distances_mm - distances).max()))
    return _condition(
        "record",
        max(differ) <= RECORD_TOLERANCE * least,
        f"the stated misses differ by {max(differ):.1g} mm from those of the stated centerlines",
    )


def _calibrated(measurement: Measurement, most_mm: float) -> Condition:
    """Hold the held-out edges against the most that the limit allows."""
    calibration = measurement.calibration
    if isinstance(calibration, ImportedRig):
        return Condition("calibration", "not checked", "the rig was imported: nothing is known")
    held_out = calibration.held_out
    return _condition(
        "calibration",
        held_out.rms_mm <= most_mm,
        f"held-out board edges are off by {held_out.rms_mm:.3g} mm rms, {most_mm:.3g} mm "
        f"(limit / {CALIBRATION_RATIO:g}) is the most",
    )


def _diameter(measurement: Measurement) -> Condition:
    """Hold the shaft's diameter against the nominal one: an independent check of the scale."""
    nominal = measurement.setup.diameter_mm
    if nominal is None:
        return Condition("diameter", "not checked", "the session states no diameter of the shaft")
    seen = float(np.median([d for pose in measurement.used for d in pose.diameters_mm]))
    return _condition(
        "diameter",
        abs(seen - nominal) <= SPREAD_TOLERANCE * nominal,
        f"the shaft measures {seen:.3f} mm, its nominal diameter is {nominal:g} mm, "
        f"{100 * SPREAD_TOLERANCE:g} % is the most they may differ",
    )


def _agreement(shaft: ShaftAgreement) -> Condition:
    """Ask that the edges fit cameras that stand where the calibration says, all the time."""
    return _condition(
        "agreement",
        not (shaft.moved.significant or shaft.change.significant),
        "what the edges say of cameras that stand elsewhere than calibrated has a χ² of "
        f"{shaft.moved.chi_square:.0f}, by chance under {shaft.moved.limit:.0f}; of one that moved "
        f"during the session {shaft.change.chi_square:.0f}, under {shaft.change.limit:.0f}",
    )


def _compared(measurement: Measurement, earlier: Measurement) -> Condition:
    """Tell whether the rms miss has grown by more than chance explains."""
    record = _record(earlier)
    if record.status != "met":
        raise UsageError(
            f"the baseline does not agree with itself: {record.text}",
            next_step="name a result.json as Pivometer wrote it",
        )
    variances, freedoms = zip(*map(_variance, (measurement, earlier)), strict=True)
    largest = variance_ratio_limit(*freedoms, coverage=COVERAGE)
    now, then = np.sqrt(variances)
    if not now / LARGEST_CHANGE < then < now * LARGEST_CHANGE:
        raise UsageError(
            f"the rms miss a component is {now:.4g} mm, the baseline's {then:.4g} mm: no robot "
            f"changes by a factor of {LARGEST_CHANGE:g}",
            next_step="name a result of the same robot, as Pivometer wrote it",
        )
    return _condition(
        "baseline",
        variances[0] <= largest * variances[1],
        f"the rms miss a component is {now:.4f} mm, it was {then:.4f} mm; by chance it grows to "
        f"{then * np.sqrt(largest):.4f} mm in 5 % of cases ({len(measurement.used)} poses now, "
        f"{len(earlier.used)} then)",
    )


def _variance(measurement: Measurement) -> tuple[float, int]:
    """Return s² = Σ dᵢ²/(2n − 3), mm², and its degrees of freedom."""
    distances = measurement.rcm.least_squares.distances_mm
    freedom = 2 * len(distances) - 3
    return float(distances @ distances) / freedom, freedom


def _condition(name: str, met: bool, text: str) -> Condition:
    return Condition(name, "met" if met else "not met", text)
