"""What one measurement of a session says: the same names and content as ``result.json``."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from pivometer._arrays import Floats, checked, read_only
from pivometer.calibration.board import Board
from pivometer.calibration.procedure import Calibration
from pivometer.calibration.result import RejectedView
from pivometer.cameras import Rig
from pivometer.geometry.rigid import RigidTransform
from pivometer.rcm.result import Finding, RcmSolution
from pivometer.rcm.structure import ErrorStructure
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.hint import ShaftHint
from pivometer.shaft.stillness import CameraMovement
from pivometer.shaft.triangulation import Centerline
from pivometer.uncertainty.budget import UncertaintyBudget
from pivometer.uncertainty.floor import InstrumentFloor
from pivometer.uncertainty.frame import BoardFrameUncertainty
from pivometer.uncertainty.intrinsic import IntrinsicError
from pivometer.uncertainty.monte_carlo import MonteCarlo
from pivometer.uncertainty.propagation import LinesUncertainty, LocationUncertainty
from pivometer.uncertainty.shaft_bend import ShaftBend
from pivometer.uncertainty.shaft_check import MoveTest, ShaftDiameter


@dataclass(frozen=True, slots=True, eq=False)
class PoseDistances:
    """Distance of one centerline from the two RCM points, mm: the RCM error of that pose.

    Parameters
    ----------
    minimax
        From the minimax point.
    least_squares
        From the least-squares point.
    """

    minimax: float
    least_squares: float


@dataclass(frozen=True, slots=True, eq=False)
class PoseCylinder:
    """The maximum-likelihood cylinder behind all edges of a pose, of the session's radius.

    Parameters
    ----------
    point_mm, direction
        Its axis: the foot of the perpendicular from the reference camera's centre (mm), and the
        unit direction, shape (3,), reference camera's frame.
    apart_mm
        Distance of the axis from the pose's centerline, where they pass the least-squares RCM, mm.
    chi_square
        What is left of the edges, over what noise, shading and the calibration explain.
    limit
        What chance exceeds in one pose of ten thousand sessions.
    """

    point_mm: Floats
    direction: Floats
    apart_mm: float
    chi_square: float
    limit: float

    def __post_init__(self) -> None:
        for name in ("point_mm", "direction"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (3,), name)))


@dataclass(frozen=True, slots=True, eq=False)
class ShaftAgreement:
    """How well the edges of all poses and cameras fit one straight cylinder of one radius.

    Parameters
    ----------
    route
        What the centerlines are: ``"paper"``, eqs. (14)–(16), or ``"cylinder"``, the axes of the
        maximum-likelihood cylinders.
    diameter
        The shaft's diameter with its uncertainty: an independent check of the metric scale.
    scatter
        By how many times the edges miss the cylinders farther than stated; at least 1.
    moved
        Whether cameras stood elsewhere than the calibration says.
    change
        Whether a camera moved during the session.
    change_from
        The pose from which on it would have.
    bend
        The bow that all poses have in common; `None` where the edges state no curvature.
    """

    route: str
    diameter: ShaftDiameter
    scatter: float
    moved: MoveTest
    change: MoveTest
    change_from: str
    bend: ShaftBend | None = None


@dataclass(frozen=True, slots=True, eq=False)
class UsedPose:
    """A pose that counts.

    Parameters
    ----------
    pose
        The file stem of its images.
    centerline
        The triangulated centerline, reference camera's frame, mm.
    distance_mm
        Its distance from both RCM points, mm.
    dihedral_deg
        Angle between the two centerline planes that differ most, deg.
    diameters_mm
        The shaft's diameter as seen by each camera, in the order of `edges`, mm.
    edges
        The fitted edges, one entry per camera.
    cylinder
        The cylinder that fits all of them best; `None` where none was fitted.
    status
        ``"used"``.
    """

    pose: str
    centerline: Centerline
    distance_mm: PoseDistances
    dihedral_deg: float
    diameters_mm: tuple[float, ...]
    edges: tuple[ShaftEdges, ...]
    cylinder: PoseCylinder | None = None
    status: str = "used"


@dataclass(frozen=True, slots=True, eq=False)
class RejectedPose:
    """A pose that does not count, and why.

    Parameters
    ----------
    pose
        The file stem of its images.
    reason
        What is wrong with it, with the numbers and the camera or file.
    next_step
        What to do about it.
    edges
        The edges that were found all the same, one entry per camera that found them.
    status
        ``"rejected"``.
    """

    pose: str
    reason: str
    next_step: str
    edges: tuple[ShaftEdges, ...] = ()
    status: str = "rejected"


@dataclass(frozen=True, slots=True, eq=False)
class ImportedRig:
    """A rig that another program calibrated: cameras and poses, and no word of how good they are.

    Parameters
    ----------
    rig
        The cameras and their poses.
    file_format
        The format of the files it came from.
    inputs
        SHA-256 of these files, by name.
    status
        ``"imported"``.
    """

    rig: Rig
    file_format: str
    inputs: Mapping[str, str]
    status: str = "imported"


@dataclass(frozen=True, slots=True, eq=False)
class Setup:
    """What the session says of itself.

    Parameters
    ----------
    session
        The folder's name.
    board
        The calibration board.
    diameter_mm
        The shaft's nominal diameter, mm; `None` where the session does not state one.
    device, operator
        Free-form tables of ``session.toml``.
    notes
        Free text.
    """

    session: str
    board: Board
    diameter_mm: float | None
    device: Mapping[str, object]
    operator: Mapping[str, object]
    notes: str


@dataclass(frozen=True, slots=True, eq=False)
class Options:
    """What was asked of `measure`, under the names of its options, so that it can be asked again.

    Parameters
    ----------
    method, distortion
        How to calibrate.
    centerline
        What a pose's centerline is.
    hints
        By camera, where the shaft is; without those of ``session.toml``.
    rig_given
        Whether the calibration came from elsewhere; it is then the one in the result.
    draws
        How many draws of a Monte Carlo; 0 for none.
    bearing_rms_mm
        Rms miss of the joint itself in a session of a gold standard, mm; `None` in others.
    """

    method: str
    distortion: str
    centerline: str
    hints: Mapping[str, ShaftHint]
    rig_given: bool
    draws: int = 0
    bearing_rms_mm: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Provenance:
    """How and when a measurement was made; the hashes of its inputs stand beside it.

    Parameters
    ----------
    command
        The command line, or what was called.
    created
        When, ISO 8601 with its time zone.
    versions
        Version of every piece of software that took part, by name.
    options
        What was asked for; `None` where the edges came from elsewhere.
    """

    command: str
    created: str
    versions: Mapping[str, str]
    options: Options | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LimitDecision:
    """Whether the robot keeps a limit, and by which rule that was decided.

    Parameters
    ----------
    decision
        ``"pass"``, ``"over"``, ``"inconclusive"``; ``"invalid"`` where a condition is not met.
    text
        Why, in one sentence.
    rule
        The decision rule.
    limit_mm
        The limit of the largest miss, mm.
    interval_mm
        What was held against it, shape (2,), mm.
    guard_mm
        The guard band, mm; `None` where the interval of the robot's own largest miss decided.
    conditions
        The conditions of validity and how they stand, in plain words.
    """

    decision: Literal["pass", "over", "inconclusive", "invalid"]
    text: str
    rule: str
    limit_mm: float
    interval_mm: Floats
    guard_mm: float | None
    conditions: tuple[str, ...]

    def __post_init__(self) -> None:
        interval = checked(self.interval_mm, (2,), "interval_mm")
        object.__setattr__(self, "interval_mm", read_only(interval))


@dataclass(frozen=True, slots=True, eq=False)
class BoardCenterline:
    """A used pose's centerline in the reference board's frame.

    Parameters
    ----------
    pose
        The file stem of its images.
    point_mm
        The point of `Centerline.point_mm`, shape (3,), mm.
    direction
        Its direction, unit length, shape (3,).
    """

    pose: str
    point_mm: Floats
    direction: Floats

    def __post_init__(self) -> None:
        for name in ("point_mm", "direction"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (3,), name)))


@dataclass(frozen=True, slots=True, eq=False)
class BoardFrame:
    """The result in the frame of the board that stood still under ``reference/``.

    The frame has its origin at the board's inner corner 0, x across, y down and z away from the
    viewer. Distances of centerlines from the RCM are the same in every frame.

    Parameters
    ----------
    reference_from_board
        The board's pose in the reference camera's frame.
    covariance
        Its covariance, corners and calibration: rotation vector applied on the left (rad), then
        translation (mm), shape (6, 6).
    minimax_point_mm, least_squares_point_mm
        Both RCM points in the board's frame, shape (3,), mm.
    uncertainty
        Of the least-squares point in this frame.
    centerlines
        The centerlines of the used poses in this frame, in the order of the poses.
    views
        The views that show the board.
    rejected
        Views in which it was not found.
    rms_px
        Root-mean-square distance between mean corners and projected ones, px.
    note
        How an ambiguous board was numbered; empty where it is not ambiguous.
    """

    reference_from_board: RigidTransform
    covariance: Floats
    minimax_point_mm: Floats
    least_squares_point_mm: Floats
    uncertainty: BoardFrameUncertainty
    centerlines: tuple[BoardCenterline, ...]
    views: tuple[str, ...]
    rejected: tuple[RejectedView, ...]
    rms_px: float
    note: str

    def __post_init__(self) -> None:
        for name, shape in (
            ("covariance", (6, 6)),
            ("minimax_point_mm", (3,)),
            ("least_squares_point_mm", (3,)),
        ):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), shape, name)))


@dataclass(frozen=True, slots=True, eq=False)
class Measurement:
    """The measured RCM with its error, its uncertainty and everything it rests on.

    Parameters
    ----------
    rcm
        Both RCM points. ``rcm.least_squares.covariance_mm2`` is the whole covariance of the
        location: scatter of the centerlines plus calibration; of an imported rig, where the
        calibration's part is unknown, it is the scatter alone.
    uncertainty
        That covariance in its parts, and the expanded uncertainty; of an imported rig the part
        from the lines only, with the status ``"calibration unknown"``.
    poses
        Every pose of the session, used or rejected, in the session's order.
    findings
        What weakens the answer, in plain words.
    calibration
        The rig and its quality; or a rig of another program, whose quality is unknown.
    setup
        What the session says of itself.
    inputs
        SHA-256 of every file of the session that was used, by its path in the session folder;
        those behind a calibration from elsewhere stand under ``calibration.inputs``.
    software
        ``pivometer`` and the version.
    board_frame
        The same in the frame of the board under ``reference/``; `None` without such a board.
    intrinsic
        The robot's own error, apart from the instrument's; `None` in files of versions that did not
        state it.
    structure
        Where each centerline passes the least-squares point and what that follows; `None` in files
        of versions that did not state it.
    shaft
        Whether all edges belong to one cylinder, and its diameter; `None` where too few poses tell.
    provenance
        How and when it was made; `None` in files of versions that did not state it.
    decision
        Whether it keeps a limit; `None` where none was stated.
    budget
        What each source contributes to the uncertainty; `None` where not all are known.
    floor
        The instrument's floor on a gold standard, which counts as noise here; `None` without one.
    gold_standard
        The instrument's floor as this measurement shows it, if it is one of a gold standard.
    monte_carlo
        The same uncertainties by drawing; `None` where that was not asked for.
    camera_movements
        Whether each camera stood still, as the scenery tells; without those that show too little of
        it.
    """

    rcm: RcmSolution
    uncertainty: LocationUncertainty | LinesUncertainty
    poses: tuple[UsedPose | RejectedPose, ...]
    findings: tuple[Finding, ...]
    calibration: Calibration | ImportedRig
    setup: Setup
    inputs: Mapping[str, str]
    software: str
    board_frame: BoardFrame | None = None
    intrinsic: IntrinsicError | None = None
    structure: ErrorStructure | None = None
    shaft: ShaftAgreement | None = None
    provenance: Provenance | None = None
    decision: LimitDecision | None = None
    budget: UncertaintyBudget | None = None
    floor: InstrumentFloor | None = None
    gold_standard: InstrumentFloor | None = None
    monte_carlo: MonteCarlo | None = None
    camera_movements: tuple[CameraMovement, ...] = ()

    @property
    def reference_camera(self) -> str:
        """The camera whose frame all coordinates are in."""
        return self.calibration.rig.reference

    @property
    def used(self) -> tuple[UsedPose, ...]:
        """The poses that count."""
        return tuple(pose for pose in self.poses if isinstance(pose, UsedPose))

    @property
    def rejected(self) -> tuple[RejectedPose, ...]:
        """The poses that do not count."""
        return tuple(pose for pose in self.poses if isinstance(pose, RejectedPose))
