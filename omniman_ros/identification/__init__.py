"""Identification of a real robot: odometry and friction."""
