"""Pivometer measures the remote center of motion of surgical robots with ordinary cameras."""

from pivometer._version import __version__

__all__ = ["__version__"]
