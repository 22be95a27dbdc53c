"""The pictures of a report: small ones of the shaft images, and the grey levels across edges."""

from __future__ import annotations

import numpy as np

from pivometer.errors import ImageError
from pivometer.io.session import Session
from pivometer.measurement import Measurement
from pivometer.pipeline.reading import Progress, ReadImage, streamed
from pivometer.report.embedding import Key
from pivometer.report.thumbnails import Thumbnail, make_thumbnail
from pivometer.shaft.across import EdgeProfiles, profiles_across
from pivometer.shaft.finding.background import sampled

MOST_PICTURES = 300
"""Pictures of each camera in a report; a video has thousands of frames."""


def shaft_pictures(
    measurement: Measurement, session: Session, progress: Progress | None = None
) -> tuple[dict[Key, Thumbnail], dict[Key, EdgeProfiles]]:
    """Make small pictures of the shaft images that can be read, at most some of a camera's.

    Where edges were fitted, the grey levels across them are looked up in the same pass.
    """
    edges = {(pose.pose, one.camera): one for pose in measurement.poses for one in pose.edges}
    cameras = {camera.name: camera for camera in measurement.calibration.rig.cameras}

    def picture(frame: ReadImage) -> tuple[Thumbnail, EdgeProfiles | None] | None:
        outcome = frame.outcome
        if isinstance(outcome, ImageError):
            return None
        found = edges.get((frame.stem, frame.file.camera))
        return make_thumbnail(outcome.image), (
            None if found is None else profiles_across(outcome.image, found, cameras[found.camera])
        )

    shown = [list(session.shaft_images(name)) for name in session.cameras]
    files = [images[i] for images in shown for i in sampled(len(images), MOST_PICTURES)]
    made = streamed(picture, files, "drawing the report", progress)
    thumbnails, profiles = {}, {}
    for file, drawn in zip(files, made, strict=True):
        key = (file.stem, file.camera)
        if drawn is not None:
            thumbnails[key] = drawn[0]
            if drawn[1] is not None:
                profiles[key] = _rounded(drawn[1])
    return thumbnails, profiles


def _rounded(profiles: EdgeProfiles) -> EdgeProfiles:
    """Round grey levels to a hundredth, which no plot resolves: the report carries them."""
    return EdgeProfiles(
        profiles.distance_px, np.round(profiles.grey, 2), np.round(profiles.fitted, 2)
    )
