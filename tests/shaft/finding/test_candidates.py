"""Of each thing that turns every width it shows is listed, and none that it does not show."""

from dataclasses import replace

import numpy as np
import pytest

from pivometer.shaft.finding.background import WorkingScale
from pivometer.shaft.finding.candidates import Candidate, candidates
from pivometer.shaft.finding.motion import pair_table
from pivometer.shaft.finding.pairs import EdgePair
from pivometer.shaft.finding.rivals import turning_things
from pivometer.shaft.finding.straight import EdgeLine

FRAMES = 12
SCALE = WorkingScale(1, 0.0, 255.0)


def piece(angle: float, begin: float, end: float, width: float, taper: float = 0.0) -> EdgePair:
    """Two edges about the origin, seen from one place along them to another."""
    normal = np.array([np.cos(angle), np.sin(angle)])
    along = np.array([-normal[1], normal[0]])
    places = np.array([[begin], [end]])
    half = (width + taper * (places - places.mean())) / 2
    edges = np.stack([places * along + side * half * normal for side in (-1, 1)])
    line = EdgeLine(normal, 0.0, np.zeros(1, dtype=bool), np.zeros(1))
    middle, length = edges.mean(axis=(0, 1)), end - begin
    return EdgePair((line, line), begin, end, length, edges, normal, 0.0, middle, width, taper)


def listed(
    *others: tuple[float, float, float, float], width: float = 46.0
) -> tuple[Candidate, ...]:
    """Return what is listed of a shaft and other pairs of edges: `piece`'s arguments."""
    angles = np.random.default_rng(1).permutation(np.linspace(-0.5, 0.5, FRAMES))
    pairs = [[piece(a, 60, 260, width), *(piece(a, *other) for other in others)] for a in angles]
    table = pair_table(pairs, [np.ones(1 + len(others))] * FRAMES)
    return candidates(turning_things(table), table, pairs, SCALE, np.zeros(2))


def test_a_short_piece_of_the_same_edges_is_no_other_width() -> None:
    # An edge whose ends are off by 0.3 px each tapers by 1.2 px over 100 px: 2.6 px at the pivot.
    (shaft,) = listed((160, 260, 46.0, -0.0125))
    assert shaft.width_px == pytest.approx(46.0)


def test_a_thin_shaft_has_no_other_width_that_lines_cannot_tell() -> None:
    # Lines less than 2 px apart count as one.
    (shaft,) = listed((60, 260, 10.2, 0.0), width=12.0)
    assert shaft.width_px == pytest.approx(12.0, abs=1.8)
    assert len(listed((60, 260, 9.0, 0.0), width=12.0)) == 2


def test_a_stripe_is_another_width_and_its_edges_are_its_own() -> None:
    found = listed((60, 260, 40.0, 0.0))
    for one, width in zip(found, (46.0, 40.0), strict=True):
        assert one.width_px == pytest.approx(width)
        seen = [np.hypot(*(edges[1] - edges[0]).mean(axis=0)) for edges in one.edges_px.values()]
        assert seen == pytest.approx([width] * FRAMES)


def test_no_width_is_listed_twice() -> None:
    aside = np.array([0.0, -26.0])
    pairs = []
    for angle in np.linspace(-0.25, 0.25, FRAMES):
        short = piece(angle, 20, 120, 39.0, -0.1)  # about a pivot of their own
        moved = replace(
            short,
            edges_px=short.edges_px + aside,
            offset_px=float(short.normal @ aside),
            middle_px=short.middle_px + aside,
        )
        pairs.append([piece(angle, 60, 260, 46.0), moved])
    table = pair_table(pairs, [np.ones(2)] * FRAMES)
    found = candidates(turning_things(table), table, pairs, SCALE, np.zeros(2))
    assert [one.width_px for one in found] == pytest.approx([46.0, 39.0])
