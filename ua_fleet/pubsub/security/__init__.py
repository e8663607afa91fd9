"""Message security around the codec: which key, which nonce, what was replayed, and chunks.

An `Envelope` for each process, between the transport on one side, publisher and subscriber on the other:

    envelope.install(group_id, keys, now)        # for each of envelope.keys_wanted(now)
    envelope.seal(datagram, now)                 -> datagrams to send
    envelope.open(datagram, now)                 -> the plain datagram, None where chunks are missing; raises Refused
    envelope.poll(now)                           # at envelope.next_deadline()
"""
