"""The shaft: finding it, fitting its edges, and its centerline in space.

Finding it in one camera's frames (`detection`; its parts are in `finding`), or where a person says
it is (`hint`), gives a `seed` in each; all cameras choose together which thing it is
(`concurrence`). Fitting both edges near a seed (`edges`; its parts are in `fitting`) uses what the
frames tell of what stands behind (`backdrop`); `across` is for people to look at. The centerline:
`silhouette`, `triangulation`, `cylinder_fit`, and the `gate` that poses pass. Whether the cameras
themselves stood still is `stillness`.
"""
