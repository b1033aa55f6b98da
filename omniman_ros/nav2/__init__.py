"""Parameters of Nav2 for a robot, made from the same parameters as those of its nodes."""
