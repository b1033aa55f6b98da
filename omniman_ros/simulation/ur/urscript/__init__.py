"""URScript, translated to Python and executed in the cycles of a controller."""
