import inspect
import json
import os
import subprocess
import sys
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from pivometer import pipeline
from pivometer.cli import main
from pivometer.cli.front_page import FRONT_PAGE
from pivometer.errors import CalibrationError, PivometerError, SessionError

COMMANDS = (
    "demo",
    "simulate",
    "calibrate",
    "measure",
    "app",
    "export",
    "target",
    "solve",
    "pivot",
    "check",
    "verify",
    "figures",
    "compare",
    "history",
    "plan",
    "schema",
)


@dataclass
class FakeSession:
    folder: Path
    ignored: tuple[str, ...] = ()


class Calls:
    """What the commands asked of the pipeline."""

    def __init__(self) -> None:
        self.made: list[tuple[str, tuple[Any, ...], dict[str, Any]]] = []

    def record(self, name: str, answer: object) -> Callable[..., object]:
        signature = inspect.signature(getattr(pipeline, name))

        def call(*args: Any, **kwargs: Any) -> object:
            signature.bind(*args, **kwargs)  # the pipeline would take these arguments
            progress = kwargs.pop("progress", None)
            if progress is not None:
                progress("stage [mm]", 1, 2)
            self.made.append((name, args, kwargs))
            if isinstance(answer, BaseException):
                raise answer
            return answer

        return call


@pytest.fixture
def calls(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Calls:
    calls = Calls()
    answers: Mapping[str, object] = {
        "load": FakeSession(tmp_path),
        "calibrate": "calibration",
        "measure": "measurement",
        "simulate": tmp_path / "made",
        "demo": "outcome",
        "write_calibration": tmp_path / "rig.json",
        "write_target": tmp_path / "target.pdf",
        "solve_lines": "solved",
        "write_solution": tmp_path / "rcm.json",
        "write_measurement": {"report.html": tmp_path / "report.html"},
    }
    for name, answer in answers.items():
        monkeypatch.setattr(pipeline, name, calls.record(name, answer))
    for name in ("show_demo", "show_measurement", "show_calibration", "show_solution"):
        monkeypatch.setattr(f"pivometer.cli.show.{name}", lambda *_, **__: None)
    return calls


def test_version(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("pivometer ")


@pytest.mark.parametrize("arguments", [[], ["--help"], ["-h"]])
def test_the_front_page_opens_with_an_example(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(arguments) == 0
    out = capsys.readouterr().out
    assert out == FRONT_PAGE
    assert out.startswith("Example:  pivometer measure my-session\n")
    assert max(map(len, out.splitlines())) <= 80


def test_the_front_page_lists_the_commands_with_their_first_sentences() -> None:
    from pivometer.cli.app import app

    commands = {name for name in app if not name.startswith("-")}
    assert commands == set(COMMANDS)
    for name in commands:
        function = app[name].default_command
        assert function is not None
        sentence = (inspect.getdoc(function) or "").partition("\n")[0]
        assert f"  {name:11}{sentence}\n" in FRONT_PAGE


@pytest.mark.parametrize("command", COMMANDS)
def test_the_help_of_a_command_opens_with_an_example(
    command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([command, "--help"]) == 0
    assert capsys.readouterr().out.startswith(f"Example:  pivometer {command}")


def test_paragraphs_of_the_help_fill_the_terminal() -> None:
    """The source breaks these lines elsewhere."""
    code = "from pivometer.cli import main; main(['verify', '--help'])"
    told = run(code, env={"COLUMNS": "80"})
    assert "measures the\nsession again and compares every figure." in told.stdout
    assert "whoever can write a whole new result   │" in told.stdout


USUAL = {
    "hints": {},
    "centerline": "paper",
    "floor": None,
    "bearing_rms_mm": None,
    "draws": 0,
}


def test_measure_calibrates_where_no_rig_is_given(calls: Calls, tmp_path: Path) -> None:
    assert main(["measure", str(tmp_path)]) == 0
    names = [name for name, _, _ in calls.made]
    assert names == ["load", "measure", "write_measurement"]
    assert calls.made[1][2] == {"rig": None, "method": "joint", "distortion": "radial2", **USUAL}
    assert calls.made[2][1][2] == tmp_path / "results"
    assert calls.made[2][2] == {"command": f"pivometer measure {tmp_path}"}


def test_measure_hands_its_options_on(
    calls: Calls, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    asked = []
    monkeypatch.setattr(
        "pivometer.io.formats.read_any_rig",
        lambda path, **told: asked.append(told) or f"rig of {path}",
    )
    assert main(["measure", "s", "--output", str(tmp_path / "o"), "--rig", "r.json"]) == 0
    assert calls.made[1][2] == {
        "rig": "rig of r.json",
        "method": "joint",
        "distortion": "radial2",
        **USUAL,
    }
    assert asked == [{"unit_mm": None, "image_size": None}]
    assert calls.made[2][1][2] == tmp_path / "o"
    assert calls.made[2][2]["command"].endswith("--rig r.json")
    told = ["--rig", "r.yml", "--unit-mm", "25", "--image-size", "640", "480"]
    assert main(["measure", "s", *told]) == 0
    assert asked[1] == {"unit_mm": 25.0, "image_size": (640, 480)}
    assert calls.made[5][2]["command"].endswith("--unit-mm 25.0 --image-size 640 480")
    calls.made.clear()
    assert main(["measure", "s", "--method", "paper"]) == 0
    assert calls.made[1][2] == {"rig": None, "method": "paper", "distortion": "radial2", **USUAL}
    calls.made.clear()
    assert main(["measure", "s", "--centerline", "cylinder"]) == 0
    assert calls.made[1][2]["centerline"] == "cylinder"


def test_calibrate(calls: Calls, tmp_path: Path) -> None:
    assert main(["calibrate", str(tmp_path), "--method", "paper"]) == 0
    assert calls.made[1][2] == {"method": "paper", "distortion": "radial2"}
    assert main(["calibrate", str(tmp_path), "--distortion", "brown5"]) == 0
    assert calls.made[4][2] == {"method": "joint", "distortion": "brown5"}
    assert calls.made[2][1] == ("calibration", tmp_path / "results")


def test_simulate(calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["simulate", "davinci", "out", "--poses", "12", "--seed", "3"]) == 0
    assert calls.made == [("simulate", ("davinci", Path("out")), {"poses": 12, "seed": 3})]
    assert f"pivometer measure {tmp_path / 'made'}" in capsys.readouterr().out


def test_demo_has_a_folder_of_its_own(calls: Calls) -> None:
    assert main(["demo"]) == 0
    assert main(["demo", "elsewhere"]) == 0
    assert [args for _, args, _ in calls.made] == [(Path("pivometer-demo"),), (Path("elsewhere"),)]


def drawn_board(calls: Calls) -> list[object]:
    board = calls.made[-1][1][0]
    return [board.kind, board.squares, board.square_mm, board.dictionary, board.marker_mm]


def test_target(calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["target"]) == 0
    assert calls.made[0][1][1:] == (Path("target.pdf"),)
    assert calls.made[0][2] == {"paper": "A4"}
    assert drawn_board(calls) == ["checkerboard", (9, 7), 15.0, None, None]
    told = capsys.readouterr().out
    assert f"Target: {tmp_path / 'target.pdf'} (checkerboard of 9×7 squares of 15 mm)" in told
    assert "looks the same after a turn" in told


@pytest.mark.parametrize("counts", ["--squares 10 7", "--squares 10x7", "--squares=10×7"])
def test_target_takes_counts_as_people_write_them(
    counts: str, calls: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["target", *counts.split(), "b.svg", "--square-mm", "20", "--paper", "A3"]) == 0
    assert calls.made[0][1][1:] == (Path("b.svg"),)
    assert drawn_board(calls) == ["checkerboard", (10, 7), 20.0, None, None]
    assert "looks the same" not in capsys.readouterr().out


def test_target_completes_a_charuco_board(calls: Calls) -> None:
    assert main(["target", "--kind", "charuco"]) == 0
    assert drawn_board(calls)[3:] == ["DICT_4X4_50", 11.0]
    assert main(["target", "--kind", "charuco", "--square-mm", "20"]) == 0
    assert drawn_board(calls)[3:] == ["DICT_4X4_50", 14.7]
    options = ["--dictionary", "DICT_5X5_100", "--marker-mm", "12"]
    assert main(["target", "--kind", "charuco", *options]) == 0
    assert drawn_board(calls)[3:] == ["DICT_5X5_100", 12.0]


@pytest.mark.parametrize("option", ["--dictionary=DICT_5X5_100", "--marker-mm=9"])
def test_target_gives_a_checkerboard_no_markers(
    option: str, calls: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["target", option]) == 2
    assert "next:  add --kind charuco" in capsys.readouterr().err
    assert calls.made == []


def test_solve_writes_only_where_it_is_told(calls: Calls, tmp_path: Path) -> None:
    assert main(["solve", "lines.csv"]) == 0
    assert [name for name, _, _ in calls.made] == ["solve_lines"]
    assert main(["solve", "lines.csv", "--output", str(tmp_path)]) == 0
    assert calls.made[-1] == ("write_solution", ("solved", tmp_path), {})


def test_schema_is_json(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["schema"]) == 0
    assert json.loads(capsys.readouterr().out)["properties"]["rcm"]


USAGE = {
    "mesure s": 'error: Unknown command "mesure". Did you mean "measure"?',
    "simulate golden d": 'error: Invalid value "golden" for PRESET.',
    "simulate gold": 'error: Command "simulate" parameter DIR requires an argument.',
    "simulate gold d --poses 2": 'error: Invalid value "2" for --poses. Must be >= 3.',
    "simulate gold d --poses many": 'error: Invalid value for --poses: unable to convert "many"',
    "measure s --rigg r.json": "error: Unknown option: --rigg. Did you mean --rig?",
    "measure s --rig r.json --method paper": "error: --method says how to calibrate, but --rig",
    "measure s --rig r.json --distortion none": "error: --distortion says how to calibrate, but",
    "measure s --unit-mm 1": "error: --unit-mm and --image-size describe a --rig, and none is",
    "measure s --distortion wide": 'error: Invalid value "wide" for --distortion.',
    "export r.json p --to bundler": 'error: Invalid value "bundler" for --to.',
    "target --squares 9": 'error: Command "target" parameter --squares requires 2',
    "target --paper A5": 'error: Invalid value "A5" for --paper. Choose from: "A4", "A3", "Letter"',
    "target --squares 2x2": "error: a board of 2×2 squares has too few inner corners",
    "calibrate --method paper": 'error: Command "calibrate" parameter SESSION requires',
}


@pytest.mark.parametrize("typed", USAGE)
def test_wrong_usage_is_code_2(
    typed: str, calls: Calls, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(typed.split()) == 2
    told = capsys.readouterr()
    assert told.err.startswith(USAGE[typed])
    known = typed.split()[0] in COMMANDS and not any(
        ours in told.err for ours in ("says how to calibrate", "describe a --rig")
    )
    wanted = f"see pivometer {typed.split()[0]} --help" if known else ""
    assert f"\nnext:  {wanted}" in told.err
    assert told.out == ""
    assert calls.made == []


def test_results_into_a_file_are_refused_before_measuring(
    calls: Calls, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "file").write_bytes(b"")
    assert main(["measure", "s", "--output", str(tmp_path / "file")]) == 2
    assert "is a file" in capsys.readouterr().err
    assert [name for name, _, _ in calls.made] == ["load"]


FAULTS: list[tuple[PivometerError, int, str]] = [
    (
        SessionError("is no session", next_step="name one", path="a [b]/c"),
        2,
        "error: a [b]/c\n       is no session\nnext:  name one\n",
    ),
    (
        SessionError("2 problems\n  a: x\n  b: y", next_step="correct it"),
        2,
        "error: 2 problems\n         a: x\n         b: y\nnext:  correct it\n",
    ),
    (
        CalibrationError("2 views, 3 are the least", next_step="add views"),
        3,
        "error: 2 views, 3 are the least\nnext:  add views\n",
    ),
]


@pytest.mark.parametrize(("fault", "code", "text"), FAULTS)
def test_a_fault_is_told_with_its_code(
    fault: PivometerError,
    code: int,
    text: str,
    calls: Calls,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(pipeline, "measure", calls.record("measure", fault))
    assert main(["measure", "s"]) == code
    assert capsys.readouterr().err == text


def test_an_interruption_is_code_130(
    calls: Calls, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pipeline, "measure", calls.record("measure", KeyboardInterrupt()))
    assert main(["measure", "s"]) == 130
    assert capsys.readouterr().err == "interrupted: nothing was written\n"
    assert "write_measurement" not in [name for name, _, _ in calls.made]


def test_a_fault_of_our_own_shows_no_traceback_unless_asked(
    calls: Calls, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(pipeline, "measure", calls.record("measure", ZeroDivisionError("1/0")))
    monkeypatch.delenv("PIVOMETER_DEBUG", raising=False)
    assert main(["measure", "s"]) == 70
    assert capsys.readouterr().err == (
        "error: internal fault, ZeroDivisionError: 1/0\n"
        "next:  run again with PIVOMETER_DEBUG=1 and report what it prints\n"
    )
    monkeypatch.setenv("PIVOMETER_DEBUG", "1")
    with pytest.raises(ZeroDivisionError):
        main(["measure", "s"])


def run(code: str, **options: Any) -> "subprocess.CompletedProcess[str]":
    environment = {**os.environ, "PYTHONIOENCODING": "utf-8"} | options.pop("env", {})
    return subprocess.run(  # noqa: S603 - our own interpreter and code
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        encoding="utf-8",
        env=environment,
        check=False,
        **options,
    )


def test_version_and_front_page_import_nothing_heavy() -> None:
    code = (
        "import sys; from pivometer.cli import main; main(['--version']); main(['--help'])\n"
        "heavy = {'numpy', 'cv2', 'scipy', 'rich', 'cyclopts', 'plotly', 'jinja2'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    assert run(code).stdout.endswith("\n[]\n")


def test_the_help_of_a_command_imports_no_numbers() -> None:
    code = (
        "import sys; from pivometer.cli import main; main(['measure', '--help'])\n"
        "heavy = {'numpy', 'cv2', 'scipy', 'plotly', 'jinja2'}\n"
        "print(sorted(heavy & set(sys.modules)))"
    )
    assert run(code).stdout.endswith("\n[]\n")


def test_a_terminal_that_lacks_our_letters_is_no_fault() -> None:
    code = "from pivometer.cli import main; main(['measure', 'nowhere/é±µ'])"
    told = run(code, env={"PYTHONIOENCODING": "ascii"})
    assert told.stderr.startswith("error: nowhere/\\xe9\\xb1\\xb5\n")


def test_a_reader_that_leaves_early_is_no_fault(tmp_path: Path) -> None:
    code = (
        "import os, sys\nfrom pivometer.cli import main\n"
        "r, w = os.pipe(); os.close(r); os.dup2(w, 1)\nsys.exit(main(['schema']))"
    )
    told = run(code)
    assert (told.returncode, told.stderr) == (0, "")


def test_plan_tells_what_to_expect(capsys: pytest.CaptureFixture[str]) -> None:
    given = "--focal-px 1000 --image-size 640 480 --distance-mm 480 --baseline-mm 525"
    words = ["plan", *given.split(), "--poses", "6", "--board-views", "10", "--wanted-mm", "0.001"]
    assert main(words) == 0
    told = " ".join(capsys.readouterr().out.split())
    assert "6 poses in a cone of 57°" in told
    assert "What limits the location: the calibration" in told
    assert "No number of poses up to 500 reaches U = 0.001 mm." in told
    assert main(["plan", "--focal-px", "1000"]) == 2
    assert "--image-size is missing" in capsys.readouterr().err
