"""Benchmarks of the command `omniman bench`."""
