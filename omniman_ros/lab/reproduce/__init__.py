"""Experiments behind `omniman reproduce` and their report."""
