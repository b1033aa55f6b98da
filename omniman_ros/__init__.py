"""Motion control of a mobile manipulator on Mecanum or Omni wheels."""
