"""PubSub messages recorded as they were received, played back, and written for other programs.

Pure, but for `files.py`.

RecordingWriter(path, header, most_bytes).write(record)        # files.py: zstd
read_recording(path) -> Header, records

RecordedKeys(header).add(..); opener.open(record, now) -> plain message or None      # secured ones stay secured
Playback(...).feed(plain, seconds) -> facts, as a subscriber of that time was told them
Replay(publisher, ...).take(fact, ...) -> datagrams: the values as those of another space, never as live

McapWriter, pcapng_parts                                       # for Foxglove and Wireshark
"""
