"""Parts of finding the shaft, from what moves to what all cameras agree on.

What stands still (`background`), lines among the edges that do not (`straight`), pairs of them
(`pairs`) and what these hide (`occlusion`); what a sequence's pairs agree on (`motion`,
`shifting`), everything that turns (`candidates`, `rivals`), and each frame's edges again (`refit`).
How things that turn lie to each other (`relations`), what all cameras agree on (`agreement`), and
which of two that turn side by side pivots (`side_by_side`).
"""
