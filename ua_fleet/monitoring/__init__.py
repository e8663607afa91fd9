"""How a process is: whether it lives, whether it is ready, and its figures for Prometheus, over HTTP.

    what the process counts and knows -> Monitor <- MonitoringEndpoint <- Prometheus, `ua-fleet healthcheck`

Nothing is counted here that is counted elsewhere: a Monitor asks when it is asked, so that a message costs nothing.
"""

from ua_fleet.monitoring.metrics import METRICS, Metric, MetricKind, ProcessKind
from ua_fleet.monitoring.mistakes import Mistakes
from ua_fleet.monitoring.monitor import Monitor

__all__ = ["METRICS", "Metric", "MetricKind", "Mistakes", "Monitor", "ProcessKind"]
