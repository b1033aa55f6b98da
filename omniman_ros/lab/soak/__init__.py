"""Soak: a robot that is driven and disturbed at random for hours, and watched."""
