"""The words under the drawings, the same on the page and on paper."""

from pivometer.calibration.advice import Advice
from pivometer.calibration.result import Calibration
from pivometer.measurement import Measurement

CHART = (
    "Distance of each centerline from the RCM in the session’s order: bars from the minimax point, "
    "with the 95 % interval that the pose’s own edges leave (thin lines, short where the edges are "
    "good); rings from the least-squares point; ▼ poses at the maximum, ✕ rejected poses."
)
MAP = (
    "The misses over the direction of the shaft: each dot lies at the shaft’s tilt from its mean "
    "and the side it is tilted to, circles of equal tilt; its arrow is the part of the miss from "
    "the least-squares point that lies across the mean shaft, magnified. Arrows that turn slowly "
    "from dot to dot are the robot’s own; arrows at random are noise."
)
ORDER = (
    "The misses along and across the mean shaft in the order of the poses: a slope is a drift, a "
    "step a jump."
)
PICTURES = "In the pictures: solid the fitted edges, dashed the centerline, + the RCM."
GALLERY = (
    "Edge u is the standard uncertainty of each edge’s offset; blur is the standard deviation of "
    "the blur across the edge, lens and pixel together; used is the part of the rows that count; "
    "two figures stand for the two edges. The small plots show the median grey levels across both "
    "edges (dots; the shaft in the middle, 8 px beyond each edge) with a step at each fitted edge "
    "and of the fitted blur (line), and below them how far the rows lie off each fitted edge along "
    "the shaft, one camera beside the other, outward upwards, with ± 2 u; the figure is the height "
    "of half a strip, px."
)
CARRIED = (
    "This file carries the result as JSON and a record of its pictures. “pivometer verify” "
    "measures the session again and compares every figure and every byte."
)


def target(measurement: Measurement) -> str:
    """Explain the target plot."""
    factor = measurement.uncertainty.coverage_factor
    return (
        "Where each centerline passes the RCM, seen along the mean shaft, mm. + minimax point; "
        "circles at its rms (dashed) and max (solid). A dot lies in the direction in which the "
        "centerline’s nearest point is seen, at its true distance in space; ▲ poses at the "
        f"maximum. ◇ least-squares point, with the ellipse (k = {factor:.2f}) of the part of its "
        "uncertainty that comes from the centerlines. Numbers are the poses’; those that would "
        "collide are left out, the table below has them all."
    )


def scene_far(measurement: Measurement) -> str:
    """Explain the view of the whole rig."""
    return (
        "Cameras with what they see, baseline (dashed), every centerline and the RCM (+), parallel "
        f"projection; the axes are those of camera “{measurement.reference_camera}”."
    )


def scene_near(zoom: int) -> str:
    """Explain the view of the RCM."""
    return (
        f"The same, ×{zoom} at the RCM: each dot is a centerline’s nearest point, its stroke the "
        "miss; spheres at rms and max."
    )


def advice_text(told: Advice) -> str:
    """Say how good a calibration is where it matters, and what would improve it."""
    return (
        f"{told.verdict} What matters most at the RCM is {told.cause}. What would improve it most: "
        f"{told.next_step}."
    )


def views_text(calibration: Calibration) -> str:
    """Say how a calibration was made, and from how many pictures."""
    return (
        f"Method: {calibration.method}. Board pictures used: {len(calibration.views)}; not used: "
        f"{len(calibration.rejected)}."
    )
