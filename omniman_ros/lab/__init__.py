"""The laboratory: benchmarks, reproductions of the papers, studies and their figures."""
