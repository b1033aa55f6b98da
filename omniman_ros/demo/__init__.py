"""The demonstration behind `omniman demo`: its legs, and how they are measured."""
