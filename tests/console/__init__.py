"""The console as its users have it: a real browser, a real console, a real server with robots behind it."""
