"""Finding the shaft in one camera's frames without a click.

Edges that are not background (`background`) are joined to lines and lines to pairs (`pairs`); the
sequence votes for a pivot pixel and a width there (`motion`), helped by what each pair hides
(`occlusion`); every frame then takes the pair that fits best, gates it and refits it (`refit`).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from itertools import starmap, zip_longest

import numpy as np
from numpy.typing import NDArray

from pivometer._arrays import Floats
from pivometer.shaft.finding.background import (
    SAMPLED_FRAMES,
    Image,
    MovingEdges,
    StaticScene,
    WorkingScale,
    averaged,
    gradient,
    moving_edges,
    outline_edges,
    sampled,
    shrinking,
    static_scene,
    unknown_scene,
    working_scale,
)
from pivometer.shaft.finding.candidates import Candidate, candidates, told_apart
from pivometer.shaft.finding.motion import (
    MOST_PAIRS,
    Motion,
    PairTable,
    at_pivot,
    hinted_motion,
    pair_table,
)
from pivometer.shaft.finding.occlusion import cover
from pivometer.shaft.finding.pairs import EdgePair, edge_pairs
from pivometer.shaft.finding.refit import refitted_edges
from pivometer.shaft.finding.rivals import SERIOUS_SHARE, Turning, turning_things, widest
from pivometer.shaft.finding.shifting import shifting_motion
from pivometer.shaft.finding.straight import (
    LEAST_SUPPORT_PX,
    EdgeLine,
    Passing,
    edge_lines,
    other_lines,
)
from pivometer.shaft.hint import ShaftHint
from pivometer.shaft.seed import ShaftSeed

TRUSTED_MEDIAN = 6
"""From this many frames on the median grey level tells what a pair of edges hides; with fewer, the
shaft itself is the median near the pivot and the test is left out."""

MOST_SAMPLES = 25
"""Frames that vote for the motion: bounds memory, however long a video is. Of 36 drawn frames
as many are found as with all of them (seven scenes)."""

LEAST_FRAMES = 3
"""Frames that must agree on a pivot and a width; any two lines have a common point."""

MOST_SPREADS = 3.0

LEAST_LENGTH = 0.55
"""Least support of a pair against the other frames' median: the only wrong pair that passed the
pivot and width gates in the rendered sets had 0.51."""

LEAST_SURE_LENGTH = 0.25
SURE_SPREADS = 1.0
"""A shorter pair will do where pivot and width fit to one spread, together: something hides the
rest."""

ENOUGH_LENGTH = 0.9
"""A pair as long as this against that median makes a second search unnecessary."""


@dataclass(frozen=True, slots=True)
class SeedRejection:
    """Why no shaft was accepted in one image.

    Parameters
    ----------
    reason
        One sentence with the numbers, without a full stop at the end.

    Examples
    --------
    >>> SeedRejection("nothing differs from the background").reason
    'nothing differs from the background'
    """

    reason: str


@dataclass(frozen=True, slots=True, eq=False)
class _Frame:
    """One frame's moving edges, the lines and pairs among them, and what those pairs hide."""

    edges: MovingEdges
    lines: list[EdgeLine]
    pairs: list[EdgePair]
    cover: Floats


