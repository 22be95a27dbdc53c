"""The minimax solver beside its peers, and how far the 2-norm and ∞-norm points are apart.

Run with ``python benchmarks/rcm.py``; needs clarabel, cvxpy and scipy (the development tools).
All solvers work on the same lines in the same process, in turn; trust the ratios. "Direct" is
Clarabel on the reduced problem min α, ‖Pᵢq − rᵢ‖ ≤ α, once with setting up its matrices from the
lines, as any user must (Pivometer's time includes checking its input, too), and once without.
"CVXPY" is eq. (3) as printed, given to CVXPY with Clarabel.
"""

from __future__ import annotations

import argparse
import importlib
import time
import tracemalloc
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from pivometer.rcm import minimax_rcm, solve

Floats = NDArray[np.float64]
RCM_MM = np.array([6.4, 65.7, 478.3])


def cone(random: np.random.Generator, count: int) -> Floats:
    """Return directions spread evenly over the paper's 57° cone."""
    tilt = np.radians(28.5) * np.sqrt(random.random(count))
    turn = 2 * np.pi * random.random(count)
    return np.stack(
        [np.sin(tilt) * np.cos(turn), np.sin(tilt) * np.sin(turn), np.cos(tilt)], axis=1
    )


def gold_lines(count: int, seed: int = 0) -> tuple[Floats, Floats]:
    """Return lines that miss the RCM by independent noise with the paper's rms of 0.145 mm."""
    random = np.random.default_rng(seed)
    axes = cone(random, count)
    misses = 0.145 / np.sqrt(2) * random.standard_normal((count, 3))
    return RCM_MM + misses + random.uniform(50, 100, (count, 1)) * axes, axes


def davinci_lines(count: int, seed: int = 0) -> tuple[Floats, Floats]:
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


def compare(count: int, repeats: int, *, printed: bool) -> None:
    """Print one row of the table of speeds."""
    points, axes = gold_lines(count)
    matrix, right = clarabel_problem(points, axes)
    functions: list[Callable[[], object]] = [
        lambda: minimax_rcm(points, axes),
        lambda: clarabel_radius(*clarabel_problem(points, axes)),
        lambda: clarabel_radius(matrix, right),
    ]
    own, direct, prepared = best_ms(functions, repeats)
    cvxpy = f"{best_ms([lambda: cvxpy_radius(points, axes)], 5)[0] / own:9.0f}×" if printed else ""
    rcm = minimax_rcm(points, axes)
    excess = clarabel_radius(matrix, right) / rcm.max_mm - 1
    print(
        f"{count:>8} {own:10.3f} {direct / own:8.1f}× {prepared / own:8.1f}× {cvxpy:>10} "
        f"{rcm.certificate_gap:9.0e} {abs(excess):9.0e}"
    )


def memory_and_time(count: int) -> None:
    """Print time and peak memory of `solve`, which finds both points and the cone."""
    points, axes = gold_lines(count)
    seconds = best_ms([lambda: solve(points, axes)], 5)[0] / 1e3
    tracemalloc.start()
    solve(points, axes)
    peak = tracemalloc.get_traced_memory()[1] / 2**20
    tracemalloc.stop()
    print(f"{count:>8} {seconds:10.4f} {peak:10.1f}")


def separations(name: str, make: Callable[[int, int], tuple[Floats, Floats]], sets: int) -> None:
    """Print how far the two points are apart over many sets of 70 lines."""
    found = [solve(*make(70, seed)) for seed in range(sets)]
    apart = np.array([rcm.separation_mm for rcm in found])
    rms = np.array([rcm.least_squares.rms_mm for rcm in found])
    higher = np.array([rcm.least_squares.max_mm / rcm.minimax.max_mm - 1 for rcm in found])
    print(
        f"{name:>14} {np.median(apart):10.3f} {apart.min():10.1e} {apart.max():10.3f} "
        f"{np.median(apart / rms):10.2f} {100 * np.median(higher):9.0f} %"
    )


def main() -> None:
    """Run everything, or without ``--full`` what takes a minute."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--full", action="store_true", help="a million lines with Clarabel, too")
    full = parser.parse_args().full
    print("minimax RCM, best ms and how many times longer the others take")
    print(
        f"{'lines':>8} {'Pivometer':>10} {'direct':>9} {'prepared':>9} {'CVXPY':>10} "
        f"{'own gap':>9} {'Clarabel':>9}"
    )
    for count, repeats in [(10, 500), (70, 200), (1_000, 20), (10_000, 5)]:
        compare(count, repeats, printed=count <= 70)
    if full:
        compare(1_000_000, 1, printed=False)
    print("\nboth points and the cone: processor seconds and MB at the peak")
    for count in (1_000, 10_000, 100_000, 1_000_000):
        memory_and_time(count)
    print(
        "\n|p₂ − p∞| in mm over sets of 70 lines (the paper: about 1e-8), relative to the rms, and"
    )
    print("how much larger the maximum is at p₂")
    print(f"{'':>14} {'median':>10} {'least':>10} {'largest':>10} {'/ rms':>10} {'max':>11}")
    separations("gold standard", gold_lines, 300)
    separations("da Vinci", davinci_lines, 300)


if __name__ == "__main__":
    main()
