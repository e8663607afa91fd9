"""Robots that are registered or announced, and skills that clients offer."""
