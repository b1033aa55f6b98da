"""Node `mpc_planner`."""
