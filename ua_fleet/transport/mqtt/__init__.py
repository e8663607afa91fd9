"""PubSub over MQTT brokers, as UADP (OPC 10000-14 7.3.4).

`address`, `topics`, `subject`, `incoming`, `patience`, `outbox` and `core` are pure; `transport` is their shell over
the library mqttium, which nothing else imports; `credentials` reads the files of `pubsub.broker`, `complaints` logs.
"""
