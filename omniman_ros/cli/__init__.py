"""The command `omniman`: its commands, one module each, and their arguments."""
