"""The link between a simulated arm controller and the arm's joints in a physics world."""
