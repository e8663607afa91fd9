"""A small fleet in two network segments, of which one is reached by an MQTT broker alone."""
