"""The bridge into ROS 1."""
