"""Pivometer measures the remote center of motion of surgical robots with ordinary cameras.

Examples
--------
>>> import pivometer
>>> lines = [[0, 0, 1], [0, 0, -1], [1, 0, 0]], [[1, 0, 0], [0, 1, 0], [0, 0, 1]]
>>> rcm = pivometer.solve(*lines)
>>> round(rcm.minimax.max_mm, 6)
1.0
"""

from typing import TYPE_CHECKING

from pivometer._version import __version__

if TYPE_CHECKING:
    from pivometer.calibration import Calibration
    from pivometer.io.session import Session
    from pivometer.measurement import Measurement
    from pivometer.pipeline import calibrate, check, load, measure
    from pivometer.rcm import RcmSolution, solve

__all__ = [
    "Calibration",
    "Measurement",
    "RcmSolution",
    "Session",
    "__version__",
    "calibrate",
    "check",
    "load",
    "measure",
    "solve",
]

_HOMES = {
    "Calibration": "pivometer.calibration",
    "Measurement": "pivometer.measurement",
    "RcmSolution": "pivometer.rcm",
    "Session": "pivometer.io.session",
    "calibrate": "pivometer.pipeline",
    "check": "pivometer.pipeline",
    "load": "pivometer.pipeline",
    "measure": "pivometer.pipeline",
    "solve": "pivometer.rcm",
}


def __getattr__(name: str) -> object:
    """Import a public name when it is first asked for, so that importing pivometer is quick."""
    if name not in _HOMES:
        raise AttributeError(f"module 'pivometer' has no attribute {name!r}")
    import sys
    from importlib import import_module

    if "IPython" in sys.modules:  # a notebook shows results as it shows nothing else
        import_module("pivometer.pipeline.notebook").show_in_notebooks()
    return getattr(import_module(_HOMES[name]), name)


def __dir__() -> list[str]:
    """List the public names, imported or not."""
    return sorted(__all__)
