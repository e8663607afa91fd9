"""A typed OPC UA client: connect, browse, read, write and watch nodes by NodeId, UA topic or path.

async with FleetClient.connect("opc.tcp://127.0.0.1:4840/ua_fleet", user="anna", password=...) as client:
async for change in client.watch(["ua_1_2_1001"]):
print(change.value, change.status_text)
"""

from ua_fleet.client.fleet_client import POLICIES, Change, FleetClient, NodeInfo, NodeNotFound, Reading
from ua_fleet.client.identity import ClientIdentity, default_identity_folder

__all__ = [
    "POLICIES",
    "Change",
    "ClientIdentity",
    "FleetClient",
    "NodeInfo",
    "NodeNotFound",
    "Reading",
    "default_identity_folder",
]
