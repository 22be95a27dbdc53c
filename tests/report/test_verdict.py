from pivometer.rcm import Finding
from pivometer.report import verdict
from pivometer.report.tables import board_location_table


def test_sentence_holds_the_numbers(measurement):
    said = verdict(measurement)
    rcm = measurement.rcm
    assert said.usable
    assert "Over 70 poses the shaft's centerline misses the RCM by at most " in said.sentence
    assert f"{rcm.minimax.max_mm:.3f} mm ({rcm.least_squares.rms_mm:.3f} mm rms)" in said.sentence
    x, u = rcm.least_squares.point_mm[0], measurement.uncertainty.expanded_mm[0]
    assert f"({x:.2f} ± {u:.2f}, " in said.sentence
    assert "(95 % coverage, k = 1.98)" in said.sentence
    assert "camera “left”" in said.sentence


def test_rejected_poses_are_named(measurement):
    assert verdict(measurement).rejected == (
        "2 of 72 poses were rejected (070, 071); the reasons are below."
    )


def test_a_refusal_comes_without_any_number(make_measurement):
    said = verdict(make_measurement(count=5, findings=(Finding("refusal", "a", "b"),)))
    assert not said.usable
    assert said.sentence.startswith("The RCM could not be measured at acceptable confidence")
    assert not any(character.isdigit() for character in said.sentence)


def test_a_warning_leaves_the_answer_usable(make_measurement):
    assert verdict(make_measurement(count=5, findings=(Finding("warning", "a", "b"),))).usable


def test_the_location_is_given_in_the_reference_boards_frame_first(with_board_frame):
    said = verdict(with_board_frame)
    frame = with_board_frame.board_frame
    x, u = frame.least_squares_point_mm[0], frame.uncertainty.expanded_mm[0]
    board, _, camera = said.sentence.partition(", and at ")
    assert f"({x:.3f} ± {u:.3f}, " in board
    assert "in the frame of the reference board (95 % coverage, k = 1.98)" in board
    assert "in the frame of camera “left”" in camera


def test_the_report_tabulates_the_boards_frame(with_board_frame, measurement):
    table = board_location_table(with_board_frame)
    assert [row[0] for row in table.rows] == ["x", "y", "z"]
    assert "reference board" in table.caption
    assert "looks the same" in table.note
    assert board_location_table(measurement) is None


def test_a_limit_is_decided_in_the_report_with_its_rule(make_measurement):
    from dataclasses import replace

    from pivometer.measurement import LimitDecision
    from pivometer.report import render_html

    measurement = make_measurement(count=5)
    told = verdict(measurement)
    assert told.decision == ""
    assert "no limit is stated, so nothing is passed or failed" in told.rule
    for decision, opening in (("pass", "✓ Pass: "), ("over", "✕ Over the limit: ")):
        decided = LimitDecision(decision, "why", "the rule", 0.5, [0.1, 0.2], None, ("a: b (met)",))
        page = render_html(replace(measurement, decision=decided), thumbnails={})
        assert f"{opening}why." in page
        assert "Decision rule: the rule." in page
        assert "<li>a: b (met)</li>" in page
        assert "no limit is stated" not in page
