"""The structure of the RCM error: where the lines pass the point, and what that follows.

A robot's own error is no noise: it follows the shaft's direction, a joint, the side from which a
pose was approached, or time. Each of these is tested, and together they are wrong about pure noise
at most once in a hundred sessions.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike

from pivometer._arrays import Floats, checked, read_only
from pivometer.rcm.cone import signed_axes
from pivometer.rcm.lines import CentredLines, centred_lines
from pivometer.rcm.patterns import Explanation, explanation
from pivometer.rcm.regressors import (
    direction_map,
    joint_regressors,
    label_steps,
    order_alternatives,
    successive_block,
)

FALSE_ALARM = 0.01
"""Probability that anything at all is said to be found where the misses are noise."""

_LEVEL = 0.5 * FALSE_ALARM
"""Half of that is spent (Holm): where some poses scatter several times as much as others, the
random signs are wrong up to twice as often as they say."""

Kind = Literal["direction", "order", "approach", "joint"]


@dataclass(frozen=True, slots=True, eq=False)
class Pattern:
    """Whether the misses follow one thing.

    Parameters
    ----------
    kind
        What kind of thing: the shaft's direction, the order of the poses, the side of approach, or
        a joint.
    name
        The joint; empty for the others.
    found
        Whether it is more than chance, with all patterns of the session together wrong about pure
        noise in 1 % of sessions.
    p_value
        Probability that chance alone explains as much, corrected for the number of patterns (Holm).
    share
        Part of the sum of squares of the misses that follows it, in [0, 1].
    rms_mm
        Rms over the poses of that part, mm.
    shift_mm, shift_u_mm
        How the point that the lines pass moves and the standard uncertainty of each coordinate,
        shape (3,), mm, frame of the lines: from the first pose to the last, across a jump, or
        between two sides of approach; zero where it is no single move.
    text
        What was found, in plain words.
    """

    kind: Kind
    name: str
    found: bool
    p_value: float
    share: float
    rms_mm: float
    shift_mm: Floats
    shift_u_mm: Floats
    text: str

    def __post_init__(self) -> None:
        for name in ("shift_mm", "shift_u_mm"):
            object.__setattr__(self, name, read_only(checked(getattr(self, name), (3,), name)))


@dataclass(frozen=True, slots=True, eq=False)
class MissComponent:
    """The misses along one direction of the view along the mean shaft.

    Parameters
    ----------
    name
        ``"along the mean shaft"``, or an axis across it.
    axis
        The direction, shape (3,), unit length, frame of the lines.
    rms_mm, max_mm
        Of the misses' component along it, mm.
    instrument_rms_mm
        What the instrument's noise alone would show of it, mm; zero where it is not known.
    """

    name: str
    axis: Floats
    rms_mm: float
    max_mm: float
    instrument_rms_mm: float

    def __post_init__(self) -> None:
        object.__setattr__(self, "axis", read_only(checked(self.axis, (3,), "axis")))


@dataclass(frozen=True, slots=True, eq=False)
class ErrorStructure:
    """Where the lines pass the least-squares point, and what that follows.

    Parameters
    ----------
    poses
        The used poses, in the session's order: that of all arrays.
    misses_mm
        From the least-squares point to the nearest point of each line, shape (n, 3), mm, frame of
        the lines.
    board_misses_mm
        The same in the reference board's frame; `None` without one.
    tilts_deg, azimuths_deg
        Direction of each line about the mean shaft: angle from it, and angle about it from the
        first axis across towards the second, shape (n,), deg.
    components
        Along the mean shaft and along two axes across it.
    times_s
        When each pose was taken, shape (n,), s; `None` where that was not stated. Order is then
        the poses' own.
    approach
        From where each pose was approached; empty where that was not stated.
    joints
        Joint values by name, shape (n,) each, in the unit of the name.
    instrument_share
        Part of the sum of squares of the misses that the instrument's noise explains, in [0, 1];
        zero where it is not known.
    calibration_rms_mm
        Rms of the misses that the calibration's uncertainty alone would cause, mm: these follow
        the direction of the shaft.
    false_alarm
        Probability that any pattern at all is found in pure noise.
    patterns
        What was tested.
    """

    poses: tuple[str, ...]
    misses_mm: Floats
    board_misses_mm: Floats | None
    tilts_deg: Floats
    azimuths_deg: Floats
    components: tuple[MissComponent, ...]
    times_s: Floats | None
    approach: tuple[str, ...]
    joints: Mapping[str, Floats]
    instrument_share: float
    calibration_rms_mm: float
    false_alarm: float
    patterns: tuple[Pattern, ...]

    def __post_init__(self) -> None:
        count = len(self.poses)
        for name in ("misses_mm", "board_misses_mm", "tilts_deg", "azimuths_deg", "times_s"):
            values, shape = getattr(self, name), (count, 3) if "misses" in name else (count,)
            if values is not None:
                object.__setattr__(self, name, read_only(checked(values, shape, name)))
        joints = {name: read_only(checked(v, (count,), name)) for name, v in self.joints.items()}
        object.__setattr__(self, "joints", joints)

    @property
    def found(self) -> tuple[Pattern, ...]:
        """The patterns that are more than chance, the largest first."""
        return tuple(sorted((p for p in self.patterns if p.found), key=lambda p: -p.share))


def error_structure(
    points_mm: ArrayLike,
    directions: ArrayLike,
    *,
    poses: Sequence[str] | None = None,
    covariances_mm2: ArrayLike | None = None,
    common_mm: ArrayLike | None = None,
    times_s: ArrayLike | None = None,
    approach: Sequence[str] = (),
    joints: Mapping[str, ArrayLike] | None = None,
) -> ErrorStructure:
    """Return the misses of lines from their least-squares point and what they follow.

    Parameters
    ----------
    points_mm, directions
        A point on each line (mm) and its direction, of any length and sign, shape (n, 3), in the
        order in which the poses were taken.
    poses
        Their names; numbers from 0 where none are given.
    covariances_mm2
        Covariance of each line's position near the RCM from the instrument's noise, (n, 3, 3), mm².
    common_mm
        Displacements of each line by one standard uncertainty of each of r sources that all lines
        share, such as the calibration, shape (n, 3, r), mm.
    times_s
        When each pose was taken, shape (n,), s: sets the order.
    approach
        From where each pose was approached, such as ``"+"``; n labels.
    joints
        Joint values, shape (n,), by name with its unit: ``_deg``, ``_rad`` or a length.

    Raises
    ------
    ShapeError, TooFewPosesError, DegenerateGeometryError
        If the lines do not determine a point.

    Examples
    --------
    >>> rng = np.random.default_rng(0)
    >>> axes = np.hstack([rng.uniform(-0.5, 0.5, (60, 2)), np.ones((60, 1))])
    >>> drifting = 0.01 * rng.standard_normal((60, 3)) + np.linspace([0, 0, 0], [0.2, 0, 0], 60)
    >>> for pattern in error_structure(drifting, axes).found:
    ...     print(pattern.kind, pattern.shift_mm.round(1) + 0.0)
    order [0.2 0.  0. ]
    """
    lines = centred_lines(points_mm, directions)
    count = len(lines.axes)
    names = tuple(poses) if poses is not None else tuple(map(str, range(count)))
    times = None if times_s is None else checked(times_s, (count,), "times_s")
    values = {name: checked(column, (count,), name) for name, column in (joints or {}).items()}
    misses = lines.offsets @ lines.turn.T
    tips, middle = signed_axes(lines.axes @ lines.turn.T)
    view = _view(middle)
    tips = tips * np.sign(middle @ view[0])
    across = tips @ view[1:].T
    noise, shared = _instrument(lines, covariances_mm2, common_mm)
    squares = float(np.square(misses).sum())
    calibration_rms = float(np.sqrt(np.square(shared).sum() / count))
    explained = float(np.trace(noise, axis1=1, axis2=2).sum() + np.square(shared).sum())
    return ErrorStructure(
        poses=names,
        misses_mm=misses,
        board_misses_mm=None,
        tilts_deg=np.degrees(np.arctan2(np.linalg.norm(across, axis=1), tips @ view[0])),
        azimuths_deg=np.degrees(np.arctan2(across[:, 1], across[:, 0])),
        components=_components(misses, view, noise, shared),
        times_s=times,
        approach=tuple(approach),
        joints=values,
        instrument_share=min(explained / squares, 1.0) if squares > 0 else 0.0,
        calibration_rms_mm=calibration_rms,
        false_alarm=FALSE_ALARM,
        patterns=_patterns(lines, across, names, times, tuple(approach), values, calibration_rms),
    )


def _view(middle: Floats) -> Floats:
    """Return the mean shaft and two axes across it, shape (3, 3): the report's view along it."""
    along = middle * np.sign(middle[np.argmax(np.abs(middle))])
    lateral = np.eye(3)[2 if abs(along[0]) > np.cos(np.radians(30)) else 0]
    right = lateral - along * (along @ lateral)
    right = right / np.linalg.norm(right)
    return np.stack([along, right, np.cross(along, right)])


