"""The shaft: finding it, fitting its edges, and its centerline in space.

Finding it, in one camera's frames (`detection`): what stands still (`background`), lines among the
edges that do not (`straight`), pairs of them (`pairs`) and what these hide (`occlusion`); what a
sequence's pairs agree on (`motion`, `shifting`), everything that turns (`candidates`, `rivals`) or
what a person says does (`hint`), and each frame's seed (`refit`). How these lie to each other
(`relations`) and what all cameras agree on (`agreement`) let these choose together (`concurrence`).
Whether the cameras themselves stood still is `stillness`.

Fitting both edges near a seed (`edges`), from a view of the image (`view`, with `lines` and
`band_map`) and a first search in it (`search`). The first of these that holds:

- grey levels are flat: `plain` (on the sums of a `strip`), `thin`; or jump along it: `banded`;
- they are shaded: `ladder`, in the widest window (`rungs`, on `samples`) that fits (`choice`), or
  over the whole width (`matt`; `whole_width` with `glossy` and `rim`);
- both edges' blurs meet: `defocused`;
- a guarded fit whose background is free in every row: `shaded` (`bands`, `profile`, `weights`).

What stands behind (`backdrop`, or an empty frame) gives a better start (`uncovered`), a second
opinion (`lanes`, `texture`) and a test (`beside`). Every fit gives one result (`fitted`) with its
`evidence` and what a sensor's `response` adds, or is refused (`refusals`). `across` is for people
to look at, `mosaic_edges` evens colour filters.

The centerline: `silhouette`, `triangulation`, `cylinder_fit`, and the `gate` that poses pass.
"""
