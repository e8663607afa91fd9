"""The robots' programs. Each runs as a process of its own, and knows only its own ROS graph."""
