"""From scans to a map of what stands and tracks of what moves: no clock, no ROS."""
