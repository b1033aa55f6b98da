"""Command-line arguments of `omniman`, one module for each group of commands.

None of these modules imports NumPy, rclpy or the code of a command, so that `--help` stays fast.
"""
