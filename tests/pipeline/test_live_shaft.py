"""The shaft while poses are taken, against the truth of rendered pictures."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from pivometer import pipeline
from pivometer.cameras import Camera, Rig
from pivometer.errors import TooFewPosesError
from pivometer.io.images import read_image
from pivometer.io.session import Session
from pivometer.measurement import ImportedRig
from pivometer.pipeline.live_shaft import LiveShaft, is_new_pose
from pivometer.simulation.presets import gold

POSES = 5


def half(camera: Camera) -> Camera:
    """The same view on a quarter of the pixels: pixel centres at (x + 1/2)/2 − 1/2."""
    centre = (camera.principal_point_px + 0.5) / 2 - 0.5
    return Camera(camera.name, 320, 240, camera.focal_px / 2, centre, camera.distortion)


@pytest.fixture(scope="module")
def known(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, Rig]:
    preset = gold()
    rig = Rig([half(camera) for camera in preset.rig.cameras], preset.rig.reference_from_camera)
    folder = tmp_path_factory.mktemp("live") / "gold"
    small = replace(preset, rig=rig)
    pipeline.simulate(small, folder, poses=POSES, board_pairs=1, single_views=0, seed=3)
    (folder / "poses.csv").unlink()
    return folder, rig


def first(session: Session, count: int) -> Session:
    """The session as it was when it had so many poses."""
    return replace(session, shaft=dict(list(session.shaft.items())[:count]))


def test_poses_are_followed_as_they_come(known: tuple[Path, Rig]) -> None:
    folder, rig = known
    session = pipeline.load(folder)
    truth = json.loads((folder / "truth.json").read_text(encoding="utf-8"))
    true = np.array([pose["centerline"]["direction"] for pose in truth["poses"]])
    live = LiveShaft(ImportedRig(rig, "truth", {}))

    def images(stem: str) -> dict[str, np.ndarray]:
        return {name: read_image(file.path) for name, file in session.shaft[stem].items()}

    live.follow(first(session, 2))
    assert not live.ready  # two poses do not tell what moves
    assert live.glimpse(images("000")).direction is None
    with pytest.raises(TooFewPosesError):
        live.measured(first(session, 2))

    live.follow(first(session, 4))
    assert live.ready
    assert len(live.directions(first(session, 4))) == 4
    seen = live.glimpse(images("004"))  # a pose that is not in the folder yet
    assert seen.direction is not None
    assert set(seen.edges_px) == {"left", "right"}
    away = np.degrees(np.arccos(abs(seen.direction @ true[4])))
    # Edges good to 2 px over some 60 px of shaft: a few degrees at the worst.
    assert away < 4
    assert is_new_pose(seen.direction, live.directions(first(session, 4)))

    live.follow(session)
    fitted = live.directions(session)
    cosines = np.abs(np.sum(fitted * true, axis=1))
    assert np.degrees(np.arccos(np.clip(cosines, 0, 1))).max() < 0.5
    assert not is_new_pose(true[4], fitted)
    assert live.fault_of("004") is None

    measured = live.measured(session)
    pivot = pipeline.true_rcm(folder).least_squares.point_mm
    off = measured.rcm.least_squares.point_mm - pivot
    assert (np.abs(off) < 2 * measured.uncertainty.expanded_mm).all()
    assert [pose.pose for pose in measured.used] == list(session.shaft)

    # A pose that is taken out counts no more, and is named with the reason.
    out = pipeline.exclude(session, "shaft/002", "a hand before the lens")
    assert len(live.directions(out)) == POSES - 1
    again = live.measured(out)
    assert [pose.pose for pose in again.used] == ["000", "001", "003", "004"]
    assert again.rejected[0].reason == "excluded by hand: a hand before the lens"

    other = {name: image[:-1] for name, image in images("000").items()}
    assert "another size" in live.glimpse(other).reasons["left"]


def test_measuring_honours_the_log_of_exclusions(known: tuple[Path, Rig]) -> None:
    folder, rig = known
    session = pipeline.load(folder)
    if "shaft/002" not in session.excluded:
        session = pipeline.exclude(session, "shaft/002", "a hand before the lens")
    imported = ImportedRig(rig, "truth", {})
    seen = pipeline.see_shafts(session, rig)
    assert set(seen.edges["left"]) == set(session.shaft)  # looked at all the same
    measured = pipeline.measure(session, rig=imported)
    assert [pose.pose for pose in measured.rejected] == ["002"]
    assert measured.rejected[0].edges
    back = pipeline.exclude(session, "shaft/002", None)
    assert not pipeline.measure(back, rig=imported).rejected


def test_live_edges_are_those_of_a_measurement_with_an_empty_frame(
    known: tuple[Path, Rig], tmp_path: Path
) -> None:
    folder, rig = known
    copy = tmp_path / "session"
    shutil.copytree(folder, copy)
    for name, file in pipeline.load(copy).shaft["000"].items():
        shown = read_image(file.path)
        (copy / "background" / name).mkdir(parents=True)
        # What stands behind this shaft is plain.
        empty = np.full_like(shown, np.median(shown))
        cv2.imwrite(str(copy / "background" / name / "000.png"), empty)
    session, cameras = pipeline.load(copy), ImportedRig(rig, "truth", {})
    live = LiveShaft(cameras)
    live.follow(session)
    measured = pipeline.measure(session, rig=cameras)
    seen = live.measured(session)
    np.testing.assert_array_equal(
        seen.rcm.least_squares.point_mm, measured.rcm.least_squares.point_mm
    )
    assert [pose.pose for pose in seen.used] == [pose.pose for pose in measured.used]
