"""Model predictive planning among obstacles, MPC 2021; only three of its files import casadi."""
