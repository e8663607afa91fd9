"""What stands between the network and the address space: bytes, secure channels, sessions and services.

From the outside in: `listener` and `connection` (bytes), `channel` (OPC UA Connection Protocol and secure channel),
`processor` (which service, for whom), `logins` and `sessions`, then the services: `attributes`, `views`, `methods`,
`subscriptions`. Of asyncua they use the encoding, the security policies and the address space.
"""