@dataclass(frozen=True, slots=True, eq=False)
class _Search:
    """What all frames of a camera have in common."""

    scale: WorkingScale
    scene: StaticScene
    size_px: tuple[int, int]
    centre_px: Floats
    knows_background: bool
    has_empty: bool

    def frame(
        self,
        copy: NDArray[np.uint16],
        slopes: NDArray[np.int16] | None = None,
        passing: Passing | None = None,
    ) -> _Frame:
        """Search a working copy for lines that pass where the shaft does; its gradient if known."""
        if self.has_empty:
            edges = outline_edges(copy, self.scene)
        else:
            edges = moving_edges(gradient(copy) if slopes is None else slopes, self.scene)
        return self._with_lines(copy, edges, edge_lines(edges, self.centre_px, passing), passing)

    def again(self, copy: NDArray[np.uint16], frame: _Frame, motion: Motion) -> _Frame:
        """Search once more, only for lines that pass the pivot, among all edges there are."""
        edges = frame.edges
        if self.has_empty:
            edges = edges.joined(moving_edges(gradient(copy), self.scene))
        lines = edge_lines(edges, self.centre_px, motion.passing)
        lines += other_lines(frame.lines, lines)
        return self._with_lines(copy, edges, lines, motion.passing)

    def _with_lines(
        self,
        copy: NDArray[np.uint16],
        edges: MovingEdges,
        lines: list[EdgeLine],
        passing: Passing | None = None,
    ) -> _Frame:
        pairs = edge_pairs(lines, self.size_px, passing)
        share = np.ones(len(pairs))
        if self.knows_background:
            share = cover(pairs, copy, self.scene, self.centre_px)
        return _Frame(edges, lines, pairs, share)


@dataclass(frozen=True, slots=True, eq=False)
class ShaftFinder:
    """What some of a camera's frames tell of the shaft; finds it in each of them alone.

    It holds no raw frame, so that a video of any length is searched in constant memory.
    """

    _search: _Search
    _motion: Motion | SeedRejection
    _known: tuple[_Frame, ...]
    warning: str | None = None
    """What makes it uncertain that this is the shaft, if anything."""
    candidates: tuple[Candidate, ...] = ()
    """What might be the shaft, for other cameras to tell."""

    @property
    def refusal(self) -> str | None:
        """Why it finds nothing in any frame; None if it knows what the shaft is."""
        return self._motion.reason if isinstance(self._motion, SeedRejection) else None

    def taking(self, candidate: Candidate, warning: str | None) -> ShaftFinder:
        """Return a finder of another candidate."""
        return replace(self, _motion=told_apart(candidate, self.candidates), warning=warning)

    def refusing(self, reason: str) -> ShaftFinder:
        """Return a finder that finds nothing, for a reason."""
        return replace(self, _motion=SeedRejection(reason), warning=None)

    def find(self, image: Image, *, sample: int | None = None) -> ShaftSeed | SeedRejection:
        """Find the shaft in one frame.

        Parameters
        ----------
        image
            The frame, as those that `learn_shaft` saw.
        sample
            Which of those it is, if it is one of them; what is known of it is not found again.
        """
        if isinstance(self._motion, SeedRejection):
            return self._motion
        if sample is not None:
            return _chosen(image, self._known[sample], self._search, self._motion)
        copy = self._search.scale.copy(image)
        frame = self._search.frame(copy, passing=self._motion.passing)
        return _chosen(image, frame, self._search, self._motion)


def learn_shaft(
    samples: Iterable[Image], *, background: Image | None = None, hint: ShaftHint | None = None
) -> ShaftFinder:
    """Learn from some of a camera's frames what stands still and how the shaft moves.

    Parameters
    ----------
    samples
        Frames of one camera, 2-D uint8 or uint16, all of one size, at least one; taken one at a
        time. `MOST_SAMPLES`, evenly spread, tell as much as more.
    background
        The same view without shaft and robot. Without it the samples' own median serves.
    hint
        Where the shaft turns, if a person says so; then fewer than three frames will do.
    """
    smalls: list[Image] = []
    factor = 1
    for image in samples:
        factor = shrinking(image)
        smalls.append(averaged(image, factor))
    scale = working_scale(smalls, factor)
    empty = None if background is None else scale.copy(background)
    copies = [scale.stretched(small) for small in smalls]
    slopes = [gradient(copy) for copy in (copies if empty is None else copies[:1])]
    search = _search(copies, slopes, scale, empty)
    frames = tuple(starmap(search.frame, zip_longest(copies, slopes)))
    if all(len(frame.edges.points_px) < LEAST_SUPPORT_PX for frame in frames):
        reason = "nothing moves between the frames, so a moving shaft cannot be told from the rest"
        return ShaftFinder(search, SeedRejection(reason), frames)
    table = pair_table([f.pairs for f in frames], [f.cover for f in frames], MOST_PAIRS)
    if hint is not None:
        motion: Motion | SeedRejection = _hinted(frames, hint, search)
        warning, things, serious = None, [], []
    else:
        things = turning_things(table)
        serious = [thing for thing in things if not thing.rare]
        motion, warning = _motion(serious, table, len(frames), search)
    if not serious and isinstance(motion, Motion):
        things = [Turning(motion, motion.length_px * motion.frames)]
    found = candidates(
        things, table, [f.pairs for f in frames], scale, search.centre_px, alone=hint is not None
    )
    return ShaftFinder(search, motion, frames, warning, found)


