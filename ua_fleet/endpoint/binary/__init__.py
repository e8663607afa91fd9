"""OPC UA Binary by plans: a function for each structure, made once of the fields that asyncua's class has.

builtin.py        bytes of built-in types (OPC 10000-6 5.2.2)
encoders.py       bytes of any structure
decoders.py       strict decoding of what requests are made of
data_values.py    bytes of DataValues, kept beside the value until it changes
read.py           Read: from the request's bytes to the response's
browse.py         references of nodes, encoded once
write.py, call.py  what is written or called, known by the bytes that name it
history_read.py, history_details.py  HistoryRead
monitored_items.py  CreateMonitoredItems and Publish
operations.py     where the operations of a request begin, and each of them read once
session_requests.py  strict decoding of CreateSession and ActivateSession
targets.py        what is known by its bytes, and for how long
"""
