"""Benchmarks behind `omniman bench`."""