def _instrument(
    lines: CentredLines, covariances_mm2: ArrayLike | None, common_mm: ArrayLike | None
) -> tuple[Floats, Floats]:
    """Return what the noise leaves in each miss, (n, 3, 3), and what all share, (n, 3, r)."""
    count = len(lines.axes)
    none = np.zeros((count, 3, 3))
    alone = none if covariances_mm2 is None else checked(covariances_mm2, (count, 3, 3), "alone")
    moved = none[:, :, :0] if common_mm is None else checked(common_mm, (count, 3, None), "common")
    across = lines.turn @ lines.projectors() @ lines.turn.T
    inverse = (lines.turn / lines.information) @ lines.turn.T
    alone = across @ alone @ across
    middle = inverse @ alone.sum(axis=0) @ inverse
    mixed = alone @ inverse @ across
    noise = alone - mixed - np.swapaxes(mixed, 1, 2) + across @ middle @ across
    moved = across @ moved
    return noise, moved - across @ (inverse @ moved.sum(axis=0))


def _components(
    misses: Floats, view: Floats, noise: Floats, shared: Floats
) -> tuple[MissComponent, ...]:
    names = ("along the mean shaft", *(f"across, nearest to {_axis_name(a)}" for a in view[1:]))
    noise = noise + shared @ np.swapaxes(shared, 1, 2)
    return tuple(
        MissComponent(
            name,
            axis,
            float(np.sqrt(np.mean(np.square(misses @ axis)))),
            float(np.abs(misses @ axis).max()),
            float(np.sqrt(max(np.mean(axis @ noise @ axis), 0.0))),
        )
        for name, axis in zip(names, view, strict=True)
    )


