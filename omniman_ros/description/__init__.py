"""Description of the robot for other tools: its URDF, made from its configuration."""
