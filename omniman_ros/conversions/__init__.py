"""Pure conversions between ROS messages and the types of the cores."""
