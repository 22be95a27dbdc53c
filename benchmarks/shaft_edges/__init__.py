"""Scenes with known edges, and public methods of finding them, for `benchmarks.edges`."""
