"""The answer in one sentence of plain words, with its numbers and what was rejected."""

from dataclasses import dataclass

from pivometer._arrays import Floats
from pivometer.measurement import Measurement
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.uncertainty.propagation import LinesUncertainty, LocationUncertainty

_OUTCOMES = {
    "pass": "✓ Pass",
    "over": "✕ Over the limit",
    "inconclusive": "? Inconclusive",
    "invalid": "✕ No decision, a condition of validity is not met",
}

NO_LIMIT = (
    "Decision rule: no limit is stated, so nothing is passed or failed here. Against a limit "
    "(pivometer check --limit), the 95 % interval of the robot’s own largest miss decides: pass if "
    "its upper end keeps the limit, over if its lower end exceeds it, inconclusive otherwise "
    "(JCGM 106, guarded acceptance)."
)


@dataclass(frozen=True, slots=True, eq=False)
class Verdict:
    """What the report opens with.

    Parameters
    ----------
    usable
        False where a finding refuses the answer.
    sentence
        The largest and the rms miss over how many poses, and where the RCM is; without any number
        where the answer is refused.
    rejected
        What was thrown out, in one sentence.
    decision
        Whether a limit is kept, in one sentence; empty where none was stated.
    rule
        By which rule that is, or would be, decided.
    """

    usable: bool
    sentence: str
    rejected: str
    decision: str
    rule: str


def verdict(measurement: Measurement) -> Verdict:
    """Say what a measurement found.

    The largest miss is that of the minimax point, the rms miss and the location those of the
    least-squares point, whose covariance is known: each number is the least of its kind.
    """
    usable = all(finding.severity != "refusal" for finding in measurement.findings)
    sentence = f"{_misses(measurement)} {_location(measurement)}"
    if not usable:
        sentence = (
            "The RCM could not be measured at acceptable confidence; the figures below show what "
            "was seen and must not be used."
        )
    decided = measurement.decision
    rule = NO_LIMIT if decided is None else f"Decision rule: {decided.rule}."
    return Verdict(usable, sentence, _rejected(measurement), _decision(measurement), rule)


def _decision(measurement: Measurement) -> str:
    decided = measurement.decision
    if decided is None:
        return ""
    return f"{_OUTCOMES[decided.decision]}: {decided.text}."


def _misses(measurement: Measurement) -> str:
    rcm = measurement.rcm
    decimals = error_decimals([rcm.minimax.max_mm, rcm.least_squares.rms_mm])
    return (
        f"Over {len(measurement.used)} poses the shaft's centerline misses the RCM by at most "
        f"{fixed(rcm.minimax.max_mm, decimals)} mm "
        f"({fixed(rcm.least_squares.rms_mm, decimals)} mm rms).{_own(measurement, decimals)}"
    )


def _own(measurement: Measurement, decimals: int) -> str:
    """Say what of it is the robot's own."""
    own = measurement.intrinsic
    if own is None:
        return ""
    rms, largest = (
        " to ".join(fixed(float(end), decimals) for end in interval)
        for interval in (own.rms_interval_mm, own.max_interval_mm)
    )
    return (
        f" The robot's own part of it, apart from the instrument's noise of "
        f"{fixed(own.instrument_rms_mm, decimals)} mm rms, is {rms} mm rms and {largest} mm at "
        f"most ({100 * own.coverage:.0f} % intervals over these poses)."
    )


def _location(measurement: Measurement) -> str:
    """Say where the RCM is: in the reference board's frame first, where there is one."""
    uncertainty, frame = measurement.uncertainty, measurement.board_frame
    camera = f"the frame of camera “{measurement.reference_camera}”"
    point = _place(measurement.rcm.least_squares.point_mm, uncertainty.expanded_mm)
    if frame is None:
        return (
            f"The RCM lies at {point} mm in {camera} "
            f"({_coverage(uncertainty.coverage, uncertainty.coverage_factor)})."
            f"{_unknown_part(uncertainty)}"
        )
    inside = _place(frame.least_squares_point_mm, frame.uncertainty.expanded_mm)
    return (
        f"The RCM lies at {inside} mm in the frame of the reference board "
        f"({_coverage(frame.uncertainty.coverage, frame.uncertainty.coverage_factor)}), "
        f"and at {point} mm in {camera} (k = {uncertainty.coverage_factor:.2f})."
    )


def _unknown_part(uncertainty: LocationUncertainty | LinesUncertainty) -> str:
    """Say so where the stated uncertainty lacks the calibration's part."""
    if isinstance(uncertainty, LocationUncertainty):
        return ""
    return (
        " That uncertainty is the scatter of the centerlines only: what the imported calibration "
        "adds is unknown."
    )


def _place(point_mm: Floats, expanded_mm: Floats) -> str:
    values = zip(point_mm, expanded_mm, strict=True)
    return f"({', '.join(with_uncertainty(float(value), float(u)) for value, u in values)})"


def _coverage(coverage: float, factor: float) -> str:
    return f"{100 * coverage:.0f} % coverage, k = {factor:.2f}"


def _rejected(measurement: Measurement) -> str:
    count, whole = len(measurement.rejected), len(measurement.poses)
    if count == 0:
        return f"None of the {whole} poses was rejected."
    names = ", ".join(pose.pose for pose in measurement.rejected[:6])
    more = f" and {count - 6} more" if count > 6 else ""
    verb = "was" if count == 1 else "were"
    return f"{count} of {whole} poses {verb} rejected ({names}{more}); the reasons are below."
