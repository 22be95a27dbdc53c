"""What is said of several results, and what is not."""

import json
from dataclasses import replace

import numpy as np
import pytest

from pivometer import pipeline
from pivometer.errors import UsageError
from pivometer.io.result import result_text
from pivometer.pipeline.comparing import write_comparison
from pivometer.uncertainty.intrinsic import IntrinsicError


def named(measurement, name, **changes):
    """The measurement as one of other pictures."""
    inputs = {f"shaft/left/{i}.png": f"{name}{i}" for i in range(3)}
    setup = replace(measurement.setup, session=name)
    return replace(measurement, inputs=inputs, setup=setup, **changes)


def moved(measurement, by_mm):
    squares = measurement.rcm.least_squares
    there = replace(squares, point_mm=squares.point_mm + by_mm)
    return replace(measurement, rcm=replace(measurement.rcm, least_squares=there))


@pytest.fixture(scope="module")
def results(make_measurement):
    return {
        "before": named(make_measurement(count=30), "before"),
        "after": named(make_measurement(count=30, miss_mm=0.3), "after"),
        "more": named(make_measurement(count=50), "more"),
    }


def only(results, *names):
    return pipeline.compare({name: results[name] for name in names}).pairs[0]


def test_a_robot_three_times_as_bad_is_called_worse(results):
    pair = only(results, "before", "after")
    assert pair.differ
    assert pair.rms.value == pytest.approx(3, rel=0.2)
    assert "after is worse" in pair.statements[0]


def test_equal_robots_are_not_called_different(results):
    pair = only(results, "before", "more")
    assert not pair.rms.differs
    assert "no difference is shown" in pair.statements[0]


def test_largest_misses_of_unequal_numbers_are_not_compared(results):
    text = " ".join(only(results, "before", "more").statements)
    assert "are not compared: the largest of more poses is larger by chance alone" in text
    assert "are not compared: the largest" not in " ".join(
        only(results, "before", "after").statements
    )


def test_one_calibration_moves_both_locations_alike(results):
    # All but the scatter of the lines drops out where both saw nearly the same.
    one = results["before"]
    pair = pipeline.compare({"one": one, "two": named(one, "two")}).pairs[0]
    lines = 2 * one.uncertainty.lines_mm2
    np.testing.assert_allclose(pair.location.covariance_mm2, lines, atol=1e-12)
    assert not pair.location.differs
    light = np.diag([0.01, 0.02, 0.03])  # each session has its own
    lit = replace(one.uncertainty, shading_mm2=light, total_mm2=one.uncertainty.total_mm2 + light)
    pair = pipeline.compare({"one": one, "lit": named(one, "lit", uncertainty=lit)}).pairs[0]
    np.testing.assert_allclose(pair.location.covariance_mm2, lines + light, atol=1e-12)
    far = moved(named(one, "far"), [0.5, 0.0, 0.0])
    pair = pipeline.compare({"one": one, "far": far}).pairs[0]
    assert pair.location.differs
    assert "it lies elsewhere" in " ".join(pair.statements)


def test_locations_in_different_frames_are_not_compared(results, make_measurement):
    other = named(make_measurement(count=30, cameras=("left", "right", "middle")), "other")
    pair = pipeline.compare({"one": results["before"], "other": other}).pairs[0]
    assert pair.location is None
    assert "they are in different frames" in " ".join(pair.statements)


def test_a_board_that_stayed_gives_one_frame(with_board_frame, make_measurement):
    one = named(with_board_frame, "one")
    two = named(with_board_frame, "two")
    pair = pipeline.compare({"one": one, "two": two}).pairs[0]
    total = 2 * one.board_frame.uncertainty.total_mm2
    np.testing.assert_allclose(pair.location.covariance_mm2, total)
    assert "the reference board stood in the same place" in " ".join(pair.assumptions)


def test_the_same_pictures_get_no_test_of_chance(results):
    pair = pipeline.compare({"joint": results["before"], "paper": results["before"]}).pairs[0]
    assert pair.rms is None
    assert pair.location is None
    assert "no test of chance applies" in pair.statements[0]


def test_the_robots_own_is_compared_where_both_state_it(results):
    def own(rms, low, high):
        return IntrinsicError(rms, [low, high], [0.0, 1.0], 0.01, 0.95, 0.9, 0.95)

    one = replace(results["before"], intrinsic=own(0.1, 0.09, 0.11))
    two = replace(results["more"], intrinsic=own(0.2, 0.18, 0.22))
    pair = pipeline.compare({"one": one, "two": two}).pairs[0]
    assert pair.own_rms.value == pytest.approx(2.0)
    assert any("Apart from the instrument’s noise" in text for text in pair.statements)


def test_several_statements_hold_together(results):
    assert pipeline.compare(results).coverage == pytest.approx(0.975)
    assert "97.5 % interval" in pipeline.compare(results).pairs[0].statements[0]


def test_written_as_page_and_json(results, tmp_path):
    hostile = '<script>alert("x")</script>'
    compared = pipeline.compare({hostile: results["before"], "after": results["after"]})
    files = write_comparison(compared, tmp_path)
    page = files["comparison.html"].read_text(encoding="utf-8")
    assert hostile not in page
    assert "://" not in page
    assert "<script" not in page
    content = json.loads(files["comparison.json"].read_text(encoding="utf-8"))
    assert content["pairs"][0]["rms"]["value"] == compared.pairs[0].rms.value


def test_results_are_read_from_files_and_sessions(results, tmp_path):
    (tmp_path / "s" / "results").mkdir(parents=True)
    for path, name in (
        (tmp_path / "s/results/result.json", "before"),
        (tmp_path / "b.json", "more"),
    ):
        path.write_text(result_text(results[name]), encoding="utf-8")
    assert [*pipeline.results_at([tmp_path / "s", tmp_path / "b.json"])] == ["before", "more"]
    with pytest.raises(UsageError, match="named twice"):
        pipeline.results_at([tmp_path / "s", tmp_path / "s"])
    with pytest.raises(UsageError, match="holds no result"):
        pipeline.results_at([tmp_path])
    with pytest.raises(UsageError, match="nothing to be compared with"):
        pipeline.compare({"one": results["before"]})
