"""Boards that look the same after a turn: numbering the corners alike in all cameras.

A board whose squares across and down add to an even number looks the same after half a turn, so
two cameras may number it from opposite ends. Each numbering gives another relative pose of the
cameras; only the true one is the same at every moment. The poses that the moments propose are
put to a vote, in which a moment agrees where the board, carried from one camera's image to the
other's, lands on the corners found there under one of the numberings.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.result import RejectedView
from pivometer.cameras import Camera, Rig
from pivometer.errors import CalibrationError
from pivometer.geometry.rigid import RigidTransform

Tree = tuple[tuple[str, str], ...]

AGREES = 0.5
"""A moment agrees if its corners land within this fraction of the board's rms radius in the image:
a wrong numbering misses by 2 radii, poses from single good views by 0.02 to 0.1."""
PROPOSALS = 15
"""Moments that may propose a pose; with half of them wrong, all are once in 30 000 sets."""


@dataclass(frozen=True, slots=True, eq=False)
class PosedView:
    """A board view with the pose of the board in its camera's frame."""

    view: BoardView
    camera_from_board: RigidTransform


@dataclass(frozen=True, slots=True, eq=False)
class Numbering:
    """Views numbered alike, and what was done to them.

    Parameters
    ----------
    views
        The views with their poses, renumbered where necessary.
    turned
        Names of the camera and moment of those renumbered.
    rejected
        Views of moments that agree under no numbering.
    """

    views: tuple[PosedView, ...]
    turned: tuple[str, ...]
    rejected: tuple[RejectedView, ...]


def board_turns(board: Board) -> tuple[RigidTransform, ...]:
    """Return for each symmetry the motion that brings renumbered corners back, identity first.

    With ``X = board.corners_mm``, ``board_turns(board)[k] @ X[board.symmetries[k]] == X``.

    Examples
    --------
    >>> board = Board("checkerboard", (9, 7), 15.0)
    >>> turn = board_turns(board)[1]
    >>> np.abs(turn @ board.corners_mm[board.symmetries[1]] - board.corners_mm).max() < 1e-9
    np.True_
    """
    X = board.corners_mm
    centre = X.mean(axis=0)
    turns = []
    for symmetry in board.symmetries:
        moment = (X - centre).T @ (X[symmetry] - centre)
        left, _, right = np.linalg.svd(moment)
        left[:, 2] *= np.linalg.det(left) * np.linalg.det(right)
        R = left @ right
        turns.append(RigidTransform(R, centre - R @ centre))
    return tuple(turns)


