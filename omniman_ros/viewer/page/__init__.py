"""The page that viser draws; it knows no ROS."""
