"""Pure cores: numpy only, no ROS, clocks, threads, sockets or files."""
