"""Faults of the whole running robot: the table, the player of its rows, and the judge."""
