"""Shapes of the whole robot, and their distances from one another and from obstacles."""
