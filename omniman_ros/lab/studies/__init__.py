"""Closed-loop studies without ROS: controllers, planners and the plant in one process."""
