"""Routes over (x, y, heading) that guide the optimisation among obstacles."""
