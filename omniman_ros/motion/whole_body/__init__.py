"""Motions of platform and arm together: postures, tool paths and their correction."""
