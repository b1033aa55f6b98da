"""Simulated motor drive that speaks CiA 402 over CANopen."""
