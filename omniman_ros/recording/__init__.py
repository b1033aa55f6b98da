"""Writing, reading and drawing of recordings of a robot."""
