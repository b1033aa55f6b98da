"""Parts of the node `path_interpolator`: what it hears, what it moves, and what it sends."""
