"""ROS 2 nodes: convert in, call the core with the time, convert out, publish."""
