"""The commands. What they need is imported when they run, so that ``--help`` is quick."""

import os
import re
import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError

from pivometer._version import __version__
from pivometer.cli.faults import tell_fault, tell_internal, tell_interrupted, tell_usage
from pivometer.cli.help_text import FilledParagraphs
from pivometer.errors import PivometerError

app = App(
    name="pivometer",
    help="Measure the remote center of motion (RCM) of a surgical robot with two cameras or more.",
    help_epilogue="Exit codes: 0 done, 2 wrong usage or configuration, 3 data unfit for an answer.",
    help_format="plaintext",
    help_formatter=FilledParagraphs(),
    version=f"pivometer {__version__}",
    suppress_keyboard_interrupt=False,
    print_error=False,
    exit_on_error=False,
    help_on_error=False,
    result_action="return_value",
)


def run(arguments: Sequence[str]) -> int:
    """Run one command; whatever goes wrong becomes a message and an exit code."""
    os.environ.setdefault("OPENCV_LOG_LEVEL", "SILENT")  # we say ourselves what is wrong
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):  # a terminal without "±" gets a stand-in, not a crash
            stream.reconfigure(errors="backslashreplace")
    code: object = 0
    try:
        code = app(_with_counts_apart(arguments))
    except PivometerError as error:
        return tell_fault(error)
    except CycloptsError as error:
        return tell_usage(error)
    except KeyboardInterrupt:
        return tell_interrupted()
    except BrokenPipeError:  # the reader, such as `head`, has seen enough
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except Exception as error:  # the last resort: a message, never a traceback
        if os.environ.get("PIVOMETER_DEBUG"):
            raise
        return tell_internal(error)
    return code if isinstance(code, int) else 0


def _with_counts_apart(arguments: Sequence[str]) -> list[str]:
    """Take 9x7 after --squares for 9 7: both are typed.

    Examples
    --------
    >>> _with_counts_apart(["target", "--squares", "9x7"])
    ['target', '--squares', '9', '7']
    """
    words: list[str] = []
    for word in arguments:
        counts = re.fullmatch(r"(--squares=)?(\d+)[xX×](\d+)", word)
        if counts and (counts[1] or words[-1:] == ["--squares"]):
            words += [*(["--squares"] if counts[1] else []), counts[2], counts[3]]
        else:
            words.append(word)
    return words


app.command(
    "pivometer.cli.simulating:demo",
    help_prologue="""\
Example:  pivometer demo
          renders pictures of a simulated robot, measures them,
          and says how far the answer is from the truth.
""",
)

app.command(
    "pivometer.cli.simulating:simulate",
    help_prologue="""\
Example:  pivometer simulate davinci my-session --poses 30 --seed 1
          pivometer measure my-session
""",
)

app.command(
    "pivometer.cli.measuring:calibrate",
    help_prologue="""\
Example:  pivometer calibrate my-session
          writes my-session/results/rig.json and prints how good the calibration is.
""",
)

app.command(
    "pivometer.cli.measuring:measure",
    help_prologue="""\
Example:  pivometer measure my-session
          pivometer measure other-session --rig my-session/results/rig.json
          pivometer measure bearing --gold-standard --bearing-rms-mm 0.002
          pivometer measure my-session --floor bearing/results/result.json
""",
)

app.command(
    "pivometer.cli.exchanging:export",
    help_prologue="""\
Example:  pivometer export my-session/results/rig.json --to kalibr camchain.yaml
          pivometer export intrinsics-and-extrinsics/ --to ros camera_info/ --unit-mm 1
""",
)

app.command(
    "pivometer.cli.exchanging:target",
    help_prologue="""\
Example:  pivometer target board.pdf --squares 9 7 --square-mm 15
          a page to print at 100 %, with a line that tells whether it was,
          and the lines for session.toml.
""",
)

app.command(
    "pivometer.cli.solving:solve",
    help_prologue="""\
Example:  pivometer solve my-session/results/centerlines.csv
          the RCM of lines from anywhere: no camera, no pictures.
""",
)

app.command(
    "pivometer.cli.solving:pivot",
    help_prologue="""\
Example:  pivometer pivot poses.csv
          where a tracked instrument pivots, and where its tip is.
          pivometer pivot poses.csv --axis 0,0,1
          the RCM of the instrument's axis, which may slide through it.
""",
)

app.command(
    "pivometer.cli.checking:check",
    help_epilogue="",  # the exit codes are its own
    help_prologue="""\
Example:  pivometer check my-session --limit 0.5
          pivometer check results/result.json --limit 0.5 --junit check.xml
Exit codes: 0 pass, 1 over the limit, 2 wrong usage or configuration, 3 data
          unfit for an answer, 4 a condition of validity is not met,
          5 inconclusive: the limit lies inside the uncertainty.
""",
)

app.command(
    "pivometer.cli.planning:plan",
    help_prologue="""\
Example:  pivometer plan --rig my-session/results/rig.json --wanted-mm 0.3
          pivometer plan --focal-px 1000 --image-size 640 480 \\
                         --distance-mm 480 --baseline-mm 525 --square-mm 15
""",
)

app.command(
    "pivometer.cli.exchanging:schema",
    help_prologue="""\
Example:  pivometer schema > result.schema.json
""",
)

app.command(
    "pivometer.cli.figures:figures",
    help_prologue="""\
Example:  pivometer figures my-session/results/result.json figures/
""",
)

app.command(
    "pivometer.cli.verify:verify",
    help_epilogue="",  # the exit codes are its own
    help_prologue="""\
Example:  pivometer verify my-session/results/report.html
          pivometer verify report.html my-session
Exit codes: 0 everything holds, 2 wrong usage or configuration, 3 data unfit
          for an answer, 4 something was changed, 5 nothing found changed, but
          not all could be checked.
""",
)


app.command(
    "pivometer.cli.guided:guided",
    name="app",
    help_prologue="""\
Example:  pivometer app my-session
          opens the browser: set up, calibrate, take poses, read the result,
          write the report.
""",
)

app.command(
    "pivometer.cli.compare:compare",
    help_prologue="""\
Example:  pivometer compare before-service after-service
          says whether the robot has changed by more than chance explains.
""",
)

app.command(
    "pivometer.cli.history:history",
    help_epilogue="",  # the exit codes are its own
    help_prologue="""\
Example:  pivometer history all-sessions --output trend
Exit codes: 0 the newest results are in line, 1 one is out of line, 2 wrong usage
          or configuration.
""",
)