def relative_pose_by_vote(
    first: Sequence[PosedView],
    second: Sequence[PosedView],
    board: Board,
    cameras: tuple[Camera, Camera],
) -> RigidTransform:
    """Return ``first_from_second`` on which most moments agree, each under some numbering.

    Parameters
    ----------
    first, second
        Views of the same moments by two cameras, in the same order.
    board
        The board.
    cameras
        The two cameras.

    Raises
    ------
    CalibrationError
        If fewer than half of the moments agree on any pose, or the moments allow two poses with
        different numberings.
    """
    turns = board_turns(board)
    moments = list(zip(first, second, strict=True))
    proposals = [
        a.camera_from_board @ (b.camera_from_board @ turn).inverse()
        for a, b in moments[:: max(1, -(-len(moments) // PROPOSALS))]
        for turn in turns
    ]
    seen = _Seen.of([b.view for b in second], board, cameras[1])
    rotations = np.array([a.camera_from_board.rotation for a in first])
    shifts = np.array([a.camera_from_board.translation_mm for a in first])
    carries = [proposal.inverse() for proposal in proposals]
    misses = np.array([seen.misses(c.rotation @ rotations, c @ shifts) for c in carries])
    scores = np.minimum(misses.min(axis=2), 1.0).mean(axis=1)
    numberings = misses.argmin(axis=2)
    best = int(np.argmin(scores))
    agreeing = misses[best].min(axis=1) < AGREES
    pair = f"cameras {cameras[0].name} and {cameras[1].name}"
    if agreeing.sum() * 2 < len(agreeing) or not agreeing.any():
        raise CalibrationError(
            f"{pair}: only {int(agreeing.sum())} of {len(agreeing)} moments agree on one relative "
            "pose",
            next_step="check that images with the same file name show the same moment and that "
            "the cameras did not move",
        )
    other = (numberings != numberings[best])[:, agreeing].any(axis=1)
    if other.any() and scores[other].min() < max(2 * scores[best], 0.02):
        raise CalibrationError(
            f"{pair}: the board looks the same after a turn and {len(agreeing)} moments fit two "
            "relative poses of the cameras",
            next_step="add images of the board at other places and tilts, or use a board with one "
            "even and one odd number of squares",
        )
    return proposals[best]


@dataclass(frozen=True, slots=True, eq=False)
class _Seen:
    """What one camera saw of the board at m moments, laid out densely."""

    board: Board
    camera: Camera
    pixels: Floats  # (m, n, 2)
    found: NDArray[np.bool_]  # (m, n)

    @classmethod
    def of(cls, views: Sequence[BoardView], board: Board, camera: Camera) -> _Seen:
        """Lay out `views`."""
        pixels = np.zeros((len(views), board.corner_count, 2))
        found = np.zeros(pixels.shape[:2], dtype=np.bool_)
        for row, view in enumerate(views):
            pixels[row, view.ids], found[row, view.ids] = view.pixels, True
        return cls(board, camera, pixels, found)

    def misses(self, rotations: Floats, translations_mm: Floats) -> Floats:
        """Return how far corners are from board poses (m of them), in board radii.

        Returns
        -------
        Root-mean-square distances over the radius of the board's image, one for each moment and
        numbering, shape (m, s); infinite where the board would be out of sight.
        """
        points = self.board.corners_mm @ np.swapaxes(rotations, 1, 2) + translations_mm[:, None]
        depth = points[..., 2:]
        normalized = points[..., :2] / np.where(depth > 0, depth, np.inf)
        sight = (depth[..., 0] > 0) & (np.abs(normalized).max(axis=2) < 10)
        image = self.camera.pixels_from_normalized(np.where(sight[..., None], normalized, 0.0))
        gaps = image[:, self.board.symmetries] - self.pixels[:, None]
        squares = np.sum(gaps**2, axis=-1) * self.found[:, None]
        spread = self.pixels - self._mean(self.pixels)[:, None]
        radius2 = np.sum(np.sum(spread**2, axis=-1) * self.found, axis=1)
        miss = np.sqrt(np.sum(squares, axis=2) / radius2[:, None])
        return np.where(sight.all(axis=1)[:, None], miss, np.inf)

    def _mean(self, points: Floats) -> Floats:
        weights = self.found / self.found.sum(axis=1, keepdims=True)
        mean: Floats = np.einsum("mn,mni->mi", weights, points)
        return mean


def numbered_alike(views: Sequence[PosedView], board: Board, rig: Rig) -> Numbering:
    """Renumber every moment's corners as the first camera (in the rig's order) has them.

    Parameters
    ----------
    views
        All views with their poses; moments of one camera pass unchanged.
    board
        The board.
    rig
        The cameras with relative poses good to a few percent of the board.

    Returns
    -------
    The renumbered views, and those of moments that agree under no numbering, with the reason.
    """
    moments: dict[str, list[PosedView]] = {}
    for posed in sorted(views, key=lambda p: rig.index(p.view.camera)):
        moments.setdefault(posed.view.view, []).append(posed)
    kept: list[PosedView] = []
    turned: list[str] = []
    rejected: list[RejectedView] = []
    turns = board_turns(board)
    for lead, *others in moments.values():
        kept.append(lead)
        frame = rig.reference_from_camera[rig.index(lead.view.camera)] @ lead.camera_from_board
        for posed in others:
            index = rig.index(posed.view.camera)
            carried = rig.reference_from_camera[index].inverse() @ frame
            seen = _Seen.of([posed.view], board, rig.cameras[index])
            misses = seen.misses(carried.rotation[None], carried.translation_mm[None])[0]
            choice = int(np.argmin(misses))
            if misses[choice] >= AGREES:
                rejected.append(_disagreement(posed.view, lead.view, float(misses[choice])))
                continue
            if choice:
                turned.append(f"{posed.view.camera} in {posed.view.view}")
                posed = _renumbered(posed, board, choice, turns[choice])
            kept.append(posed)
    return Numbering(tuple(kept), tuple(turned), tuple(rejected))


def _renumbered(posed: PosedView, board: Board, choice: int, turn: RigidTransform) -> PosedView:
    view = posed.view.renumbered(board.symmetries[choice])
    return PosedView(view, posed.camera_from_board @ turn)


def _disagreement(view: BoardView, lead: BoardView, miss: float) -> RejectedView:
    size = "more than 10" if not miss < 10 else f"{miss:.1f}"
    return RejectedView(
        view.camera,
        view.view,
        f"it does not show the board where camera {lead.camera} saw it at that moment, under any "
        f"numbering of the corners ({size} board radii off); the board moved between the two "
        "exposures or the file names do not match",
    )


def camera_tree(views: Sequence[BoardView], names: Sequence[str]) -> tuple[tuple[str, str], ...]:
    """Return pairs of cameras (known, new) that reach all cameras through most shared moments.

    Parameters
    ----------
    views
        All board views.
    names
        The cameras, the reference first.

    Raises
    ------
    CalibrationError
        If a camera shares no moment with any camera already reached; the message names it.
    """
    seen: Mapping[str, set[str]] = {n: {v.view for v in views if v.camera == n} for n in names}
    reached, tree = [names[0]], []
    while len(reached) < len(names):
        rest = [n for n in names if n not in reached]
        shared = {(a, b): len(seen[a] & seen[b]) for a in reached for b in rest}
        best = max(shared, key=lambda pair: shared[pair])
        if shared[best] == 0:
            raise CalibrationError(
                f"no image of the board was taken by camera {' or '.join(rest)} at the same moment "
                f"as by {' or '.join(reached)}",
                next_step="add images with the same file name to the board folders of both cameras",
            )
        tree.append(best)
        reached.append(best[1])
    return tuple(tree)


def require_pairs(posed: Sequence[PosedView], tree: Tree, rejected: Sequence[RejectedView]) -> None:
    """Refuse fewer than three usable moments for a pair of cameras of the tree.

    Raises
    ------
    CalibrationError
        Naming the two cameras and what was wrong with the views rejected.
    """
    for (a, b), count in pair_counts([p.view for p in posed], tree).items():
        if count < 3:
            why = "".join(f"; {r.view}, {r.camera}: {r.reason}" for r in rejected)
            raise CalibrationError(
                f"cameras {a} and {b} share {count} usable board images, at least 3 are needed"
                f"{why}",
                next_step="add images of the board taken by both cameras at the same moment, "
                "at different distances and tilts",
            )


def pair_counts(views: Sequence[BoardView], tree: Tree) -> dict[tuple[str, str], int]:
    """Return how many moments the two cameras of each pair of the tree share."""
    seen: dict[str, set[str]] = {}
    for view in views:
        seen.setdefault(view.camera, set()).add(view.view)
    return {(a, b): len(seen.get(a, set()) & seen.get(b, set())) for a, b in tree}
