"""The MJCF model of a robot in a scene, generated part by part as XML."""
