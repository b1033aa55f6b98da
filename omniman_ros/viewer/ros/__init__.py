"""Topics, services and parameters behind the page."""
