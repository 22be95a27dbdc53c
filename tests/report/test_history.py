"""Results over time, from their files alone."""

import sqlite3
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing
from dataclasses import replace

import numpy as np
import pytest

from pivometer import pipeline
from pivometer.cli import main
from pivometer.errors import UsageError
from pivometer.io import history as index
from pivometer.io.result import result_text
from pivometer.measurement import Provenance
from pivometer.uncertainty.control import DRIFT_FALSE_ALARMS, drift, running_limits


@pytest.fixture(scope="module")
def texts(make_measurement):
    """Results of ten days; the last robot is twice as bad."""
    rng = np.random.default_rng(2)
    made = []
    for day in range(10):
        miss = 0.2 if day == 9 else 0.1 * np.exp(rng.normal(0, 0.02))
        one = make_measurement(count=12, miss_mm=miss)
        made.append(dated(one, day))
    return made


def dated(measurement, day, device="arm 2"):
    setup = replace(measurement.setup, session=f"day-{day}", device={"name": device})
    provenance = Provenance("pivometer measure", f"2026-10-{day + 1:02d}T09:00:00+00:00", {})
    return result_text(replace(measurement, setup=setup, provenance=provenance))


@pytest.fixture
def folder(texts, tmp_path):
    for day, text in enumerate(texts):
        path = tmp_path / f"s{9 - day}" / "results" / "result.json"
        path.parent.mkdir(parents=True)
        path.write_text(text, encoding="utf-8")
    return tmp_path


def rms(followed):
    return next(one for one in followed.series if one.quantity == "rms miss")


def test_results_come_in_the_order_of_time_by_robot(folder):
    followed = pipeline.history(folder)
    assert [point.made[-2:] for point in rms(followed).points] == [f"{d:02d}" for d in range(1, 11)]
    assert {one.device for one in followed.series} == {"arm 2"}


def test_a_robot_out_of_line_is_named_in_plain_words(folder, capsys):
    followed = pipeline.history(folder)
    assert not followed.newest_in_line
    (text,) = rms(followed).findings
    assert text.startswith("arm 2: day-9 (2026-10-10): rms miss of 0.")
    assert "above the upper limit of" in text
    assert main(["history", str(folder)]) == 1
    assert text.split(" that ")[0] in capsys.readouterr().out.replace("\n", " ")


def test_the_index_saves_reading_and_follows_the_files(folder, monkeypatch, texts):
    pipeline.history(folder)
    assert (folder / index.FILE_NAME).is_file()
    read = []
    real = index.read_result
    monkeypatch.setattr(index, "read_result", lambda path: read.append(path) or real(path))
    pipeline.history(folder)
    assert read == []
    (folder / "s0" / "results" / "result.json").unlink()
    (folder / "more-result.json").write_text(texts[9], encoding="utf-8")
    assert len(rms(pipeline.history(folder)).points) == 10
    assert [path.name for path in read] == ["more-result.json"]


def test_a_damaged_index_is_made_anew(folder):
    before = pipeline.history(folder)
    (folder / index.FILE_NAME).write_bytes(b"no database at all" * 100)
    after = pipeline.history(folder)
    assert [p.value_mm for p in rms(after).points] == [p.value_mm for p in rms(before).points]


def test_several_runs_at_once_agree(folder):
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: pipeline.history(folder), range(4)))
    values = [[point.value_mm for point in rms(one).points] for one in found]
    assert values[0] == values[1] == values[2] == values[3]
    with closing(sqlite3.connect(folder / index.FILE_NAME)) as stored:
        assert stored.execute("SELECT count(*) FROM results").fetchone() == (10,)


def test_where_nothing_can_be_written_nothing_is_stored(folder, monkeypatch):
    def refuse(*_, **__):
        raise sqlite3.OperationalError("unable to open database file")

    monkeypatch.setattr(index.sqlite3, "connect", refuse)
    assert len(rms(pipeline.history(folder)).points) == 10


def test_copies_count_once_and_other_files_are_named(folder, texts):
    (folder / "copy-result.json").write_text(texts[0], encoding="utf-8")
    (folder / "broken-result.json").write_text("{", encoding="utf-8")
    followed = pipeline.history(folder)
    assert len(rms(followed).points) == 10
    assert followed.skipped[0][0] == "broken-result.json"


def test_one_calibration_of_many_sessions_counts_once(folder):
    followed = pipeline.history(folder)
    held_out = [one for one in followed.series if "board edges" in one.quantity]
    assert [len(one.points) for one in held_out] == [1]


def test_the_order_of_calibrations_is_that_of_time():
    from pivometer.io.history import Entry
    from pivometer.pipeline.following import _series

    held_out = [0.1, 0.2, 0.1, 0.3]
    entries = [
        Entry(str(i), "", str(i), session=str(i), held_out_mm=v) for i, v in enumerate(held_out)
    ]
    (series,) = _series("", entries)
    assert [point.session for point in series.points] == ["0", "1", "3"]


def test_one_value_again_and_again_sets_no_limits():
    assert running_limits([0.1] * 8 + [0.2]) == (None,) * 9


def test_an_empty_folder_is_refused(tmp_path):
    with pytest.raises(UsageError, match="holds no result"):
        pipeline.history(tmp_path)
    with pytest.raises(UsageError, match="is no folder"):
        pipeline.history(tmp_path / "none")


def test_written_as_page_and_json(folder, tmp_path):
    files = pipeline.write_history(pipeline.history(folder), tmp_path / "out")
    page = files["history.html"].read_text(encoding="utf-8")
    assert "out of line" in page
    assert "://" not in page
    assert "<script" not in page


def test_limits_call_a_steady_robot_out_of_line_as_rarely_as_they_say():
    rng = np.random.default_rng(8)
    series = np.exp(rng.normal(0, 0.2, (4000, 9)))
    out = sum(
        not limits.holds(value)
        for values in series
        for value, limits in zip(values, running_limits(values), strict=True)
        if limits is not None
    )
    # 16 000 results: 43 expected, standard deviation 6.6.
    assert 43 - 4 * 6.6 < out < 43 + 4 * 6.6


def test_steady_series_are_rarely_called_drifting():
    rng = np.random.default_rng(9)
    called = sum(drift(np.exp(rng.normal(0, 0.2, 12))) is not None for _ in range(1000))
    assert called <= 1000 * DRIFT_FALSE_ALARMS + 4 * np.sqrt(1000 * DRIFT_FALSE_ALARMS)
    assert drift(0.1 * 1.1 ** np.arange(12)) == pytest.approx(0.1)
    assert drift(0.1 * 1.1 ** np.arange(7)) is None
