"""Simulated counterparts of the hardware, which share no models with the code they test."""