def _axis_name(axis: Floats) -> str:
    largest = int(np.argmax(np.abs(axis)))
    return ("+" if axis[largest] > 0 else "−") + "xyz"[largest]


# --- What the misses follow ---


@dataclass(frozen=True, slots=True, eq=False)
class _Tested:
    """One thing that was tested: what it explains, what it is called, and what it found."""

    kind: Kind
    found: Explanation
    what: str
    detail: str = ""
    joint: str = ""


def _patterns(
    lines: CentredLines,
    across: Floats,
    names: tuple[str, ...],
    times: Floats | None,
    approach: tuple[str, ...],
    joints: Mapping[str, Floats],
    calibration_rms_mm: float,
) -> tuple[Pattern, ...]:
    """Test everything, then correct for having tested everything."""
    tested: list[_Tested] = []
    known = direction_map(across)
    found = explanation(lines, [known]) if known.shape[1] else None
    if found is not None:
        tested.append(_Tested("direction", found, "the direction of the shaft"))
        # What follows the direction would also follow an order of poses that goes with it.
        beside = known if found.p_value <= FALSE_ALARM else np.zeros((len(known), 0))
        tested += [*_order(lines, beside, names, times), *_approach(lines, beside, approach)]
    for name, values in joints.items():
        regressors = joint_regressors(name, values)
        found = explanation(lines, [regressors]) if regressors.shape[1] else None
        if found is not None:
            tested.append(_Tested("joint", found, f"joint {name}", joint=name))
    corrected = _holm([one.found.p_value for one in tested])
    return tuple(
        _pattern(one, p, calibration_rms_mm) for one, p in zip(tested, corrected, strict=True)
    )