def find_shaft(
    images: Sequence[Image], *, background: Image | None = None, hint: ShaftHint | None = None
) -> list[ShaftSeed | SeedRejection]:
    """Find the shaft in one camera's frames, without any hint where none is given.

    The camera stands still and the shaft turns about a point: the shaft is the pair of long,
    nearly parallel edges that differ from the background, pass a common pivot pixel, and have the
    same distance there in all frames. A frame in which no such pair is seen clearly is rejected.

    Parameters
    ----------
    images
        Frames of one camera, 2-D uint8 or uint16, all of one size.
    background
        The same view without shaft and robot. Without it the frames' own median serves.
    hint
        Where the shaft turns, if a person says so.

    Returns
    -------
    list
        For every image, in order, a `ShaftSeed` or a `SeedRejection`. Without a hint fewer than
        three frames are rejected, and so is a shaft that never moves: it cannot be told from a rod
        of the scenery. One that only shifts is found where nothing else that moves is like it.

    Notes
    -----
    Two independently rendered sessions, two cameras, 24 poses: 48 of 48 white shafts within 0.3 px
    of both true edges, 47 of 48 black glossy shafts before clutter within 0.9 px, one rejected.
    Scenes drawn for stress (clutter, carriage, collar, cannula, a second pivoting rod, shadows and
    flicker) and their rates of found and wrong shafts: `benchmarks/detection.py`. Where two things
    turn, the wider is the shaft (`rivals`); cameras of a rig know better (`concurrence`).
    Thin shafts in images over 1280 px need about 3 px after averaging down (12 of 4000 px). In
    three to five frames two alike rods can pass for one that turns before one camera.

    Examples
    --------
    >>> import cv2
    >>> frames = [np.full((240, 320), 10, dtype=np.uint8) for _ in range(4)]
    >>> for frame, x in zip(frames, (80, 130, 180, 230)):
    ...     frame[:] = cv2.line(frame, (160, 220), (x, 20), 200, 16, cv2.LINE_AA)
    >>> [type(found).__name__ for found in find_shaft(frames)]
    ['ShaftSeed', 'ShaftSeed', 'ShaftSeed', 'ShaftSeed']
    """
    if len(images) == 0:
        return []
    places = {place: k for k, place in enumerate(sampled(len(images), MOST_SAMPLES))}
    finder = learn_shaft((images[i] for i in places), background=background, hint=hint)
    return [finder.find(image, sample=places.get(i)) for i, image in enumerate(images)]


def _search(
    copies: Sequence[NDArray[np.uint16]],
    slopes: Sequence[NDArray[np.int16]],
    scale: WorkingScale,
    empty: NDArray[np.uint16] | None,
) -> _Search:
    if empty is not None:
        scene = static_scene([empty], [gradient(empty)], slopes[0])
    elif len(copies) < LEAST_FRAMES:
        scene = unknown_scene(copies[0], slopes[0])
    else:
        chosen = sampled(len(copies), SAMPLED_FRAMES)
        scene = static_scene([copies[i] for i in chosen], [slopes[i] for i in chosen])
    height, width = scene.grey.shape
    known = empty is not None or len(copies) >= TRUSTED_MEDIAN
    centre = np.array([(width - 1) / 2, (height - 1) / 2])
    return _Search(scale, scene, (width, height), centre, known, empty is not None)


