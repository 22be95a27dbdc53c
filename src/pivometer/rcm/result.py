"""What solving for the RCM returns: both points of the paper, side by side."""

from dataclasses import dataclass
from typing import Literal

from pivometer._arrays import Floats, checked, read_only


@dataclass(frozen=True, slots=True, eq=False)
class Finding:
    """What weakens an answer, in plain words.

    Parameters
    ----------
    severity
        ``"warning"``: the answer stands, with care. ``"refusal"``: the answer must not be used.
    text
        What was found, with the numbers.
    next_step
        What the user does about it.
    """

    severity: Literal["warning", "refusal"]
    text: str
    next_step: str


@dataclass(frozen=True, slots=True, eq=False)
class MinimaxRcm:
    """The RCM of (2)–(3): the point whose largest distance from the centerlines is smallest.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm, in the frame of the lines.
    max_mm, rms_mm
        Largest distance and root mean square of the distances of the lines from it, mm. The
        largest distance is the least possible: no other point has a smaller one.
    certificate_gap
        How far `max_mm` can be above that least possible value, relative to it, proved by duality.
        Zero means exact to rounding.
    distances_mm
        Distance of each line, shape (n,), mm.
    active
        Shape (k,), integers: the lines that decide, those with a positive weight in the
        certificate; seldom more than four.
    weights
        Their weights, shape (k,), positive with sum 1. For every point q, Σ wᵢ dᵢ(q)² ≤
        max dᵢ(q)²; so the least value of the left side bounds the square of `max_mm` from below.
    """

    point_mm: Floats
    max_mm: float
    rms_mm: float
    certificate_gap: float
    distances_mm: Floats
    active: tuple[int, ...]
    weights: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", read_only(checked(self.point_mm, (3,), "point_mm")))
        for name in ("distances_mm", "weights"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (None,), name)))


@dataclass(frozen=True, slots=True, eq=False)
class LeastSquaresRcm:
    """The paper's 2-norm RCM: the point with the least sum of squared distances from the lines.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm, in the frame of the lines.
    covariance_mm2
        Its covariance, shape (3, 3), mm².
    max_mm, rms_mm
        Largest distance and root mean square of the distances of the lines from it, mm.
    distances_mm
        Distance of each line, shape (n,), mm.
    """

    point_mm: Floats
    covariance_mm2: Floats
    max_mm: float
    rms_mm: float
    distances_mm: Floats

    def __post_init__(self) -> None:
        for name, shape in (
            ("point_mm", (3,)),
            ("covariance_mm2", (3, 3)),
            ("distances_mm", (None,)),
        ):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


@dataclass(frozen=True, slots=True, eq=False)
class LeastDistanceRcm:
    """The point with the least sum of distances from the lines: their spatial median.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm, in the frame of the lines. It may lie on one of the lines.
    mean_mm
        Mean distance of the lines from it, mm: the least possible.
    certificate_gap
        How far `mean_mm` can be above that least possible value, relative to it, proved by duality.
    distances_mm
        Distance of each line, shape (n,), mm.
    """

    point_mm: Floats
    mean_mm: float
    certificate_gap: float
    distances_mm: Floats

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", read_only(checked(self.point_mm, (3,), "point_mm")))
        distances = checked(self.distances_mm, (None,), "distances_mm")
        object.__setattr__(self, "distances_mm", read_only(distances))


@dataclass(frozen=True, slots=True, eq=False)
class TrimmedRcm:
    """The least-squares point of the nearest three quarters of the lines.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm, in the frame of the lines.
    rms_mm
        Root mean square of the distances of the lines that count, mm.
    distances_mm
        Distance of each line, those left out too, shape (n,), mm.
    left_out
        Which lines do not count.
    certificate_gap
        How far the sum of squares of the lines that count can be above the least possible one of
        as many lines, relative to it; 1 where nothing is proved.
    """

    point_mm: Floats
    rms_mm: float
    distances_mm: Floats
    left_out: tuple[int, ...]
    certificate_gap: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "point_mm", read_only(checked(self.point_mm, (3,), "point_mm")))
        distances = checked(self.distances_mm, (None,), "distances_mm")
        object.__setattr__(self, "distances_mm", read_only(distances))


@dataclass(frozen=True, slots=True, eq=False)
class WeightedRcm:
    """The generalized least-squares point: lines that the instrument knows badly count less.

    Parameters
    ----------
    point_mm
        The point, shape (3,), mm, in the frame of the lines.
    covariance_mm2
        Its covariance, shape (3, 3), mm²: instrument, errors common to all lines if they were
        given, and the robot's own scatter as far as it is independent from line to line.
    own_mm
        The robot's own scatter τ, a standard deviation a component, mm; zero where the instrument
        explains all.
    max_mm, rms_mm
        Largest distance and root mean square of the distances of the lines from it, mm. They are
        not weighted: a line that counts little for the point counts in full here.
    distances_mm
        Distance of each line, shape (n,), mm.
    shares
        Part of the whole weight that each line has, shape (n,), positive with sum 1.
    shift_mm
        This point minus the least-squares point, shape (3,), mm.
    shift_covariance_mm2
        Covariance of that shift if the errors are what they are taken for, shape (3, 3), mm². A
        shift that it does not explain tells of errors that depend on the pose.
    """

    point_mm: Floats
    covariance_mm2: Floats
    own_mm: float
    max_mm: float
    rms_mm: float
    distances_mm: Floats
    shares: Floats
    shift_mm: Floats
    shift_covariance_mm2: Floats

    def __post_init__(self) -> None:
        for name, shape in (
            ("point_mm", (3,)),
            ("covariance_mm2", (3, 3)),
            ("distances_mm", (None,)),
            ("shares", (None,)),
            ("shift_mm", (3,)),
            ("shift_covariance_mm2", (3, 3)),
        ):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


@dataclass(frozen=True, slots=True, eq=False)
class RcmSolution:
    """Both RCM points of the paper, their distance, the cone that the lines fill, and other points.

    Parameters
    ----------
    minimax, least_squares
        The two points.
    separation_mm
        Distance between them, mm. For independent errors and 70 lines about 0.56 times the rms; it
        vanishes only for symmetric sets of lines.
    cone_deg
        Apex angle of the smallest circular cone that holds all directions, signs ignored, deg.
    least_distance, trimmed
        Two points that a few wrong lines do not move; `None` where they were not asked for, or the
        lines that count for the trimmed one are parallel.
    weighted
        The point for which lines count by how well they are known; `None` where that is not known.
    content
        Part of all lines drawn at random like these that miss the minimax point by no more than
        `minimax.max_mm`, at least and at 95 % confidence; `None` where it was not asked for.
    """

    minimax: MinimaxRcm
    least_squares: LeastSquaresRcm
    separation_mm: float
    cone_deg: float
    least_distance: LeastDistanceRcm | None = None
    trimmed: TrimmedRcm | None = None
    weighted: WeightedRcm | None = None
    content: float | None = None
