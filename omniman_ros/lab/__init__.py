"""Experiments and benchmarks; all quantities are in SI units, unless their names say otherwise."""
