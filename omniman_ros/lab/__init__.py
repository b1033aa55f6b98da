"""The laboratory: benchmarks, reproductions of the papers' experiments, studies and figures."""
