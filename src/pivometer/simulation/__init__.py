"""Simulated robots, cameras and pictures with known truth; this package knows no estimator."""

from pivometer.simulation.presets import PRESETS, Preset, simulate
from pivometer.simulation.session import SimulatedSession

__all__ = ["PRESETS", "Preset", "SimulatedSession", "simulate"]
