"""The outcome of a check as JUnit XML, which CI servers show."""

from __future__ import annotations

import re
from html import escape
from pathlib import Path

from pivometer.errors import PivometerError
from pivometer.io.atomic import write_file
from pivometer.pipeline.checking import CheckOutcome, Condition

_NOT_XML = re.compile("[\x00-\x08\x0b\x0c\x0e-\x1f\ud800-\udfff\ufffe\uffff]")


def write_junit(outcome: CheckOutcome | PivometerError, file: Path | str, *, name: str) -> Path:
    """Write JUnit XML, whole or not at all, and return its path.

    Parameters
    ----------
    outcome
        What `check` returned, or why there was nothing to check.
    file
        Where to.
    name
        What was checked: the name of the test suite.
    """
    return write_file(file, junit_text(outcome, name=name))


def junit_text(outcome: CheckOutcome | PivometerError, *, name: str) -> str:
    """Return the text: one test case for each condition, for the limit, and for the baseline."""
    if isinstance(outcome, PivometerError):
        where = f"{outcome.path}: " if outcome.path else ""
        said = f"{where}{outcome.what}; next: {outcome.next_step}"
        cases, counts = [_case("measurement", "error", said)], (1, 0, 1, 0)
    else:
        cases = [_condition_case(condition) for condition in outcome.validity]
        if outcome.baseline is not None:
            cases.append(_condition_case(outcome.baseline))
        cases.append(_limit_case(outcome))
        kinds = [sum(f"<{kind} " in case for case in cases) for kind in ("failure", "skipped")]
        counts = len(cases), kinds[0], 0, kinds[1]
    tests, failures, errors, skipped = counts
    suite = (
        f'<testsuite name="{_escaped(name)}" tests="{tests}" failures="{failures}" '
        f'errors="{errors}" skipped="{skipped}">'
    )
    return "\n".join(['<?xml version="1.0" encoding="UTF-8"?>', suite, *cases, "</testsuite>\n"])


def _condition_case(condition: Condition) -> str:
    kind = {"met": "", "not met": "failure", "not checked": "skipped"}[condition.status]
    return _case(condition.name, kind, condition.text)


def _limit_case(outcome: CheckOutcome) -> str:
    kind = {"pass": "", "invalid": "skipped"}.get(outcome.decision, "failure")
    return _case("limit", kind, f"{outcome.decision}: {outcome.text}; rule: {outcome.rule}")


def _case(name: str, kind: str, text: str) -> str:
    """Return one test case; `kind` is empty where it is passed."""
    inside = f'<{kind} message="{_escaped(text)}"/>' if kind else _said(text)
    return f'  <testcase classname="pivometer" name="{_escaped(name)}">{inside}</testcase>'


def _said(text: str) -> str:
    return f"<system-out>{_escaped(text)}</system-out>"


def _escaped(text: str) -> str:
    return escape(_NOT_XML.sub("\ufffd", text))
