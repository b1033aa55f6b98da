"""URScript: read and run as a controller does, one cycle at a time."""
