from pivometer.rcm import Finding
from pivometer.report import verdict


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
