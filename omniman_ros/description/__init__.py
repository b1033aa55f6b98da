"""The robot as others see it: its URDF, made from its configuration."""
