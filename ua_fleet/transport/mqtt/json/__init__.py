"""JSON at the border of a broker: the processes speak UADP, and what is said over the broker is its text. Pure.

    JsonWriter.encode(plain UADP)      -> the text of one MQTT message, or None where JSON has none
    JsonReader.read(place, text)       -> plain UADP messages, as if they had been heard

Publisher, subscriber, requestor and responder are those of every connection (docs/adr/0075-json-at-the-border.md).
"""

from ua_fleet.transport.mqtt.json.descriptions import Descriptions
from ua_fleet.transport.mqtt.json.reader import JsonReader, NotItsTopic
from ua_fleet.transport.mqtt.json.settings import JsonSettings
from ua_fleet.transport.mqtt.json.writer import JsonWriter

__all__ = ["Descriptions", "JsonReader", "JsonSettings", "JsonWriter", "NotItsTopic"]
