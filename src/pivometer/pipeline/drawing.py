"""The uncertainty of a measurement by drawing, on all cores."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from pivometer.errors import UsageError
from pivometer.measurement import ImportedRig, Measurement
from pivometer.pipeline.line_errors import line_errors
from pivometer.pipeline.reading import Progress, in_threads
from pivometer.rcm import Finding
from pivometer.uncertainty import LocationUncertainty
from pivometer.uncertainty.monte_carlo import FEWEST_DRAWS, MonteCarlo, chain, summary

CHUNK = 50
"""Draws that one thread makes at a time; every chunk has a seed of its own, so that the result does
not depend on the number of cores."""


def with_monte_carlo(
    measurement: Measurement, draws: int, *, seed: int = 0, progress: Progress | None = None
) -> Measurement:
    """Return a measurement that also states its uncertainties by drawing every input.

    Parameters
    ----------
    measurement
        What `measure` returned or `read_result` read.
    draws
        How many to make: 10 000 know a standard uncertainty to 0.7 %.
    seed
        Where the random numbers start.
    progress
        Called as ``progress(stage, done, total)``.

    Raises
    ------
    UsageError
        If fewer than 100 draws are asked for, or the rig was imported without its uncertainty.

    References
    ----------
    GUM supplement 1 (JCGM 101:2008).
    """
    if draws < FEWEST_DRAWS:
        raise UsageError(
            f"{draws} draws say too little",
            next_step=f"ask for {FEWEST_DRAWS} or more; 10 000 are usual",
        )
    calibration, linear = measurement.calibration, measurement.uncertainty
    if isinstance(calibration, ImportedRig) or not isinstance(linear, LocationUncertainty):
        raise UsageError(
            "the rig was imported without its uncertainty, so there is nothing to draw it from",
            next_step="calibrate with board images of this session",
        )
    edges = [pose.edges for pose in measurement.used]
    way = chain(edges, calibration.rig, calibration.covariance, linear, line_errors(measurement))
    sizes = [CHUNK] * (draws // CHUNK) + [draws % CHUNK] * bool(draws % CHUNK)
    found = in_threads(
        lambda k: way.drawn(sizes[k], np.random.default_rng([seed, k])),
        range(len(sizes)),
        "drawing (Monte Carlo)",
        progress,
    )
    outcome = summary(np.concatenate(found), linear, seed=seed)
    findings = measurement.findings
    if not outcome.linear_holds:
        findings += (_not_linear(outcome),)
    return replace(measurement, monte_carlo=outcome, findings=findings)


def _not_linear(outcome: MonteCarlo) -> Finding:
    least, most = outcome.linear_ratio.min(), outcome.linear_ratio.max()
    return Finding(
        "warning",
        f"by drawing, the location's standard uncertainty is {least:.2f} to {most:.2f} times the "
        "linear one: the errors are too large for a linear propagation",
        "use the intervals of the Monte Carlo, and look for what makes the errors so large",
    )
