# pyright: reportPrivateImportUsage=false
"""A stock asyncua client that notes how old values are when it is notified of them.

    client.py URL NODE_ID

stdin and stdout as `server_ours.py`.
"""

from __future__ import annotations

import asyncio
import sys
from typing import Any

from asyncua import Client

from benchmarks.ros_nodes.ages import Ages

PUBLISHING_INTERVAL_MS = 50
"""The shortest that our server grants."""


async def main(url: str, node_id: str) -> None:
    ages = Ages()

    class Handler:
        def datachange_notification(self, node: Any, val: Any, data: Any) -> None:
            ages.note(val)

    async with Client(url) as client:
        subscription: Any = await client.create_subscription(PUBLISHING_INTERVAL_MS, Handler())
        await subscription.subscribe_data_change(client.get_node(node_id), queuesize=1000, sampling_interval=0)
        print(f"ready {subscription.parameters.RequestedPublishingInterval}", flush=True)
        await ages.serve()


asyncio.run(main(sys.argv[1], sys.argv[2]))
