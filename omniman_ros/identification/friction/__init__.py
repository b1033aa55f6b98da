"""Identification of the friction of the wheels with the wheels off the floor."""
