"""The version, in one place."""

__version__ = "0.1.0"

SOFTWARE = f"pivometer {__version__}"
"""What files written by this version say they come from."""
