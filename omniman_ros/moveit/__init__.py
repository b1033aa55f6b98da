"""Configuration of MoveIt for a robot, made from the same parameters as its URDF."""
