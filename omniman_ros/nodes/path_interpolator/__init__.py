"""Node `path_interpolator`; what it shares with `whole_body_planner` is imported from here."""
