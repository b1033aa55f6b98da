"""The optimal control problem of MPC 2021 and its solver."""
