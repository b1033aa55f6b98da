"""Topics of the node `mpc_planner`, part by part."""
