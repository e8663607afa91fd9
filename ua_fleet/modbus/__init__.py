"""The fleet as a Modbus/TCP device, for PLCs that speak nothing else: one more OPC UA client, with registers outside.

config.map       what lies at which address                                   pure
words.py         the words by which a PLC commands and is answered            pure
image.py         the four tables, as PLCs see them                            pure
commands.py      one command after the other, nothing twice                   pure but for its memory
gateway.py       between the image and the OPC UA server
listener.py      the Modbus server                                            pymodbus
"""
