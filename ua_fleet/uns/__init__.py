"""The Unified Namespace: the values of robots as plain JSON on an MQTT broker, for programs that know only MQTT.

`topics` and `payloads` say where a value goes and how it looks, `namespace` which values there are and what is due on
the broker, all of it pure. `ua_fleet.transport.mqtt` carries it, by the client that carries PubSub; `ua_fleet.server`
feeds it. Nothing is subscribed to, so nothing that somebody writes there comes in.
"""
