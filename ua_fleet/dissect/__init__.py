"""PubSub messages named byte by byte, for people."""
