"""Obstacles: geometry, tracking, maps and the distances to them."""
