"""Planning of motions along given paths, for the platform, the arm and the whole body."""
