"""What went wrong, on stderr: what, where, why and what to do next; and its exit code."""

import sys

from cyclopts import CycloptsError

from pivometer.errors import PivometerError

_USAGE, INTERNAL, INTERRUPTED = 2, 70, 130


def fault_text(error: PivometerError) -> str:
    """Return a message of two or three lines.

    Examples
    --------
    >>> from pivometer.errors import ImageError
    >>> print(fault_text(ImageError("is empty", next_step="copy it again", path="a.png")))
    error: a.png
           is empty
    next:  copy it again
    """
    lines = [*error.what.splitlines(), f"next:  {error.next_step}"]
    if error.path is not None:
        lines = [str(error.path), *lines]
    first, *rest = lines
    body = [line if line.startswith("next:") else f"       {line}" for line in rest]
    return "\n".join([f"error: {first}", *body])


def tell_fault(error: PivometerError) -> int:
    """Print what Pivometer refused to do and return its exit code."""
    return _tell(fault_text(error), error.exit_code)


def tell_usage(error: CycloptsError) -> int:
    """Print what is wrong with the command as typed."""
    command = " ".join(["pivometer", *(error.command_chain or ())])
    return _tell(f"error: {error}\nnext:  see {command} --help", _USAGE)


def tell_interrupted() -> int:
    """Say that nothing was written after all."""
    return _tell("interrupted: nothing was written", INTERRUPTED)


def tell_internal(error: Exception) -> int:
    """Print a fault of Pivometer's own."""
    return _tell(
        f"error: internal fault, {type(error).__name__}: {error}\n"
        "next:  run again with PIVOMETER_DEBUG=1 and report what it prints",
        INTERNAL,
    )


def _tell(text: str, exit_code: int) -> int:
    sys.stderr.write(text + "\n")
    return exit_code
