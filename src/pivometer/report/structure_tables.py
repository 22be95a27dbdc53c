"""The structure of the error as tables and plain words."""

from pivometer.rcm.structure import ErrorStructure, Pattern, probability
from pivometer.report.digits import error_decimals, fixed, with_uncertainty
from pivometer.report.tables import Table

KINDS = {
    "direction": "direction of the shaft",
    "order": "order of the poses",
    "approach": "side of approach",
}


def component_table(structure: ErrorStructure) -> Table:
    """Tabulate the misses along and across the mean shaft, the instrument's part beside them."""
    parts = structure.components
    decimals = error_decimals([part.rms_mm for part in parts])
    known = any(part.instrument_rms_mm > 0 for part in parts)
    return Table(
        "Misses from the least-squares point along and across the mean shaft, mm",
        ("direction", "rms", "largest", "rms of the instrument alone"),
        tuple(
            (
                part.name,
                fixed(part.rms_mm, decimals),
                fixed(part.max_mm, decimals),
                fixed(part.instrument_rms_mm, decimals) if known else "unknown",
            )
            for part in parts
        ),
        "A line shows no miss along itself, so along the mean shaft only tilted poses show any.",
    )


def pattern_table(structure: ErrorStructure) -> Table:
    """Tabulate everything that was tested."""
    decimals = error_decimals([pattern.rms_mm for pattern in structure.patterns])
    return Table(
        "What the misses follow",
        ("tested", "share of the variance", "rms, mm", "p", "beyond chance"),
        tuple(
            (
                KINDS.get(pattern.kind, f"joint {pattern.name}"),
                _percent(pattern.share),
                fixed(pattern.rms_mm, decimals),
                probability(pattern.p_value).removeprefix("p = ").removeprefix("p "),
                "yes" if pattern.found else "no",
            )
            for pattern in structure.patterns
        ),
        "Shares are what is left after chance is taken off; they overlap where one thing goes with "
        "another, as joints go with the direction of the shaft. p is the probability of as much by "
        "chance, corrected for the number of tests; in pure noise anything at all is found in at "
        f"most {100 * structure.false_alarm:.0f} % of sessions. Order and side of approach are "
        "tested beside what follows the direction, where anything does.",
    )


def structure_sentences(structure: ErrorStructure) -> tuple[str, ...]:
    """Say what was found, the instrument's part first, each in one sentence."""
    sentences = []
    if structure.instrument_share > 0:
        sentences.append(
            f"The instrument's noise explains {_percent(structure.instrument_share)} of the "
            "variance of the misses."
        )
    sentences += [f"{pattern.text}{_moves(pattern)}." for pattern in structure.found]
    if not structure.patterns:
        sentences.append("With fewer than 10 poses nothing can be said of what the misses follow.")
    elif not structure.found:
        tested = ", ".join(
            KINDS.get(pattern.kind, f"joint {pattern.name}") for pattern in structure.patterns
        )
        sentences.append(f"Nothing beyond chance was found in what was tested: {tested}.")
    return tuple(sentences)


def _percent(share: float) -> str:
    return "less than 1 %" if 0 < share < 0.01 else f"{100 * share:.0f} %"


def _moves(pattern: Pattern) -> str:
    """Say where to, if the pattern is one move."""
    if not pattern.shift_mm.any():
        return ""
    pairs = zip(pattern.shift_mm, pattern.shift_u_mm, strict=True)
    return f", by ({', '.join(with_uncertainty(float(v), float(u)) for v, u in pairs)}) mm"
