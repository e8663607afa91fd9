"""The bridge into ROS 2."""
