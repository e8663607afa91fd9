from __future__ import annotations

import asyncio
import os
import threading

from ua_fleet.bridge.doorbell import Doorbell


async def test_rings_of_other_threads_are_answered_in_the_loop_once_for_all_before() -> None:
    loop, answered = asyncio.get_running_loop(), list[int]()
    bell = Doorbell(loop, lambda: answered.append(threading.get_ident()))
    threads = [threading.Thread(target=bell.ring) for _ in range(3)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    await asyncio.sleep(0.01)
    assert answered == [threading.get_ident()]
    bell.ring()
    await asyncio.sleep(0.01)
    assert len(answered) == 2
    bell.close()


async def test_a_ring_after_the_end_writes_into_nobody_elses_file() -> None:
    bell = Doorbell(asyncio.get_running_loop(), lambda: None)
    bell.close()
    reused = os.eventfd(0, os.EFD_NONBLOCK)
    try:
        bell.ring()
        bell.close()
        os.eventfd_write(reused, 5)
        assert os.eventfd_read(reused) == 5
    finally:
        os.close(reused)
