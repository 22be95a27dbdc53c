from pathlib import Path

import numpy as np
import pytest

from pivometer.calibration import Board, Calibration, RejectedView
from pivometer.calibration.result import CameraQuality, LengthError, PaperRoute
from pivometer.cameras import Camera, Rig
from pivometer.cli.show import say, show_calibration, show_table
from pivometer.geometry import RigidTransform
from pivometer.report.tables import Table


def calibration() -> Calibration:
    cameras = [
        Camera(name, 640, 480, [1000, 1001], [320, 240], [-0.2, 0.1]) for name in ("left", "right")
    ]
    right = RigidTransform.from_rotation_vector([0, -1.5, 0], [300, 0, 400])
    rig = Rig(cameras, [RigidTransform.identity(), right])
    length = LengthError(0.241, 0.097, 984)
    uncertainties = np.array([0.8, 0.8, 1.4, 1.2, 0.002, 0.011])
    quality = tuple(
        CameraQuality(camera.name, 0.113, 16, 768, uncertainties, 0.8, 61.0, "board/007", 0.21)
        for camera in cameras
    )
    return Calibration(
        rig=rig,
        covariance=np.eye(18),
        edge_length_error=length,
        held_out=LengthError(0.263, 0.112, 984),
        cameras=quality,
        epipolar_rms_px=0.09,
        board=Board("checkerboard", (9, 7), 15.0),
        views=(),
        rejected=(RejectedView("right", "board/013", "only 31 of 48 corners [of it] are seen"),),
        notes=("3 views were turned by half a turn",),
        method="joint",
        paper=PaperRoute(rig, length, 0.1),
        noise_px=0.08,
    )


def test_nothing_is_read_as_markup(capsys: pytest.CaptureFixture[str]) -> None:
    show_table(Table("A [bold]caption", ("name", "length [mm]"), (("[red]a", "1.5"), ("b", "–"))))
    out = capsys.readouterr().out
    for text in ("A [bold]caption", "length [mm]", "[red]a"):
        assert text in out


def test_paths_are_not_broken(capsys: pytest.CaptureFixture[str]) -> None:
    path = "/a/" + "very-long-name/" * 20 + "report.html"
    say(f"report: {path}", "[b]")
    assert capsys.readouterr().out == f"report: {path}\n[b]\n"


def test_a_calibration_is_shown_with_units_and_rejections(
    capsys: pytest.CaptureFixture[str],
) -> None:
    show_calibration(calibration(), Path("s/results/rig.json"), ignored=["board/left/notes.txt"])
    lines = [" ".join(line.split()) for line in capsys.readouterr().out.splitlines()]
    for line in (
        "focal length f·s_x, px 1000.00 ± 0.80 1000.00 ± 0.80",
        "distortion k₂ = β₂ 0.100 ± 0.011 0.100 ± 0.011",
        "max, mm rms, mm edges",
        "all pairs 0.241 0.097 984",
        "held out 0.263 0.112 984",
        "Camera right stands 500.00 mm from camera left.",
        "right board/013 only 31 of 48 corners [of it] are seen",
        "note: 3 views were turned by half a turn",
        "not images, left alone: board/left/notes.txt",
        "rig: s/results/rig.json",
    ):
        assert line in lines
