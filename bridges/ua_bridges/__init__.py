"""The UA bridges: one package for each kind of space. Each is loaded by its kind, in a process of its own."""
