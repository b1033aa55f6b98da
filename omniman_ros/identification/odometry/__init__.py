"""Calibration of the odometry from drives whose ends are measured."""
