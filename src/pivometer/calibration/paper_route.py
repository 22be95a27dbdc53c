"""The paper's route: each camera alone, (19) under (20) for each pair of cameras, then (21)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from pivometer._arrays import Floats
from pivometer.calibration.board import Board, BoardView
from pivometer.calibration.half_turn import Tree
from pivometer.calibration.intrinsics import CameraCalibration, recalibrated
from pivometer.calibration.metric_scale import length_error, metric_scale, reconstructed_edges
from pivometer.calibration.quality import epipolar_rms, matched_points, shared_moments
from pivometer.calibration.result import PaperRoute
from pivometer.calibration.two_view import bundle_adjust, eight_point, pose_from_essential
from pivometer.cameras import Camera, Rig
from pivometer.geometry.rigid import RigidTransform


def chained_rig(
    relative: Mapping[tuple[str, str], RigidTransform], cameras: Mapping[str, Camera]
) -> Rig:
    """Chain ``known_from_new`` along the tree into poses in the reference camera's frame."""
    names = list(cameras)
    poses = {names[0]: RigidTransform.identity()}
    for (known, new), known_from_new in relative.items():
        poses[new] = poses[known] @ known_from_new
    return Rig([cameras[n] for n in names], [poses[n] for n in names])


@dataclass(frozen=True, slots=True, eq=False)
class UsedViews:
    """The views that count, and the paper's route over any part of them."""

    views: tuple[BoardView, ...]
    board: Board
    alone: Mapping[str, CameraCalibration]
    tree: Tree
    weighted: bool

    @property
    def moments(self) -> list[str]:
        """Names of all moments, in order."""
        return list(dict.fromkeys(view.view for view in self.views))

    def paper_rig(self, moments: Sequence[str], start: Rig | None = None) -> Rig:
        """Return the paper's rig from the named moments only, faster near a start."""
        kept = set(moments)
        views = [view for view in self.views if view.view in kept]
        cameras = {n: self._camera(n, moments) for n in self.alone}
        relative = {
            (a, b): self._metric_pose(views, (cameras[a], cameras[b]), start) for a, b in self.tree
        }
        return chained_rig(relative, cameras)

    def _camera(self, name: str, moments: Sequence[str]) -> Camera:
        calibration = self.alone[name]
        if {v.view for v in calibration.views} <= set(moments):
            return calibration.camera
        return recalibrated(calibration, self.board, moments, weighted=self.weighted)

    def _metric_pose(
        self,
        views: Sequence[BoardView],
        cameras: tuple[Camera, Camera],
        start: Rig | None,
    ) -> RigidTransform:
        """Return ``known_from_new``, mm: eight-point, (19) under (20), then (21)."""
        pair = [camera.name for camera in cameras]
        first, second = matched_points(views, *cameras)
        if start is None:
            pose = pose_from_essential(eight_point(first, second), first, second)
        else:
            known, new = (start.reference_from_camera[start.index(n)] for n in pair)
            pose = known.inverse() @ new
        weights = (float(cameras[0].focal_px.mean()), float(cameras[1].focal_px.mean()))
        unit = bundle_adjust(pose, first, second, weights=weights).first_from_second
        rig = Rig(cameras, [RigidTransform.identity(), unit])
        both = [view for view in views if view.camera in pair]
        scale = metric_scale(reconstructed_edges(both, self.board, rig), self.board.square_mm)
        return RigidTransform(unit.rotation, scale * unit.translation_mm)

    def paper_route(self) -> PaperRoute:
        """Return the paper's rig from all views, and its Table I figures."""
        rig = self.paper_rig(self.moments)
        lengths = reconstructed_edges(self.views, self.board, rig)
        error = length_error(lengths, self.board.square_mm)
        return PaperRoute(rig, error, epipolar_rms(self.views, rig))


def jackknife_covariance(used: UsedViews, rig: Rig) -> tuple[Floats, int]:
    """Return the covariance of the paper's rig from leaving out moments, and its rank.

    The two steps have no common cost function, so there is no information matrix; the jackknife
    needs none, and counts errors common to all corners of a view. Moments of one camera and of
    several are strata of their own.

    References
    ----------
    Efron and Tibshirani, "An introduction to the bootstrap", chapter 11.
    """
    total, rank = np.zeros((len(rig.parameter_names),) * 2), 0
    shared = set(shared_moments(used.views))
    moments = used.moments
    strata = [[m for m in moments if m in shared]]
    singles: dict[str, list[str]] = {}
    for view in used.views:
        if view.view not in shared:
            singles.setdefault(view.camera, []).append(view.view)
    for stratum in strata + list(singles.values()):
        if len(stratum) < 2:
            continue
        deltas = np.array(
            [
                rig.difference(used.paper_rig([m for m in moments if m != out], rig))
                for out in stratum
            ]
        )
        deltas -= deltas.mean(axis=0)
        total += (len(stratum) - 1) / len(stratum) * deltas.T @ deltas
        rank += len(stratum) - 1
    return total, rank


def shrunk_covariance(jackknife: Floats, rank: int, joint: Floats) -> Floats:
    """Return the jackknife covariance drawn towards the shape of the joint one.

    A dozen moments give a jackknife covariance of rank below the number of parameters. It is
    averaged with the joint covariance, scaled to the jackknife's mean size, as if that had been
    seen in as many moments as there are parameters (the mean of an inverse-Wishart posterior).

    References
    ----------
    Haff (1980), "Empirical Bayes estimation of the multivariate normal covariance matrix",
    doi:10.1214/aos/1176345010.
    """
    count = len(joint)
    size = float(np.trace(np.linalg.solve(joint, jackknife))) / count
    return (rank * jackknife + count * max(1.0, size) * joint) / (rank + count)
