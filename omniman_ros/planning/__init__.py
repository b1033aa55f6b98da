"""Model predictive planning among obstacles, MPC 2021: core, and casadi in three files only."""
