"""The simulated robot: plant, drive units and encoders, sharing no model with the controller."""
