"""The solvers: proofs on hard sets, speed beside peers, growth, and what the points differ by.

Run with ``OMP_NUM_THREADS=1 python -m benchmarks.rcm``; needs clarabel, cvxpy and scipy (the
development tools). All solvers work on the same lines in the same process, in turn; trust the
ratios. "Direct" is Clarabel on the reduced problem min α, ‖Pᵢq − rᵢ‖ ≤ α, once with setting up its
matrices from the lines, as any user must (Pivometer's time includes checking its input, too), and
once without ("prepared"). "CVXPY" is eq. (3) as printed, given to CVXPY with Clarabel. Nothing is
extrapolated.
"""

from __future__ import annotations

import argparse
import importlib
import time
import tracemalloc
from collections import Counter
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks._hard_lines import HARD, RCM_MM, UNSOLVABLE, Floats, Lines, adversarial, cone
from pivometer.errors import DataError
from pivometer.rcm import least_squares_rcm, minimax_rcm, solve, weighted_rcm
from pivometer.uncertainty.coverage import confidence_radius


def gold_lines(count: int, seed: int = 0) -> Lines:
    """Return lines that miss the RCM by independent noise with the paper's rms of 0.145 mm."""
    random = np.random.default_rng(seed)
    axes = cone(random, count)
    misses = 0.145 / np.sqrt(2) * random.standard_normal((count, 3))
    return RCM_MM + misses + random.uniform(50, 100, (count, 1)) * axes, axes


def davinci_lines(count: int, seed: int = 0) -> Lines:
    """Return lines whose miss is a smooth function of the pose, 3 mm rms, as a robot's is."""
    random = np.random.default_rng(seed)
    axes = cone(random, count)
    terms = np.stack([np.ones(count), *axes.T[:2], *(axes.T[:2] ** 2), axes[:, 0] * axes[:, 1]], 1)
    misses = terms @ (random.standard_normal((6, 3)) * [[1], [4], [4], [8], [8], [8]])
    misses -= misses.mean(axis=0)
    across = misses - np.sum(misses * axes, axis=1)[:, None] * axes
    misses *= 3.0 / np.sqrt(np.mean(np.sum(across**2, axis=1)))
    return RCM_MM + misses, axes


def clarabel_problem(points: Floats, axes: Floats) -> tuple[Any, Floats]:
    """Return the constraints ‖Pᵢ(q − bᵢ)‖ ≤ α as Clarabel's sparse A and b, centred."""
    from scipy.sparse import csc_matrix

    count = len(points)
    projectors = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    offsets = np.einsum("nij,nj->ni", projectors, points - points.mean(axis=0))
    offsets -= projectors @ np.linalg.solve(projectors.sum(axis=0), offsets.sum(axis=0))
    rows = np.zeros((count, 4, 4))
    rows[:, 0, 3] = -1
    rows[:, 1:, :3] = -projectors
    right = np.zeros((count, 4))
    right[:, 1:] = -offsets
    return csc_matrix(rows.reshape(-1, 4)), right.ravel()


