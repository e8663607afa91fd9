"""How datagrams travel: UDP, and an in-memory network that loses, delays and duplicates."""
