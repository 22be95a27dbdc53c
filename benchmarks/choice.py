"""Which of the things that turn is taken for the shaft, in the sessions of `detection`.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.choice [--sessions N] [--first S] [--only ROW]``.
Nothing is fitted, so many fresh sessions can be looked at: a few seconds each. Right is what has
the shaft's diameter and usually its edges, to `ALIKE` and `NEAR_PX`; another is named, with whether
a warning is given, as is each session in which the cameras give no answer. Of the right ones it is
counted where a warning names something else, though the shaft alone was drawn to turn. Later gates
may still refuse what is wrong here.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks._stress_sessions import StressSession, stress_session
from benchmarks.detection import HELD_OUT, ROWS
from pivometer.shaft.concurrence import concurrence
from pivometer.shaft.detection import MOST_SAMPLES, learn_shaft
from pivometer.shaft.finding.agreement import Together
from pivometer.shaft.finding.background import sampled

ALIKE = 0.15
NEAR_PX = 4.0


@dataclass(frozen=True)
class Choice:
    """What the cameras choose: what is wrong with it, if anything, and whether they warn."""

    wrong: str | None
    warned: bool


def chosen(drawn: StressSession, *, empty: bool, stated: bool) -> Choice:
    """Choose as a measurement does."""
    seen, poses = [], []
    for name, frames in drawn.frames.items():
        places = sampled(len(frames), MOST_SAMPLES)
        background = drawn.empty[name] if empty else None
        finder = learn_shaft((frames[place] for place in places), background=background)
        seen.append(finder.candidates)
        poses.append({sample: f"{place:03}" for sample, place in enumerate(places)})
    stated_mm = drawn.diameter_mm if stated else None
    found = concurrence(seen, poses, drawn.rig, diameter_mm=stated_mm)
    if found.shaft is None:
        return Choice(f"no answer: {found.doubt or 'nothing agrees'}", warned=False)
    warned = found.doubt is not None
    off = usually_off_px(drawn, found.shaft, poses)
    measured, width = found.shaft.diameter_mm, max(one.width_px for one in found.shaft.chosen)
    if abs(measured / drawn.diameter_mm - 1) < ALIKE and off < NEAR_PX + ALIKE * width:
        return Choice(None, warned)
    said = f"wrong {'with' if warned else 'without'} a warning"
    what = f"{measured:.1f} of {drawn.diameter_mm:.1f} mm, {off:.0f} px off"
    return Choice(f"{said}: {what}", warned)


def usually_off_px(
    drawn: StressSession, shaft: Together, poses: Sequence[Mapping[int, str]]
) -> float:
    """Return how far an end of what was chosen usually is from the true edges at most."""
    offsets = [
        np.abs(drawn.offsets_px(camera.name, int(pose_of[sample]), edges)).max()
        for one, camera, pose_of in zip(shaft.chosen, drawn.rig.cameras, poses, strict=True)
        for sample, edges in one.edges_px.items()
    ]
    return float(np.median(offsets))


def main() -> None:
    """Print each row's number of right choices, and every other one."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sessions", type=int, default=10)
    parser.add_argument("--first", type=int, default=HELD_OUT)
    parser.add_argument("--only", default="")
    options = parser.parse_args()
    for name, choices in ROWS.items():
        if options.only not in name:
            continue
        drawing = dict(choices)
        given = {key: bool(drawing.pop(key, False)) for key in ("empty", "stated")}
        alone = not (drawing.get("rail") or drawing.get("rod"))
        others: dict[int, str] = {}
        warned = []
        for seed in range(options.first, options.first + options.sessions):
            drawn = stress_session(seed, **drawing)
            choice = chosen(drawn, **given)
            if choice.wrong is not None:
                others[seed] = choice.wrong
            elif alone and not drawn.has_second_rod:
                warned.append(choice.warned)
        right = f"{options.sessions - len(others)} of {options.sessions} right"
        if warned:
            right += f"; {sum(warned)} of {len(warned)} in which the shaft alone turns warn of more"
        print(f"{name}: {right}", flush=True)
        for seed, other in others.items():
            print(f"  {seed} {other}")


if __name__ == "__main__":
    main()