def clarabel_radius(matrix: Any, right: Floats) -> float:
    """Return the radius that Clarabel finds."""
    import clarabel  # type: ignore[import-untyped]
    from scipy.sparse import csc_matrix

    settings = clarabel.DefaultSettings()
    settings.verbose = False
    cones = [clarabel.SecondOrderConeT(4)] * (len(right) // 4)
    goal = np.array([0.0, 0.0, 0.0, 1.0])
    solver = clarabel.DefaultSolver(csc_matrix((4, 4)), goal, matrix, right, cones, settings)
    return float(solver.solve().x[3])


def cvxpy_radius(points: Floats, axes: Floats) -> float:
    """Return the radius from eq. (3) as printed."""
    cvxpy: Any = importlib.import_module("cvxpy")  # its annotations are incomplete
    count = len(points)
    alpha, tau, p = cvxpy.Variable(), cvxpy.Variable(count), cvxpy.Variable(3)
    constraints = [cvxpy.norm(axes[i] * tau[i] + points[i] - p) <= alpha for i in range(count)]
    cvxpy.Problem(cvxpy.Minimize(alpha), constraints).solve(solver="CLARABEL")
    return float(alpha.value)


def best_ms(functions: list[Callable[[], object]], repeats: int) -> list[float]:
    """Return the shortest processor time of each function, ms, the functions taking turns.

    Processor time, so that other programs count little; all solvers here use one thread if
    OMP_NUM_THREADS=1.
    """
    times: list[list[float]] = [[] for _ in functions]
    for _ in range(repeats):
        for index, function in enumerate(functions):
            start = time.process_time()
            function()
            times[index].append(time.process_time() - start)
    return [1e3 * min(values) for values in times]


def compare(count: int, *, problems: int, repeats: int) -> None:
    """Print one row of the table of speeds: mean times over several problems."""
    sets = [gold_lines(count, seed) for seed in range(problems)]
    radii: list[float] = []

    def direct() -> None:
        radii[:] = [clarabel_radius(*clarabel_problem(*lines)) for lines in sets]

    functions: list[Callable[[], object]] = [
        lambda: [minimax_rcm(*lines) for lines in sets],
        direct,
    ]
    if count <= 10_000:
        prepared = [clarabel_problem(*lines) for lines in sets]
        functions.append(lambda: [clarabel_radius(*problem) for problem in prepared])
    own, whole, *solving = best_ms(functions, repeats)
    found = [minimax_rcm(*lines) for lines in sets]
    excess = max(abs(r / rcm.max_mm - 1) for r, rcm in zip(radii, found, strict=True))
    alone = f"{solving[0] / own:.2f}×" if solving else "–"
    printed = "–"
    if count <= 70:
        printed = f"{best_ms([lambda: cvxpy_radius(*sets[0])], 3)[0] / (own / problems):.0f}×"
    print(
        f"{count:>8} {own / problems:10.3f} {whole / own:8.2f}× {alone:>9} {printed:>10} "
        f"{max(rcm.certificate_gap for rcm in found):9.0e} {excess:9.0e}"
    )


def prove(kind: str, sets: int) -> tuple[int, int]:
    """Print what became of hard sets of a kind; return how many were solved and were wrong."""
    gaps, refused, wrong = [], Counter[str](), 0
    for seed in range(sets):
        points, axes = adversarial(kind, seed)
        try:
            rcm = minimax_rcm(points, axes)
        except DataError as error:
            refused[error.what.split(":")[0].lstrip("the 0123456789")] += 1
            continue
        gaps.append(rcm.certificate_gap)
        wrong += gaps[-1] > 1e-12 or not radius_holds(rcm.point_mm, rcm.max_mm, points, axes)
    said = ", ".join(f"{count} × {reason}" for reason, count in refused.items())
    print(f"{kind:>26} {len(gaps):8} {max(gaps, default=0):9.0e} {wrong:6}  {said}")
    return len(gaps), wrong


def radius_holds(point: Floats, largest: float, points: Floats, axes: Floats) -> bool:
    """Tell whether the largest distance is what it is stated to be, in extended precision.

    Coordinates are stored to rounding, so their size times that is allowed.
    """
    at, lines = np.asarray(point, np.longdouble), np.asarray(points, np.longdouble)
    directions = np.asarray(axes, np.longdouble)
    across = np.cross(lines - at, directions)
    squares = (across**2).sum(axis=1) / (directions**2).sum(axis=1)
    size = float(np.abs(points).max() + np.abs(point).max())
    return bool(abs(np.sqrt(squares.max()) - largest) <= 1e-12 * largest + 1e-14 * size)


def proofs(sets: int) -> None:
    """Print the table of proofs."""
    kinds = [*HARD, *UNSOLVABLE]
    print(f"{sets * len(kinds)} hard sets of 3 to 300 lines, cones of 0.5° to 170°, 1e-6 to 1e6 mm")
    print(f"{'kind':>26} {'solved':>8} {'max gap':>9} {'wrong':>6}  refused")
    counts = [prove(kind, sets) for kind in kinds]
    solved, wrong = (sum(column) for column in zip(*counts, strict=True))
    print(f"{'all':>26} {solved:8} {'':9} {wrong:6}  {sets * len(kinds) - solved}")


def growth(count: int) -> None:
    """Print time and peak memory of `solve`, which finds both points and the cone."""
    points, axes = gold_lines(count)
    seconds = best_ms([lambda: solve(points, axes)], 5)[0] / 1e3
    tracemalloc.start()
    solve(points, axes)
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    print(f"{count:>8} {seconds:10.4f} {peak:10.1f} {1e6 * seconds / count:12.2f}")


def separations(name: str, make: Callable[[int, int], Lines], count: int, sets: int) -> None:
    """Print how far the two points are apart over many sets of lines."""
    found = [solve(*make(count, seed)) for seed in range(sets)]
    apart = np.array([rcm.separation_mm for rcm in found])
    rms = np.array([rcm.least_squares.rms_mm for rcm in found])
    higher = np.array([rcm.least_squares.max_mm / rcm.minimax.max_mm - 1 for rcm in found])
    print(
        f"{name:>14} {count:6} {np.median(apart):10.3f} {apart.min():10.1e} {apart.max():10.3f} "
        f"{np.median(apart / rms):10.2f} {100 * np.median(higher):9.0f} %"
    )


def mirrored_lines(count: int, seed: int = 0) -> Lines:
    """Return lines each of which has its mirror image in the RCM among the others."""
    points, axes = gold_lines(count // 2, seed)
    return np.concatenate([points, 2 * RCM_MM - points]), np.concatenate([axes, axes])


def weighting(own_mm: float, degenerate: float, tail: float, *, sessions: int) -> None:
    """Print the error and the coverage of the least-squares and the weighted point.

    `own_mm` is the robot's scatter, a component; `degenerate` the part of the lines that are known
    15 times worse along one direction; `tail` the degrees of freedom of the robot's t-distribution.
    """
    random, count = np.random.default_rng(5), 40
    errors: list[list[float]] = []
    for _ in range(sessions):
        axes = cone(random, count)
        covariances = np.tile(0.02**2 * np.eye(3), (count, 1, 1))
        covariances[random.random(count) < degenerate] += 0.3**2 * np.diag([0.36, 0, 0.64])
        noise = np.linalg.cholesky(covariances) @ random.standard_normal((count, 3, 1))
        scatter = random.standard_t(tail, (count, 3)) * np.sqrt((tail - 2) / tail)
        points = RCM_MM + noise[..., 0] + own_mm * scatter + random.uniform(50, 100) * axes
        row = []
        for rcm in (least_squares_rcm(points, axes), weighted_rcm(points, axes, covariances)):
            error = rcm.point_mm - RCM_MM
            row += [error @ error, error @ np.linalg.solve(rcm.covariance_mm2, error)]
        errors.append(row)
    plain, plain_square, weighted, weighted_square = np.transpose(errors)
    limit = confidence_radius(2 * count - 3) ** 2
    print(
        f"{own_mm:8.2f} {100 * degenerate:10.0f} % {tail:8.0f} {np.sqrt(plain.mean()):9.4f} "
        f"{np.sqrt(weighted.mean()):9.4f} {100 * (plain_square < limit).mean():8.1f} % "
        f"{100 * (weighted_square < limit).mean():8.1f} %"
    )


def speeds() -> None:
    """Print the table of speeds."""
    print("minimax RCM: mean of the best ms, and how many times longer the others take")
    print(
        f"{'lines':>8} {'Pivometer':>10} {'direct':>9} {'prepared':>9} {'CVXPY':>10} "
        f"{'own gap':>9} {'Clarabel':>9}"
    )
    for count, problems, repeats in [(10, 20, 40), (70, 10, 20), (10_000, 1, 3), (1_000_000, 1, 1)]:
        compare(count, problems=problems, repeats=repeats)


def growths() -> None:
    """Print the table of growth."""
    print("solve, both points and the cone: processor seconds, MB at the peak, µs a line")
    for count in (1_000, 10_000, 100_000, 1_000_000):
        growth(count)


def points() -> None:
    """Print the table of the two points."""
    print("|p₂ − p∞| in mm over 300 sets of lines (the paper: about 1e-8), relative to the rms,")
    print("and how much larger the maximum is at p₂")
    print(f"{'':>21} {'median':>10} {'least':>10} {'largest':>10} {'/ rms':>10} {'max':>11}")
    for count in (20, 70, 200):
        separations("gold standard", gold_lines, count, 300)
    separations("da Vinci", davinci_lines, 70, 300)
    separations("mirrored", mirrored_lines, 70, 300)


def weightings(sessions: int) -> None:
    """Print the table of the weighted point."""
    print(
        "location error, rms mm, and how often 95 % regions hold the RCM; 40 lines, 0.02 mm noise"
    )
    print(
        f"{'own, mm':>8} {'known badly':>12} {'t, dof':>8} {'LS':>9} {'weighted':>9} {'LS':>10} "
        f"{'weighted':>10}"
    )
    for own, part, tail in [
        (0, 0, 1e6),
        (0, 0.2, 1e6),
        (0.1, 0, 1e6),
        (0.1, 0.2, 1e6),
        (0.1, 0.2, 5),
    ]:
        weighting(own, part, tail, sessions=sessions)


def main() -> None:
    """Print the tables: all, or those that are named."""
    parser = argparse.ArgumentParser(description=__doc__)
    names = ("proofs", "growth", "points", "weighting", "speed")
    parser.add_argument("--only", choices=names, nargs="+", default=names)
    parser.add_argument("--sets", type=int, default=700, help="hard sets of each kind")
    parser.add_argument("--sessions", type=int, default=1000, help="for the weighted point")
    options = parser.parse_args()
    tables: dict[str, Callable[[], None]] = {
        "proofs": lambda: proofs(options.sets),
        "growth": growths,
        "points": points,
        "weighting": lambda: weightings(options.sessions),
        "speed": speeds,
    }
    for name in options.only:
        tables[name]()
        print(flush=True)


if __name__ == "__main__":
    main()
