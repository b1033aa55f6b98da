"""What is around the robot: obstacles with their motion, maps, and the frames of both."""
