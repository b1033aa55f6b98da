"""Simulated motor drives on a CAN bus."""
