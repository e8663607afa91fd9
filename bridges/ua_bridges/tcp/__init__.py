"""The bridge to robots that speak over a plain TCP socket: `direct` and `interpreter` mode."""
