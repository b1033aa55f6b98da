"""Station keeping: one robot keeps its place relative to another one that moves."""
