"""Experiments in simulated time: controller core on simulated drives, numpy only, no ROS."""
