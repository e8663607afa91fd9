"""The robots' programs. They know ROS and the names of their topics, and nothing of ua_fleet or OPC UA.

Each is started as a script: `python ned.py --ros 1 ...`. Each prints one JSON object a line for what happens:
`{"t": <seconds since 1970>, "who": ..., "what": ..., ...}`.
"""
