"""Parts of fitting both edges of a shaft, from a view of the image to the result.

A fit starts from a view of the image (`view`, with `lines` and `band_map`) and a first `search` in
it. The first of these that holds:

- grey levels are flat: `plain` (on the sums of a `strip`), `thin`; or jump along it: `banded`;
- they are shaded: `ladder`, in the widest window (`rungs`, on `samples`) that fits (`choice`), or
  over the whole width (`matt`; `whole_width` with `glossy`, `glossy_model` and `rim`);
- both edges' blurs meet: `defocused`;
- a guarded fit whose background is free in every row: `shaded` (`bands`, `profile`, `weights`).

What stands behind gives a better start (`uncovered`), a second opinion (`lanes`, `texture`) and a
test (`beside`). Every fit gives one result (`fitted`) with what a sensor's `response` adds; it is
refused (`refusals`), or `stated` with its `evidence`. `mosaic_edges` evens colour filters.
"""
