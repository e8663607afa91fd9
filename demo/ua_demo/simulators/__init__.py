"""Simulators: of a fleet on a virtual clock, and of controllers, each a process of its own with the real protocol."""
