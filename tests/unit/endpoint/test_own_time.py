"""What a client costs is told without the garbage collection that happened meanwhile."""

from __future__ import annotations

import gc
import time

from ua_fleet.endpoint.own_time import own_time


def test_a_collection_is_left_out() -> None:
    gc.freeze()  # the collections are to look at what follows, and not at the modules of all tests
    alive = [[number] for number in range(300_000)]
    own, all_of_it = own_time(), time.thread_time()
    for _ in range(3):
        gc.collect()
    own, all_of_it = own_time() - own, time.thread_time() - all_of_it
    assert len(alive) == 300_000
    assert 0 <= own < all_of_it / 10


def test_work_is_counted() -> None:
    own, all_of_it = own_time(), time.thread_time()
    while time.thread_time() - all_of_it < 0.02:
        pass
    assert own_time() - own > 0.015
