"""Where the edges of a shaft roughly are: what finding hands on to fitting."""

from dataclasses import dataclass

from pivometer._arrays import Floats, checked, read_only


@dataclass(frozen=True, slots=True, eq=False)
class ShaftSeed:
    """Where a shaft's two silhouette edges roughly are in one image.

    Parameters
    ----------
    edges_px
        Two edges, each with two end points (x, y), shape (2, 2, 2), raw pixels, good to about
        2 px. The end points of both edges run the same way along the shaft.

    Examples
    --------
    >>> seed = ShaftSeed([[[10, 0], [10, 90]], [[20, 0], [20, 90]]])
    >>> seed.edges_px[0, 1]
    array([10., 90.])
    """

    edges_px: Floats

    def __post_init__(self) -> None:
        edges = read_only(checked(self.edges_px, (2, 2, 2), "edges_px"))
        object.__setattr__(self, "edges_px", edges)
