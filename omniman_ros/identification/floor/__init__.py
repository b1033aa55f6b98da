"""Identification of masses, friction and gear efficiency from a drive on the floor."""
