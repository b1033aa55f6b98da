"""The inputs of the path interpolator, and the streams that it sends."""
