"""The bridge to what is plugged into the computer of a robot: sensors and actuators."""
