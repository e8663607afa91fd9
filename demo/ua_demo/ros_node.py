# pyright: basic, reportMissingImports=false, reportAttributeAccessIssue=false
"""One ROS node with the same few calls for ROS 1 and ROS 2, so that a robot's program can run on either."""

from __future__ import annotations

import signal
import threading
import time
from collections.abc import Callable
from importlib import import_module
from types import FrameType
from typing import Any

from ua_demo.report import beat

__all__ = ["RosNode", "connect"]

BEAT_S = 1.0
MASTER_S = 0.2
"""Pause before a ROS master that does not answer is asked again."""


class RosNode:
    """A node; `Ros1Node` and `Ros2Node` are its two kinds."""

    def __init__(self) -> None:
        self.stopped = threading.Event()
        signal.signal(signal.SIGTERM, self._stop)
        signal.signal(signal.SIGINT, self._stop)

    def _stop(self, _signal: int, _frame: FrameType | None) -> None:
        self.stopped.set()

    def wait(self, seconds: float) -> None:
        """Wait; ends the program when it is told to stop."""
        if self.stopped.wait(max(seconds, 0.0)):
            raise SystemExit(0)

    def wait_until(self, condition: Callable[[], bool]) -> None:
        """Wait until a condition holds."""
        while not condition():
            self.wait(0.005)

    def publisher(self, topic: str, kind: str, *, latched: bool = True) -> Callable[[Any], None]:
        """A function that publishes a message of type `kind`, or the value of its `data` field."""
        raise TypeError("use connect()")

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], None], *, latched: bool = True) -> None:
        """Have `callback` called with each message, in a thread of its own."""
        raise TypeError("use connect()")

    def message(self, kind: str) -> Any:
        """An empty message of a type such as `sensor_msgs/JointState`, stamped with the time now if it has a header."""
        raise TypeError("use connect()")

    def serve(self, name: str, do: Callable[[], str]) -> None:
        """Offer a service of the type std_srvs/Trigger; `do` works, and returns what to say at its end."""
        raise TypeError("use connect()")

    def robot(self, space: int, *, fault_id: int | None = None) -> Any:
        """What skills and faults are told by, see `ua_bridges.robot`."""
        raise TypeError("use connect()")

    def close(self) -> None:
        """Leave the graph."""

    def _make(self, kind: str) -> Any:
        package, name = kind.split("/")
        return getattr(import_module(f"{package}.msg"), name)

    def _filled(self, message_type: Any, value: Any) -> Any:
        return value if isinstance(value, message_type) else message_type(data=value)


class Ros1Node(RosNode):
    """A rospy node; ROS_MASTER_URI says where its master is."""

    def __init__(self, name: str) -> None:
        import rosgraph
        import rospy

        super().__init__()
        self._rospy = rospy
        if not rosgraph.is_master_online():  # rospy.init_node ends the program then; the master may be about to start
            print(f"waiting for the ROS master at {rosgraph.get_master_uri()}", flush=True)
        while not rosgraph.is_master_online():
            self.wait(MASTER_S)
        rospy.init_node(name, disable_signals=True, disable_rosout=True)
        # The package is on this robot, and a master that was restarted hears of it again.
        from ua_bridges.robot.ros1_registered import keep_registered

        keep_registered()
        rospy.Timer(rospy.Duration.from_sec(BEAT_S), lambda _: beat(), reset=True)

    def publisher(self, topic: str, kind: str, *, latched: bool = True) -> Callable[[Any], None]:
        message_type = self._make(kind)
        publisher = self._rospy.Publisher(topic, message_type, latch=latched, queue_size=10)
        return lambda value: publisher.publish(self._filled(message_type, value))

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], None], *, latched: bool = True) -> None:
        self._rospy.Subscriber(topic, self._make(kind), callback, tcp_nodelay=True)

    def message(self, kind: str) -> Any:
        message = self._make(kind)()
        if hasattr(message, "header"):
            message.header.stamp = self._rospy.Time.from_sec(time.time())
        return message

    def serve(self, name: str, do: Callable[[], str]) -> None:
        from std_srvs.srv import Trigger, TriggerResponse

        self._rospy.Service(name, Trigger, lambda _: TriggerResponse(success=True, message=do()))

    def robot(self, space: int, *, fault_id: int | None = None) -> Any:
        from ua_bridges.robot.ros1 import Robot

        return Robot(fault_id=fault_id)

    def close(self) -> None:
        self._rospy.signal_shutdown("end of the program")


class Ros2Node(RosNode):
    """An rclpy node in the domain that ROS_DOMAIN_ID names."""

    def __init__(self, name: str) -> None:
        import rclpy
        from rclpy.experimental.events_executor import EventsExecutor
        from rclpy.signals import SignalHandlerOptions

        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        super().__init__()
        self._rclpy = rclpy
        self._node = rclpy.create_node(name)
        self._executor = EventsExecutor()
        self._executor.add_node(self._node)
        self._closing = False
        self._thread = threading.Thread(target=self._spin, name="ros", daemon=True)
        self._thread.start()

    def _spin(self) -> None:
        last_beat = 0.0
        while not self._closing:
            self._executor.spin_once(timeout_sec=0.1)
            if (now := time.monotonic()) - last_beat >= BEAT_S:
                beat()
                last_beat = now

    def _qos(self, latched: bool) -> Any:
        from rclpy.qos import DurabilityPolicy, QoSProfile

        durability = DurabilityPolicy.TRANSIENT_LOCAL if latched else DurabilityPolicy.VOLATILE
        return QoSProfile(depth=10, durability=durability)

    def publisher(self, topic: str, kind: str, *, latched: bool = True) -> Callable[[Any], None]:
        message_type = self._make(kind)
        publisher = self._node.create_publisher(message_type, topic, self._qos(latched))
        return lambda value: publisher.publish(self._filled(message_type, value))

    def subscribe(self, topic: str, kind: str, callback: Callable[[Any], None], *, latched: bool = True) -> None:
        self._node.create_subscription(self._make(kind), topic, callback, self._qos(latched))

    def message(self, kind: str) -> Any:
        message = self._make(kind)()
        if hasattr(message, "header"):
            message.header.stamp = self._node.get_clock().now().to_msg()
        return message

    def serve(self, name: str, do: Callable[[], str]) -> None:
        from std_srvs.srv import Trigger

        def answer(_request: Any, response: Any) -> Any:
            response.success, response.message = True, do()
            return response

        self._node.create_service(Trigger, name, answer)

    def robot(self, space: int, *, fault_id: int | None = None) -> Any:
        from ua_bridges.robot.ros2 import Robot

        return Robot(self._node, space=space, fault_id=fault_id)

    def close(self) -> None:
        self._closing = True
        self._thread.join()
        self._executor.shutdown()
        self._node.destroy_node()
        self._rclpy.shutdown()


def connect(ros: int, name: str) -> RosNode:
    """Join the graph of ROS 1 or ROS 2."""
    return Ros1Node(name) if ros == 1 else Ros2Node(name)
