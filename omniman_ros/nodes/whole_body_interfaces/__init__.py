"""Parts of the node `whole_body_planner`, besides those of the path interpolator."""
