# pyright: basic, reportMissingImports=false
"""This process as a node in a ROS 1 graph: rospy's topics and links, without what rospy does behind one's back.

`rospy.init_node` needs a master at once, rewires the process's logging into files of the user's home, and hands
every registration to a thread that blocks until the master answers and that never registers again. Here the node
comes up without a master, logs nothing by itself, and registers only when the bridge's watch says so.
"""

from __future__ import annotations

import contextlib
import logging
import os
import socket
import threading
import time
from typing import Any

import rospy
import rospy.core
import rospy.impl.registration
import rospy.impl.tcpros
import rospy.impl.tcpros_base
import rospy.names
import rospy.rostime
import rospy.topics

from ua_bridges.ros1.api import ApiNode, Doorman, Orders, SlaveApi
from ua_fleet.errors import BridgeUnavailable

__all__ = ["RosNode"]

_lock = threading.Lock()


def _prepare_environment(master_uri: str, host_ip: str) -> None:
    # rospy reads these at several places. Without ROS_IP it would tell the others our host name, which they may
    # not know, and it would need netifaces. ROS_HOSTNAME would win over ROS_IP.
    os.environ["ROS_MASTER_URI"] = master_uri
    os.environ["ROS_IP"] = host_ip
    os.environ.pop("ROS_HOSTNAME", None)


def _revive_rospy() -> None:
    """Undo a shutdown: rospy is made for one node in the life of a process, tests run several in turn."""
    core = rospy.core
    core._shutdown_flag = core._in_shutdown = False  # noqa: SLF001 - there is no public way
    rospy.impl.tcpros_base._tcpros_server = None  # noqa: SLF001
    rospy.impl.registration.set_topic_manager(rospy.topics._TopicManager())  # noqa: SLF001


def _stay_silent() -> None:
    # Lost and found links are the bridge's to tell, once each way. rospy would say so with a traceback each time.
    for name in ("rospy", "rosout", "rosgraph", "xmlrpc"):
        logging.getLogger(name).setLevel(logging.CRITICAL)


class RosNode:
    """The one ROS node of this process."""

    def __init__(self, name: str, master_uri: str, host_ip: str) -> None:
        """Bring the node up, which needs no master.

        Raises:
            BridgeUnavailable: there is a node in this process already, or the address is not this machine's.
        """
        with _lock:
            if rospy.core.is_initialized() and not rospy.core.is_shutdown():
                raise BridgeUnavailable("a process can be one ROS 1 node only; run each ROS 1 bridge by itself")
            _prepare_environment(master_uri, host_ip)
            _stay_silent()
            self._check_address(host_ip)
            if rospy.core.is_shutdown():
                _revive_rospy()
            rospy.names.reload_mappings([])
            self.name: str = rospy.names.resolve_name(name, "/")
            rospy.names.initialize_mappings(self.name)
            # Else each link asks the master, without a timeout, whether it may use TCP keep-alive.
            rospy.impl.tcpros_base._use_tcp_keepalive = True  # noqa: SLF001
            self.orders = Orders()
            self._server, self._thread = self._start_server(master_uri)
            self.uri: str = self._server.uri
            # No topic exists yet, so rospy has registered nothing and needed no master. From here on the watch does.
            rospy.impl.registration.get_registration_listeners().clear()
            rospy.core.set_node_uri(self.uri)
            rospy.core.add_shutdown_hook(self._server.shutdown)
            rospy.rostime.set_rostime_initialized(True)
            rospy.core.set_initialized(True)

    def _start_server(self, master_uri: str) -> tuple[Any, threading.Thread]:
        """What `rospy.impl.init.start_node` does, in a thread that can be joined."""
        rospy.impl.tcpros.init_tcpros()
        tcpros = rospy.impl.tcpros_base._tcpros_server  # noqa: SLF001 - there is no public way
        tcpros._tcp_server_callback = self.doorman = Doorman(tcpros)  # noqa: SLF001
        rospy.names._set_caller_id(self.name)  # noqa: SLF001 - there is no public way
        handler = SlaveApi(self.name, master_uri, self.orders)
        server = ApiNode(0, handler)
        thread = threading.Thread(target=server.run, name="ros1-slave", daemon=True)
        thread.start()
        # To shut a server down that has not begun to serve would never end.
        while server.server is None or not server.server.begun.is_set():
            if not thread.is_alive():
                raise BridgeUnavailable("the ROS 1 node cannot be reached: its server did not start; see the log")
            time.sleep(0.001)
        return server, thread

    @staticmethod
    def _check_address(host_ip: str) -> None:
        with socket.socket() as probe:
            try:
                probe.bind((host_ip, 0))
            except OSError as error:
                raise BridgeUnavailable(
                    f"{host_ip} is not an address of this machine ({error.strerror}); correct `host_ip` of the bridge"
                ) from error

    @property
    def is_reachable(self) -> bool:
        """Whether other nodes can call this one; rospy does not mind when its server has ended."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End the node: all links, servers and threads. Registrations are the caller's to take back first."""
        with _lock:
            if not rospy.core.is_initialized():
                return
            handler: Any = self._server.handler
            if handler is not None and handler.reg_man is not None:
                handler.reg_man.master_uri = None  # else it would call the master once more, without a timeout
            rospy.impl.registration.get_topic_manager().close_all()
            self._end_servers()
            rospy.core.signal_shutdown("the bridge stops")
            rospy.core.set_initialized(False)

    def _end_servers(self) -> None:
        # rospy closes its listening sockets under the threads that wait on them: one of them would spin from then
        # on, the other would wait for ever.
        xmlrpc: Any = self._server.server
        if xmlrpc is not None:
            self._server.is_shutdown = True
            xmlrpc.shutdown()
            self._thread.join()
        tcpros = rospy.impl.tcpros_base._tcpros_server  # noqa: SLF001
        listener = tcpros.tcp_ros_server if tcpros is not None else None
        if listener is not None:
            listener.is_shutdown = True
            with contextlib.suppress(OSError):
                listener.server_sock.shutdown(socket.SHUT_RDWR)
            listener.server_sock.close()