def _motion(
    things: list[Turning], table: PairTable, count: int, search: _Search
) -> tuple[Motion | SeedRejection, str | None]:
    """Return the shaft's motion or why it is unknown, and a warning if something else turns too."""
    if not things:
        shifting = shifting_motion(table)
        if shifting is not None:
            return shifting, "the shaft shifts and does not turn about a point in these images"
        least = max(LEAST_FRAMES, round(SERIOUS_SHARE * len(np.unique(table.at))))
        return SeedRejection(
            f"fewer than {least} of {count} frames show two long parallel edges that turn about a "
            "common point with a constant width, so the shaft cannot be told"
        ), None
    shaft, rival, told = widest(things)
    if rival is None:
        return shaft.motion, None
    both = f"{_described(shaft.motion, search)} and {_described(rival.motion, search)}"
    if not told:
        return SeedRejection(f"two things turn in these images and either may be it: {both}"), None
    return shaft.motion, f"two things turn, and the wider is taken for the shaft: {both}"


def _described(motion: Motion, search: _Search) -> str:
    x, y = search.scale.raw_pixels(motion.pivot_px + search.centre_px)
    return f"{motion.width_px * search.scale.factor:.0f} px wide about ({x:.0f}, {y:.0f})"


def _hinted(frames: Sequence[_Frame], hint: ShaftHint, search: _Search) -> Motion | SeedRejection:
    table = pair_table([f.pairs for f in frames], [f.cover for f in frames])
    raw = np.array([hint.x_px, hint.y_px])
    width = None if hint.width_px is None else hint.width_px / search.scale.factor
    motion = hinted_motion(table, search.scale.working_pixels(raw) - search.centre_px, width)
    if motion is None:
        return SeedRejection(
            f"no two long parallel edges pass the hinted pixel ({hint.x_px:g}, {hint.y_px:g})"
        )
    return motion


def _chosen(
    image: Image, frame: _Frame, search: _Search, motion: Motion
) -> ShaftSeed | SeedRejection:
    found = _best(frame, motion, ENOUGH_LENGTH)
    if isinstance(found, str):
        frame = search.again(search.scale.copy(image), frame, motion)
        found = _best(frame, motion, LEAST_LENGTH)
    if isinstance(found, str):
        return SeedRejection(found)
    edges = refitted_edges(found, frame.edges, search.centre_px)
    return ShaftSeed(search.scale.raw_pixels(edges + search.centre_px))


def _best(frame: _Frame, motion: Motion, least_length: float) -> EdgePair | str:
    """Return the pair that fits the motion best, or why it is not the shaft."""
    if len(frame.edges.points_px) < LEAST_SUPPORT_PX:
        return "nothing differs from the background"
    if not frame.pairs:
        return "no two long parallel edges, as far apart as in other frames, pass their pivot"
    table = pair_table([frame.pairs], [frame.cover])
    best = int(np.argmax(motion.agreement(table)))
    reason = _refusal(motion, table, best, least_length)
    return frame.pairs[table.which[best]] if reason is None else reason


def _refusal(motion: Motion, table: PairTable, best: int, least_length: float) -> str | None:
    """Say why a frame's best pair is not the shaft, if it is not."""
    away, width, _ = (values[best] for values in at_pivot(table, motion.pivot_px, 0.0))
    away_spreads, width_spreads = (abs(values[best]) for values in motion.departures(table))
    if away_spreads > MOST_SPREADS:
        return (
            f"no long parallel edges pass the other frames' pivot: the best pair misses it by "
            f"{abs(away):.0f} px, {away_spreads:.1f} times the usual spread"
        )
    if width_spreads > MOST_SPREADS:
        return (
            f"no long parallel edges have the other frames' width of {motion.width_px:.1f} px at "
            f"the pivot: the best pair has {width:.1f} px"
        )
    sure = least_length <= LEAST_LENGTH and np.hypot(away_spreads, width_spreads) < SURE_SPREADS
    length, least_length = table.length[best], LEAST_SURE_LENGTH if sure else least_length
    if length < least_length * motion.length_px:
        return (
            f"only {length:.0f} px of both edges are visible, in the other frames "
            f"{motion.length_px:.0f} px"
        )
    return None
