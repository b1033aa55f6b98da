"""Recordings of what a robot says, as rosbag2 writes them. No rclpy here: it is files only."""
