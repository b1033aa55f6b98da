"""An interpreter of URScript."""
