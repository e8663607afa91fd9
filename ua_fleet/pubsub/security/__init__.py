"""Message security around the codec: which key, which nonce, what was replayed, and chunks.

envelope = Envelope(space, counters, mode=..., nonces=FileNonces(folder), ...)
envelope.install(group_id, keys, now)        # for each of envelope.keys_wanted(now)
envelope.seal(datagram, now)                 -> datagrams to send
envelope.open(datagram, now)                 -> the plain datagram, None where chunks are missing; raises Refused
envelope.poll(now)                           # at envelope.next_deadline()
"""
