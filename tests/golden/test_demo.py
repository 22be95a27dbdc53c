"""The demo, as ``make demo`` runs it: the answer must be as good as it says."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest

from pivometer import pipeline
from pivometer.cli import main
from pivometer.io.result import seal_of, text_of
from pivometer.report.pdf import pdf_extra_is_there


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
        *(["report.pdf"] if pdf_extra_is_there() else []),
        "result.json",
        "rig.json",
    }


def test_both_ways_to_the_centerlines_normal_agree(outcome):
    from pivometer.shaft.silhouette import centerline_normal_algebraic, centerline_normal_average

    normals = np.array([edges.normals for pose in outcome.measurement.used for edges in pose.edges])
    np.testing.assert_allclose(
        centerline_normal_algebraic(normals), centerline_normal_average(normals), atol=1e-12
    )


# --- The report verified ---


def status(found):
    return {one.name: one.status for one in found.examined}


def text(found, name):
    return next(one.text for one in found.examined if one.name == name)


@pytest.fixture
def copied(outcome, tmp_path):
    """The session with its results, to be spoilt."""
    root = tmp_path / "copy"
    shutil.copytree(outcome.report.parents[1], root)
    return root


def change(path: Path, old: str, new: str) -> None:
    content = path.read_text(encoding="utf-8")
    assert old in content
    path.write_text(content.replace(old, new, 1), encoding="utf-8")


def test_an_untouched_report_is_verified_to_the_last_bit(outcome):
    found = pipeline.verify(outcome.report)
    assert set(status(found).values()) == {"holds"}
    assert "to the last bit" in text(found, "the figures")
    assert found.exit_code == 0


def test_one_digit_of_the_page_is_found_and_its_place_named(outcome, tmp_path):
    path = Path(shutil.copy(outcome.report, tmp_path))
    change(path, "mm rms). The", "mm rms), The")
    found = pipeline.verify(path, file_only=True)
    assert status(found)["the displayed figures"] == "changed"
    assert "in “Verdict”" in text(found, "the displayed figures")
    assert "mm rms), The" in text(found, "the displayed figures")
    assert status(found)["the carried result"] == "holds"
    assert found.exit_code == 4


def test_one_letter_of_a_picture_is_found_and_the_pose_named(outcome, tmp_path):
    path = Path(shutil.copy(outcome.report, tmp_path))
    page = path.read_text(encoding="utf-8")
    at = page.index("data:image/jpeg;base64,") + 400
    path.write_text(page[:at] + ("A" if page[at] != "A" else "B") + page[at + 1 :], "utf-8")
    found = pipeline.verify(path, file_only=True)
    assert text(found, "the pictures") == "not those recorded: left/000"
    assert found.exit_code == 4


def test_the_pdf_carries_all_that_is_needed_to_verify_it(outcome, tmp_path):
    pytest.importorskip("typst", reason="the extra pdf is not installed")
    path = Path(shutil.copy(outcome.report.with_suffix(".pdf"), tmp_path))
    found = pipeline.verify(path, file_only=True)
    assert [*status(found).values()] == ["holds"] * 4
    content = path.read_bytes()
    at = content.index(b"/MediaBox")  # of the first page
    at = content.index(b"stream\n", content.index(b"/Contents", at)) + 400
    path.write_bytes(content[:at] + bytes([content[at] ^ 1]) + content[at + 1 :])
    found = pipeline.verify(path, file_only=True)
    assert found.exit_code == 4
    assert f"differs from byte {at}" in found.examined[-2].text


def test_a_picture_that_is_not_the_sessions_is_found_by_drawing_it_again(
    copied, monkeypatch, outcome
):
    """All hashes fit: the whole page was made anew around another picture."""
    from pivometer.pipeline import verifying
    from pivometer.pipeline.picturing import shaft_pictures
    from pivometer.pipeline.reporting import page_of, report_of
    from pivometer.report.embedding import SimulatedTruth, record_of

    monkeypatch.setattr(verifying, "measure", lambda *_, **__: outcome.measurement)
    thumbnails, profiles = shaft_pictures(outcome.measurement, pipeline.load(copied))
    thumbnails["003", "left"] = thumbnails["004", "left"]
    squares = outcome.truth.least_squares
    truth = SimulatedTruth(squares.point_mm + 0.01, squares.max_mm, squares.rms_mm)
    record = record_of(thumbnails, profiles, truth)
    path = copied / "results" / "report.html"
    report = report_of(outcome.measurement, record, thumbnails.values())
    path.write_text(page_of(report), encoding="utf-8")
    found = pipeline.verify(path)
    assert {name for name, state in status(found).items() if state != "holds"} == {
        "the pictures against the session",
        "the simulated truth",
    }
    assert text(found, "the pictures against the session").endswith(": left/003")


def test_one_digit_of_the_result_is_found(copied):
    path = copied / "results" / "result.json"
    stated = json.loads(path.read_text(encoding="utf-8"))["rcm"]["minimax"]["max_mm"]
    change(path, repr(stated), repr(stated + 0.001))
    found = pipeline.verify(path, file_only=True)
    assert status(found) == {"the bytes": "holds", "the result’s own SHA-256": "changed"}


def test_a_digit_changed_with_its_hash_is_found_by_measuring_again(copied, monkeypatch, outcome):
    from pivometer.pipeline import verifying

    monkeypatch.setattr(verifying, "measure", lambda *_, **__: outcome.measurement)
    path = copied / "results" / "result.json"
    content = json.loads(path.read_text(encoding="utf-8"))
    content["rcm"]["minimax"]["max_mm"] += 2e-6 * content["rcm"]["minimax"]["max_mm"]
    content["sha256"] = seal_of(content)
    path.write_text(text_of(content), encoding="utf-8")
    found = pipeline.verify(path)
    assert status(found)["the result’s own SHA-256"] == "holds"
    assert status(found)["the figures"] == "changed"
    assert text(found, "the figures").startswith("rcm.minimax.max_mm: the file states")
    assert found.exit_code == 4


@pytest.mark.parametrize("name", ["shaft/right/003.png", "session.toml", "board/left/000.png"])
def test_one_byte_of_an_input_is_found_and_the_file_named(copied, name, capsys):
    content = bytearray((copied / name).read_bytes())
    content[len(content) // 2] ^= 1
    (copied / name).write_bytes(content)
    assert main(["verify", str(copied / "results" / "report.html"), str(copied)]) == 4
    assert name in capsys.readouterr().out


def test_a_missing_input_is_named(copied):
    (copied / "shaft/left/001.png").unlink()
    found = pipeline.verify(copied / "results" / "result.json")
    assert text(found, "the inputs") == "shaft/left/001.png (missing)"


def test_without_the_session_it_says_what_it_could_not_check(outcome, tmp_path):
    found = pipeline.verify(shutil.copy(outcome.report, tmp_path))
    assert [name for name, state in status(found).items() if state == "not checked"] == [
        "the inputs",
        "the figures",
    ]
    assert found.exit_code == 5


def test_a_page_of_another_version_is_not_compared(outcome, monkeypatch):
    from pivometer.pipeline import examining

    monkeypatch.setattr(examining, "software", lambda: "pivometer 9.9")
    found = pipeline.verify(outcome.report, file_only=True)
    assert status(found)["the displayed figures"] == "not checked"
    assert found.exit_code == 5


def test_a_damaged_file_is_changed_and_another_file_is_wrong_usage(copied, tmp_path, capsys):
    path = copied / "results" / "result.json"
    path.write_bytes(path.read_bytes()[:-100])
    assert main(["verify", str(path)]) == 4
    other = tmp_path / "notes.txt"
    other.write_text("no result", encoding="utf-8")
    assert main(["verify", str(other)]) == 2
    assert "holds no result of Pivometer" in capsys.readouterr().err


def test_inputs_outside_the_session_are_not_read(outcome, tmp_path):
    from pivometer.pipeline.verifying import _inputs

    secret = tmp_path / "secret"
    secret.write_bytes(b"")
    assert _inputs({"../secret": "0" * 64}, tmp_path / "s").text == "../secret (missing)"


def test_a_calibration_from_elsewhere_is_checked_only_where_it_is_named(
    copied, monkeypatch, outcome
):
    from dataclasses import replace

    from pivometer.io.result import result_text
    from pivometer.pipeline import verifying

    made = outcome.measurement
    options = replace(made.provenance.options, rig_given=True)
    given = replace(made, provenance=replace(made.provenance, options=options))
    rigs = []
    monkeypatch.setattr(verifying, "measure", lambda *_, rig, **__: rigs.append(rig) or given)
    path = copied / "results" / "result.json"
    path.write_text(result_text(given), encoding="utf-8")
    found = pipeline.verify(path)
    assert status(found)["the calibration"] == "not checked"
    assert found.exit_code == 5
    assert pipeline.verify(path, rig=made.calibration).exit_code == 0
    assert rigs[1] is made.calibration


def test_a_session_that_is_not_there_is_wrong_usage(outcome, tmp_path, capsys):
    assert main(["verify", str(outcome.report), str(tmp_path / "none")]) == 2
    assert "is no folder" in capsys.readouterr().err
