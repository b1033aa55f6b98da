"""A simulated UR controller."""
