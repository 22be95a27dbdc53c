"""The made-up measurement of the report's tests, with uncertainties."""

import importlib.util
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import ModuleType

import numpy as np
import pytest

from pivometer.measurement import Measurement, UsedPose

U_MM = 0.02
"""Standard uncertainty of every line's offset in both directions."""


def report_conftest() -> ModuleType:
    path = Path(__file__).resolve().parents[1] / "report" / "conftest.py"
    spec = importlib.util.spec_from_file_location("report_conftest", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def certain_as(pose: UsedPose, u_mm: float) -> UsedPose:
    """Give a pose's line an uncertainty that is the same all along it."""
    line, axis = pose.centerline, pose.centerline.direction
    first = np.cross(axis, np.eye(3)[int(np.argmin(np.abs(axis)))])
    first /= np.linalg.norm(first)
    basis = np.stack([first, np.cross(axis, first)])
    covariance = np.diag([u_mm**2, u_mm**2, 0, 0])
    return replace(pose, centerline=replace(line, basis=basis, covariance=covariance))


@pytest.fixture(scope="session")
def make_measurement() -> Callable[..., Measurement]:
    fake = report_conftest().fake_measurement

    def made(*, u_mm: float = U_MM, **options: object) -> Measurement:
        measurement = fake(**options)
        poses = tuple(
            certain_as(pose, u_mm) if isinstance(pose, UsedPose) else pose
            for pose in measurement.poses
        )
        return replace(measurement, poses=poses)

    return made
