"""Executions of skills, and the requests for them."""
