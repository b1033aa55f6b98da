"""The plant: motors, gears, friction, wheels, platform dynamics and encoders."""
