"""History of values: what is kept of them, and how it is read (OPC 10000-11, OPC 10000-13). Nothing here does I/O.

    fact, time -> Recorder -> Backlog -> a store (storage.history_store)
    HistoryRead -> read_raw, read_at_times, read_processed over the Series of a node -> rows, and where to go on

A Series is the rows of one node in the order of their times, each of which it has once. Continuation points hold all
that a page needs to go on (`continuation`), so that the server keeps nothing for them.
"""
