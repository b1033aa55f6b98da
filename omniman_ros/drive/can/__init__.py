"""Simulated drives on a CAN bus: each protocol written from its public documents alone."""
