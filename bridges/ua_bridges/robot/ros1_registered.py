# pyright: basic, reportMissingImports=false
"""Keeps a rospy program registered: rospy registers once, and a ROS master that is restarted knows nothing.

Links between nodes outlive a master. Who comes later, or begins anew, as a bridge may, does not find such a program.
"""

from __future__ import annotations

import http.client
import threading
import xmlrpc.client
from typing import Any, Final
from xml.parsers.expat import ExpatError

import rosgraph
import rospy
from rospy.impl.registration import get_service_manager, get_topic_manager

__all__ = ["keep_registered"]

PERIOD_S: Final = 1.0
PATIENCE_S: Final = 2.0
"""rospy waits for an answer for ever, and a master whose machine has gone never gives one."""
_FAILURES: Final = (OSError, http.client.HTTPException, xmlrpc.client.Error, ExpatError, rosgraph.MasterException)


class _Patient(xmlrpc.client.Transport):
    def make_connection(self, host: Any) -> http.client.HTTPConnection:
        connection = super().make_connection(host)
        connection.timeout = PATIENCE_S
        return connection


def keep_registered() -> None:
    """Look each second, in a thread of its own, whether the master knows this node, and tell it again what it is.

    The program has called `rospy.init_node`.
    """
    threading.Thread(target=_keep, name="registered", daemon=True).start()


def _keep() -> None:
    while not rospy.core.is_shutdown():
        rospy.rostime.wallsleep(PERIOD_S)
        try:
            _look()
        except _FAILURES:
            continue  # no master, or it has gone meanwhile


def _look() -> None:
    """Tell the master what it does not know; services first, since they have no links that would have stayed."""
    name, node_uri = rospy.get_name(), rospy.get_node_uri()
    master = rosgraph.Master(name)
    master.handle = xmlrpc.client.ServerProxy(master.master_uri, transport=_Patient())
    published, subscribed, served = ({key for key, nodes in part if name in nodes} for part in master.getSystemState())
    for service, service_uri in get_service_manager().get_services():
        if service not in served:
            master.registerService(service, service_uri, node_uri)
    topics = get_topic_manager()
    for topic, kind in topics.get_subscriptions():
        if topic not in subscribed:
            publishers = master.registerSubscriber(topic, kind, node_uri)
            # As the master itself would tell it: links that are there stay.
            xmlrpc.client.ServerProxy(node_uri).publisherUpdate("/master", topic, publishers)
    for topic, kind in topics.get_publications():
        if topic not in published:
            master.registerPublisher(topic, kind, node_uri)
