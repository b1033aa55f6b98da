"""A running robot as a Python object: its state, its motions, and how they end."""
