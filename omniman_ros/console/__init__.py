"""Parts that commands share: terminal output, progress, results, errors and a ROS session."""
