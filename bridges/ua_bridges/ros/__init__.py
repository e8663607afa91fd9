"""What the ROS 1 and the ROS 2 bridge share: message types as flat fields. Pure, imports no ROS."""
