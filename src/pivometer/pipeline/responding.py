"""What the edges of the board tell of each camera's response, and what that means for a shaft."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from pivometer.calibration import BoardView, Calibration
from pivometer.calibration.response import (
    CameraResponse,
    EdgeBends,
    camera_response,
    edge_bends,
)
from pivometer.io.images import HashedImage
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.reading import Progress, ReadImage, in_threads
from pivometer.rcm import Finding
from pivometer.shaft.edges import ShaftEdges
from pivometer.shaft.fitting.response import SHIFT_BLURS

MOST_VIEWS = 12
"""Views of each camera that are looked at: enough to know κ to 0.01, of JPEG files to 0.03."""
LINEAR_ADVICE = (
    "record boards and shaft with gamma 1, as PNG or TIFF, without sharpening; do not correct "
    "square_mm by the shaft's diameter"
)


def with_responses(
    calibration: Calibration, reads: Sequence[ReadImage], progress: Progress | None = None
) -> Calibration:
    """Add to a calibration what its board images say of each camera's response."""
    images = {
        (one.file.camera, one.file.view): one.outcome.image
        for one in reads
        if isinstance(one.outcome, HashedImage)
    }
    chosen = [
        view
        for camera in calibration.cameras
        for view in _spread([v for v in calibration.views if v.camera == camera.name])
    ]

    def bends(view: BoardView) -> EdgeBends | None:
        return edge_bends(images[view.camera, view.view], view, calibration.board)

    found = in_threads(bends, chosen, "judging the cameras' response", progress)
    seen = {
        camera.name: [
            edges
            for view, edges in zip(chosen, found, strict=True)
            if edges is not None and view.camera == camera.name
        ]
        for camera in calibration.cameras
    }
    cameras = tuple(replace(c, response=camera_response(seen[c.name])) for c in calibration.cameras)
    told = replace(calibration, cameras=cameras)
    notes = (f"camera {name} {_what(response)}" for name, response in bent_cameras(told).items())
    return replace(told, notes=(*calibration.notes, *notes))


def _spread(views: Sequence[BoardView]) -> list[BoardView]:
    places = np.linspace(0, len(views) - 1, min(MOST_VIEWS, len(views)))
    return [views[i] for i in np.unique(np.rint(places).astype(np.intp))]


def bent_cameras(calibration: Calibration | ImportedRig) -> dict[str, CameraResponse]:
    """Return the cameras that are seen not to record light linearly, by name."""
    if isinstance(calibration, ImportedRig):
        return {}
    return {
        camera.name: camera.response
        for camera in calibration.cameras
        if camera.response is not None and not camera.response.linear
    }


def moved_outward_px(
    calibration: Calibration | ImportedRig, edges: Sequence[Sequence[ShaftEdges]]
) -> list[float]:
    """Return how far each camera's response moves both edges of a shaft apart or together, px.

    The board tells how much, but the shaft's contrast tells which way: it is a standard uncertainty
    of the diameter, and moves no centerline.
    """
    bent = bent_cameras(calibration)
    blurs = {
        name: [one.blur_px for pose in edges for one in pose if one.camera == name] for name in bent
    }
    moved = {
        name: SHIFT_BLURS * abs(response.bend) * float(np.median(blurs[name]))
        for name, response in bent.items()
        if blurs[name]
    }
    return [moved.get(camera.name, 0.0) for camera in calibration.rig.cameras]


def _what(response: CameraResponse) -> str:
    as_with = f"of about {response.gamma:.1f}" if response.bend > 0 else "below 1"
    return (
        f"does not record light linearly: the edges of the board rise as with a gamma {as_with} "
        f"(κ {response.bend:.2f} ± {2 * response.bend_u:.2f}, k = 2)"
    )


def response_findings(measurement: Measurement) -> list[Finding]:
    """Say which cameras do not record light linearly, and what is wrong by it."""
    bent = bent_cameras(measurement.calibration)
    return [_finding(name, response) for name, response in bent.items()]


def _finding(name: str, response: CameraResponse) -> Finding:
    dark, bright = ("thin", "thick") if response.bend > 0 else ("thick", "thin")
    return Finding(
        "warning",
        f"camera {name} {_what(response)}. A dark shaft before something bright measures too "
        f"{dark} in it, a bright one before something dark too {bright}, which the uncertainty of "
        "the diameter holds; the centerlines stay",
        LINEAR_ADVICE,
    )
