"""Motion of platform and arm around obstacles while the tool follows its path."""