def _pattern(one: _Tested, p_value: float, calibration_rms_mm: float) -> Pattern:
    found = one.found
    # The calibration's errors are the same in all poses, so they follow directions and joints.
    instrument = one.kind in ("direction", "joint") and found.rms_mm < 2 * calibration_rms_mm
    single = one.kind == "order" or (one.kind == "approach" and len(found.coefficients_mm) == 1)
    shift = found.coefficients_mm[0] if single else np.zeros(3)
    u = np.sqrt(np.maximum(found.covariance_mm2.diagonal(), 0.0)) if single else np.zeros(3)
    if p_value > _LEVEL:
        text = f"nothing beyond chance follows {one.what}"
    elif instrument:
        text = f"what follows {one.what} is no more than errors of the calibration explain"
    else:
        text = (
            f"{100 * found.share:.0f} % of the variance of the misses ({found.rms_mm:.2g} mm rms) "
            f"follows {one.what} ({probability(p_value)}){one.detail}"
        )
    return Pattern(
        kind=one.kind,
        name=one.joint,
        found=p_value <= _LEVEL and not instrument,
        p_value=p_value,
        share=found.share,
        rms_mm=found.rms_mm,
        shift_mm=shift,
        shift_u_mm=u,
        text=text,
    )


def probability(p_value: float) -> str:
    """Print a p-value in the usual form.

    Examples
    --------
    >>> probability(0.0002), probability(0.0123)
    ('p < .001', 'p = .012')
    """
    return "p < .001" if p_value < 0.001 else f"p = {p_value:.3f}".replace("0.", ".")


def _order(
    lines: CentredLines, known: Floats, names: tuple[str, ...], times: Floats | None
) -> list[_Tested]:
    """Test for a drift with time, and for a jump between two poses."""
    order = np.arange(len(names)) if times is None else np.argsort(times, kind="stable")
    sorted_lines = lines.subset(order)
    alternatives, breaks = order_alternatives(None if times is None else times[order], len(names))
    found = explanation(sorted_lines, alternatives, known=known[order])
    if found is None:
        return []
    block = successive_block(found.left_mm)
    if block > 1:
        found = explanation(sorted_lines, alternatives, known=known[order], block=block) or found
    size = float(np.linalg.norm(found.coefficients_mm[0]))
    if found.best == 0:
        span = "" if times is None else f" and {float(np.ptp(times)) / 60:.3g} min"
        detail = f": the point they pass drifts by {size:.2g} mm over {len(names)} poses{span}"
    else:
        at = breaks[found.best - 1]
        between = f"{names[order[at - 1]]} and {names[order[at]]}"
        detail = f": the point they pass jumps by {size:.2g} mm between poses {between}"
    return [_Tested("order", found, "the order of the poses", detail)]


def _approach(lines: CentredLines, known: Floats, approach: tuple[str, ...]) -> list[_Tested]:
    labels, steps = label_steps(approach)
    found = explanation(lines, [steps], known=known) if steps.shape[1] else None
    if found is None:
        return []
    detail = ""
    if len(labels) == 2:
        size = float(np.linalg.norm(found.coefficients_mm[0]))
        detail = (
            f": from “{labels[0]}” and “{labels[1]}” the points they pass are {size:.2g} mm apart"
        )
    return [_Tested("approach", found, "the side of approach", detail)]


def _holm(p_values: Sequence[float]) -> list[float]:
    """Correct p-values for their number, so that all together keep the level.

    Examples
    --------
    >>> _holm([0.01, 0.5, 0.02])
    [0.03, 0.5, 0.04]
    """
    order = np.argsort(p_values, kind="stable")
    corrected, largest = [0.0] * len(p_values), 0.0
    for rank, index in enumerate(order):
        largest = max(largest, min(1.0, (len(p_values) - rank) * p_values[index]))
        corrected[index] = largest
    return corrected
