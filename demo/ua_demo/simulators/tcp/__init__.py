"""A robot on a TCP socket, for tests and for trying things out: a process of its own that knows nothing of ua_fleet.

python -m ua_demo.simulators.tcp --listen 127.0.0.1:1025 --framing acknowledged
python -m ua_demo.simulators.tcp --direct 127.0.0.1:30002
"""
