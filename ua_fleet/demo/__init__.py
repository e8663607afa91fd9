"""Demonstrations: real robots' programs, bridges and the server, started by one command."""
