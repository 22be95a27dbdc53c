"""The demo, as ``make demo`` runs it: the answer must be as good as it says."""

import numpy as np
import pytest

from pivometer import pipeline


@pytest.fixture(scope="module")
def outcome(tmp_path_factory):
    return pipeline.demo(tmp_path_factory.mktemp("demo") / "session")


def test_the_truth_is_inside_the_stated_region(outcome):
    assert outcome.inside_95


def test_no_pose_is_lost(outcome):
    assert outcome.measurement.rejected == ()


def test_the_error_is_the_truths(outcome):
    # The paper's gold standard gives .391 and .145 mm; a shaft edge that is 0.1 px off moves a
    # centerline by .05 mm here.
    ours, truth = outcome.measurement.rcm, outcome.truth
    assert ours.least_squares.rms_mm == pytest.approx(truth.least_squares.rms_mm, abs=0.05)
    assert ours.minimax.max_mm == pytest.approx(truth.minimax.max_mm, abs=0.05)


def test_everything_is_on_disk(outcome):
    folder = outcome.report.parent
    assert {path.name for path in folder.iterdir()} == {
        "centerlines.csv",
        "report.html",
        "result.json",
        "rig.json",
    }


def test_both_ways_to_the_centerlines_normal_agree(outcome):
    from pivometer.shaft.silhouette import centerline_normal_algebraic, centerline_normal_average

    normals = np.array([edges.normals for pose in outcome.measurement.used for edges in pose.edges])
    np.testing.assert_allclose(
        centerline_normal_algebraic(normals), centerline_normal_average(normals), atol=1e-12
    )
