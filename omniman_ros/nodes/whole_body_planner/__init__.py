"""Node `whole_body_planner`."""
