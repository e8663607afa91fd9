"""The bridge to Universal Robots controllers, through ur-rtde."""
