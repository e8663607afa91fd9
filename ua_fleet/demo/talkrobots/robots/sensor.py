"""A temperature sensor, which says once a second how warm it is."""

from __future__ import annotations

import argparse
import math

from ua_fleet.demo.ros_node import connect, report

PERIOD_S = 1.0
WAVE_S = 60.0


def main() -> None:
    """Run the sensor until SIGTERM. The temperature is always a little above or below the one that is asked for."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--temperature", type=float, default=22.5, help="in degrees Celsius")
    options = parser.parse_args()
    node = connect(2, "temperature_sensor")
    tell = node.publisher("/temperature", "sensor_msgs/Temperature")
    report("temperature_sensor", "is ready")
    count = 0
    while True:
        message = node.message("sensor_msgs/Temperature")
        message.temperature = options.temperature + math.sin(2 * math.pi * count * PERIOD_S / WAVE_S)
        tell(message)
        count += 1
        if node.stopped.wait(PERIOD_S / options.speed):
            break
    node.close()


if __name__ == "__main__":
    main()
