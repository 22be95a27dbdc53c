"""The shaft: finding it, fitting its edges, and its centerline in space."""
